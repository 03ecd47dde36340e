"""Rotors as linear systems; exact free shafts by transfer matrices, integration and Bessel functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.special import ive, jv, kve, yv

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


def matrices(block: Prepared, speed: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return M, G and K (n, n) of one plane of a rotor whose stations are the ends of all its beams, in their order.

    [displacement, slope] of end after end. From the accelerations by unit forces and moments, M^-1, and the rates.
    """
    a, b, _, _ = linear(block, speed)
    n, ends = len(a) // 2, block.shapes["force"][0]
    inputs = [k for end in range(ends) for k in (2 * end, 2 * (ends + end))]
    mass = np.linalg.inv(b[n:, inputs][::2])
    stiffness = -mass @ a[n::2, :n][:, ::2]
    return mass, -mass @ a[n::2, n:][:, 1::2] / speed if speed else 0 * mass, stiffness


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
        return roots(lambda f: self.misfit(f, speed), low, high, points)


def cone_misfit(omega: float, z: tuple[float, float], taper: float, modulus: float, density: float) -> float:
    """Return what vanishes at a natural frequency [rad/s] of a free solid cone between two distances from its apex.

    (E I y'')'' = w^2 rho A y with D = taper z has y = C_2(s) / z, s = 2 k sqrt(z), k^4 = 16 rho w^2 / (E taper^2), C
    any of J, Y, I, K (Kirchhoff 1879); moment and shear are proportional to s^4 C_4 and s^3 C_3, but -s^3 K_3.
    """
    k = (16 * density * omega**2 / (modulus * taper**2)) ** 0.25
    ends = 2 * k * np.sqrt(np.array(z))
    far, near = np.exp(ends - ends[1]), np.exp(ends[0] - ends)  # columns of one size
    rows = [
        row
        for s, grows, falls in zip(ends, far, near, strict=True)
        for row in ([c(n, s) for c in (jv, yv)] + [ive(n, s) * grows, (-1) ** n * kve(n, s) * falls] for n in (4, 3))
    ]
    return float(np.linalg.det(np.array(rows)))


def taper_misfit(
    frequency: float, sizes: Callable[[float], tuple[float, float]], length: float, speed: float = 0.0
) -> float:
    """Return what vanishes at a natural frequency [Hz] of a free shaft of which sizes(z) are outer and inner diameter.

    The equations of `ExactShaft`, integrated; steel of its defaults.
    """
    w, modulus, density, nu = 2 * np.pi * frequency, 2.1e11, 7850.0, 0.3
    scale = np.array([1.0, 1 / length, 1e6 * length, 1e6])  # of w, psi, M and V

    def field(z: float, y: np.ndarray) -> np.ndarray:
        outer, inner = sizes(z)
        area, second = np.pi / 4 * (outer**2 - inner**2), np.pi / 64 * (outer**4 - inner**4)
        shear = cowper(inner, outer, nu) * modulus / (2 * (1 + nu)) * area
        across, slope, moment, force = (y.reshape(4, 2).T * scale).T
        rates = [
            slope + force / shear,
            moment / (modulus * second),
            -force - density * second * (w**2 - 2 * speed * w) * slope,
            -density * area * w**2 * across,
        ]
        return (np.array(rates).T / scale).T.ravel()

    start = np.eye(4)[:, :2]
    found = solve_ivp(field, (0.0, length), start.ravel(), method="DOP853", rtol=1e-11, atol=1e-12)
    return float(np.linalg.det(found.y[:, -1].reshape(4, 2)[2:]))


def roots(misfit: Callable[[float], float], low: float, high: float, points: int = 60) -> np.ndarray:
    """Return where a function changes its sign between two arguments."""
    grid = np.linspace(low, high, points)
    values = np.array([misfit(one) for one in grid])
    at = np.flatnonzero(values[:-1] * values[1:] < 0)
    return np.array([brentq(misfit, grid[k], grid[k + 1], xtol=1e-10, rtol=1e-14) for k in at])
