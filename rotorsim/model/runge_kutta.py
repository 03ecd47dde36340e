"""Explicit Runge-Kutta methods as data, which generated C, simulated residuals and FMU integrators share."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RK4", "Tableau"]


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau of an explicit method of s stages.

    k_i = f(t + c_i h, y + h sum_{j<i} a_ij k_j),    y(t + h) = y(t) + h sum_i b_i k_i

    a: row i holds a_i0 .. a_i(i-1); b, c: (s,).
    """

    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: int


# The classical method (Kutta 1901), also "the" Runge-Kutta method; not to be confused with the 3/8 rule.
RK4 = Tableau(
    a=((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)), b=(1 / 6, 1 / 3, 1 / 3, 1 / 6), c=(0.0, 1 / 2, 1 / 2, 1.0), order=4
)
