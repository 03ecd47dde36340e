"""Rotors as linear systems, and exact free shafts of Timoshenko sections by transfer matrices (no finite elements)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from tests.blocks.evaluation import KINDS, Prepared, prepare


def drawn(lengths: Sequence[float], stations: Sequence[float], parameters: dict, **options: object) -> Prepared:
    """Return a traced rotor_drawing."""
    n = len(stations)
    inputs = {"force": (n, 2), "moment": (n, 2), "speed": ()}
    return prepare("rotor_drawing", inputs, parameters, {"section_lengths": lengths, "stations": stations, **options})


def linear(block: Prepared, speed: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return A (2n, 2n), B (2n, 4 m), C (4 m / 2, 2n) and the constant rates (2n,) of a rotor by superposition.

    Columns of B: forces, then moments, [row, xy]; rows of C: displacements, then tilts.
    """
    m, size = block.shapes["force"][0], block.initial["position"].size
    count = 2 * size + 4 * m
    columns = np.hstack([np.zeros((count, 1)), np.eye(count)])
    given = dict(
        zip(("position", "velocity", "force", "moment"), np.split(columns, np.cumsum([size, size, 2 * m])), strict=True)
    )
    given["speed"] = np.full((1, count + 1), speed)
    names = [*block.trace.inputs, *block.trace.parameters, *block.trace.states]
    fixed = {name: np.tile(block.parameters[name].reshape(-1, 1), count + 1) for name in block.trace.parameters}
    arguments = [ca.DM({**given, **fixed}[name]) for name in names]
    values = iter(block.function.call([*arguments, ca.DM.zeros(1, count + 1)]))  # many columns: one call
    found = {key: np.array(next(values)) for kind in KINDS for key in getattr(block.trace, kind)}
    rates = np.vstack([found["position"], found["velocity"]])
    seen = np.vstack([found["displacement"], found["tilt"]])
    a, b = np.split(rates[:, 1:] - rates[:, :1], [2 * size], axis=1)
    return a, b, seen[:, 1 : 2 * size + 1], rates[:, 0]


def receptance(block: Prepared, frequency: float, speed: float = 0.0) -> np.ndarray:
    """Return displacements and tilts by forces and moments at a frequency [Hz], shape (4 m, 4 m)."""
    a, b, c, _ = linear(block, speed)
    return c @ np.linalg.solve(2j * np.pi * frequency * np.eye(len(a)) - a, b)


def frequencies(block: Prepared, speed: float = 0.0, above: float = 1.0) -> np.ndarray:
    """Return the natural frequencies [Hz] above one."""
    values = np.linalg.eigvals(linear(block, speed)[0]).imag / (2 * np.pi)
    return np.sort(values[values > above])


def cowper(inner: float, outer: float, nu: float = 0.3) -> float:
    """Return the shear coefficient of a hollow circular section, Cowper (1966), table 1."""
    m = inner / outer
    return 6 * (1 + nu) * (1 + m**2) ** 2 / ((7 + 6 * nu) * (1 + m**2) ** 2 + (20 + 12 * nu) * m**2)


class ExactShaft:
    """A free stepped Timoshenko shaft with rigid discs: [w, psi, M, V] from end to end at one whirl frequency.

    w' = psi + V / (kappa G A),  psi' = M / (E I),  M' = -V - rho I (w^2 - 2 W w) psi,  V' = -rho A w^2 w; at a disc
    M jumps by -(I_d w^2 - I_p W w) psi and V by -m w^2 w. w > 0 whirls forward. Free ends: M = V = 0.
    """

    def __init__(
        self,
        sections: Sequence[tuple[float, float, float]],
        discs: Sequence[tuple[float, float, float, float]] = (),
        young_modulus: float = 2.1e11,
        density: float = 7850.0,
        poisson_ratio: float = 0.3,
    ) -> None:
        """Hold (length, outer, inner) of each section and (position, m, I_p, I_d) of each disc."""
        self.sections, self.discs = sections, sorted(discs)
        self.e, self.rho, self.nu = young_modulus, density, poisson_ratio

    def misfit(self, frequency: float, speed: float) -> float:
        """Return the determinant that vanishes at a natural frequency [Hz] (negative: backward whirl)."""
        w = 2 * np.pi * frequency
        total, z = np.eye(4), 0.0
        waiting = list(self.discs)
        for length, outer, inner in self.sections:
            area, second = np.pi / 4 * (outer**2 - inner**2), np.pi / 64 * (outer**4 - inner**4)
            shear = cowper(inner, outer, self.nu) * self.e / (2 * (1 + self.nu)) * area
            field = np.zeros((4, 4))
            field[0, 1], field[0, 3], field[1, 2] = 1.0, 1 / shear, 1 / (self.e * second)
            field[2, 1], field[2, 3] = -self.rho * second * (w**2 - 2 * speed * w), -1.0
            field[3, 0] = -self.rho * area * w**2
            end = z + length
            while waiting and waiting[0][0] <= end + 1e-12:
                position, mass, polar, diametral = waiting.pop(0)
                jump = np.eye(4)
                jump[2, 1], jump[3, 0] = -(diametral * w**2 - polar * speed * w), -mass * w**2
                total = jump @ expm(field * (position - z)) @ total
                z = position
            total = expm(field * (end - z)) @ total
            z = end
        return float(np.linalg.det(total[2:, :2]))

    def frequencies(self, low: float, high: float, speed: float = 0.0, points: int = 150) -> np.ndarray:
        """Return the natural frequencies [Hz] between two."""
        grid = np.linspace(low, high, points)
        miss: Callable[[float], float] = lambda f: self.misfit(f, speed)  # noqa: E731
        values = np.array([miss(f) for f in grid])
        at = np.flatnonzero(values[:-1] * values[1:] < 0)
        return np.array([brentq(miss, grid[k], grid[k + 1], xtol=1e-10, rtol=1e-14) for k in at])
