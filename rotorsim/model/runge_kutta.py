"""Explicit Runge-Kutta methods as data, which generated C, simulated residuals and FMU integrators share."""

from __future__ import annotations

from dataclasses import dataclass


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

    @property
    def stability(self) -> tuple[float, ...]:
        """Coefficients of R(q) = 1 + sum_k q^k b^T A^(k-1) 1, by which a step changes exp(lambda t), q = h lambda.

        Source: Hairer & Wanner, Solving ODEs II, sec. IV.2.
        """
        stages, coefficients = [1.0] * len(self.b), [1.0]
        for _ in self.b:
            coefficients.append(sum(b * k for b, k in zip(self.b, stages, strict=True)))
            stages = [sum(a * k for a, k in zip(row, stages, strict=False)) for row in self.a]
        return tuple(coefficients)


# The classical method (Kutta 1901), also "the" Runge-Kutta method; not to be confused with the 3/8 rule.
RK4 = Tableau(
    a=((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)), b=(1 / 6, 1 / 3, 1 / 3, 1 / 6), c=(0.0, 1 / 2, 1 / 2, 1.0), order=4
)
