"""Rotors of several degrees of freedom in an AMB: thesis chapters 3, 4 and 5, written out in two planes.

With q = q_x + i q_y, tilt phi = du_x/dz + i du_y/dz, and the gyroscopic sign that makes forward whirl rise
(the thesis' own (3.2) has the opposite sign):

M q'' + (C - i W G) q' + K q = f_crack + sum f_unbalance + e_amb (k_s u - k_i i) - f_supports
                                                                    thesis eqs. (3.21), (4.16), (5.4)
State of the time solution: y = [int u_amb (x, y), q_x, q_y, q_x', q_y'].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import eig

from tests.reference.excitation import RPM, crack_force, participation, unbalance_force
from tests.reference.linear import ForcedLinear

LINK = 4  # degrees of freedom of a beam element in one plane


@dataclass(frozen=True)
class Rotor:
    """Matrices of one plane (n, n) and where forces act.

    crack, amb: degree of freedom (counted from 0). discs: (degree of freedom, mass, eccentricity, phase).
    supports: (degree of freedom, k_x, k_y, c_x, c_y). translations: degrees of freedom that are displacements.
    """

    mass: np.ndarray
    damping: np.ndarray
    gyroscopic: np.ndarray
    stiffness: np.ndarray
    amb: int
    crack: int
    crack_stiffness: float
    sag: float
    discs: tuple[tuple[int, float, float, float], ...]
    supports: tuple[tuple[int, float, float, float, float], ...] = ()
    force_displacement: float = 105210.0
    force_current: float = 42.1
    kp: float = 12200.0
    ki: float = 2000.0
    kd: float = 3.0
    terms: int = 5
    speed: float = 1620 * RPM
    acceleration: float = 0.0
    translations: tuple[int, ...] = field(default=())

    @property
    def size(self) -> int:
        """Return the number of degrees of freedom of one plane."""
        return len(self.mass)

    def system(self, with_amb: bool = True) -> np.ndarray:
        """Return A of y' = A y + forcing, shape (2 + 4n, 2 + 4n) at the speed."""
        n = self.size
        planes = [(self.stiffness.astype(float).copy(), self.damping.astype(float).copy()) for _ in range(2)]
        for dof, kx, ky, cx, cy in self.supports:
            for (k, c), kb, cb in zip(planes, (kx, ky), (cx, cy), strict=True):
                k[dof, dof] += kb
                c[dof, dof] += cb
        a = np.zeros((2 + 4 * n, 2 + 4 * n))
        inverse = np.linalg.inv(self.mass)
        gyro = self.speed * self.gyroscopic
        for plane, (k, c) in enumerate(planes):
            if with_amb:
                k[self.amb, self.amb] += self.force_current * self.kp - self.force_displacement
                c[self.amb, self.amb] += self.force_current * self.kd
            q, v = 2 + plane * n, 2 + (2 + plane) * n
            other, sign = 2 + (3 - plane) * n, (1.0 if plane == 0 else -1.0)
            a[plane, q + self.amb] = 1.0
            a[q : q + n, v : v + n] = np.eye(n)
            a[v : v + n, q : q + n] = -inverse @ k
            a[v : v + n, v : v + n] = -inverse @ c
            a[v : v + n, other : other + n] = -sign * inverse @ gyro
            if with_amb:
                a[v : v + n, plane] = -inverse[:, self.amb] * self.force_current * self.ki
        return a

    def forces(self, t: float) -> np.ndarray:
        """Return the complex force on every degree of freedom of crack and unbalances, shape (n,)."""
        theta = self.speed * t + 0.5 * self.acceleration * t * t
        speed = self.speed + self.acceleration * t
        f = np.zeros(self.size, dtype=complex)
        f[self.crack] += crack_force(theta, self.crack_stiffness, self.sag, self.terms)
        for dof, m, e, phase in self.discs:
            f[dof] += unbalance_force(theta, speed, m, e, phase)
        return f

    def force_harmonics(self) -> dict[int, np.ndarray]:
        """Return order -> complex force on every degree of freedom (n,)."""
        found = {k: np.zeros(self.size, dtype=complex) for k in participation(self.terms)}
        for k, p in participation(self.terms).items():
            found[k][self.crack] += p * self.crack_stiffness * self.sag
        for dof, m, e, phase in self.discs:
            found[1][dof] += m * e * self.speed**2 * np.exp(1j * phase)
        return found

    def linear(self) -> ForcedLinear:
        """Return the linear model at constant speed: real state y, forcing exp(i k W t) for +k and -k."""
        n = self.size
        inverse = np.linalg.inv(self.mass)
        force = self.force_harmonics()
        orders = {abs(k) for k in force}
        forcing = {}
        for k in sorted(orders | {-k for k in orders}):
            plus = force.get(k, np.zeros(n, dtype=complex))
            minus = np.conj(force.get(-k, np.zeros(n, dtype=complex)))
            b = np.zeros(2 + 4 * n, dtype=complex)
            b[2 + 2 * n : 2 + 3 * n] = inverse @ (plus + minus) / 2
            b[2 + 3 * n :] = inverse @ (plus - minus) / 2j
            forcing[k] = b
        return ForcedLinear(self.system(), forcing, self.speed)

    def solve(self, time: np.ndarray, rtol: float = 1e-11, method: str = "DOP853") -> np.ndarray:
        """Return y at the times (m, 2 + 4n) from rest, by time integration."""
        n = self.size
        a = self.system()
        inverse = np.linalg.inv(self.mass)

        def rhs(t: float, y: np.ndarray) -> np.ndarray:
            dy = a @ y
            acceleration = inverse @ self.forces(t)
            dy[2 + 2 * n : 2 + 3 * n] += acceleration.real
            dy[2 + 3 * n :] += acceleration.imag
            return dy

        assert self.acceleration == 0.0 or not self.gyroscopic.any()
        y0 = np.zeros(2 + 4 * n)
        return solve_ivp(rhs, (0.0, float(time[-1])), y0, method, time, rtol=rtol, atol=1e-15).y.T

    def exact(self, time: np.ndarray) -> np.ndarray:
        """Return y at equally spaced times (m, 2 + 4n) from rest, exact (constant speed)."""
        return self.linear().at(time, np.zeros(2 + 4 * self.size)).real

    def displacement(self, y: np.ndarray, dof: int) -> np.ndarray:
        """Return u_x + i u_y of a degree of freedom from states (m, 2 + 4n)."""
        return y[:, 2 + dof] + 1j * y[:, 2 + self.size + dof]

    def current(self, y: np.ndarray) -> np.ndarray:
        """Return i_x + j i_y [A] from states (m, 2 + 4n)."""
        n, d = self.size, self.amb
        velocity = y[:, 2 + 2 * n + d] + 1j * y[:, 2 + 3 * n + d]
        return self.ki * (y[:, 0] + 1j * y[:, 1]) + self.kp * self.displacement(y, d) + self.kd * velocity

    def settled(self, dof: int) -> dict[int, complex]:
        """Return the harmonics of u_x + i u_y of a degree of freedom of the settled motion."""
        states = self.linear().settled()
        return {k: complex(y[2 + dof] + 1j * y[2 + self.size + dof]) for k, y in states.items()}

    def settled_current(self) -> dict[int, complex]:
        """Return the harmonics of i_x + j i_y of the settled motion."""
        return {k: complex(self.current(y[None, :])[0]) for k, y in self.linear().settled().items()}

    def frequencies(self, with_amb: bool = False) -> np.ndarray:
        """Return the damped natural frequencies [Hz], ascending, from the first-order system."""
        n = self.size
        a = self.system(with_amb)
        values = np.linalg.eigvals(a) if with_amb else np.linalg.eigvals(a[2:, 2:])
        assert n
        return np.sort(values.imag[values.imag > 1e-6]) / (2 * math.pi)

    def undamped_whirl(self) -> np.ndarray:
        """Return whirl frequencies [Hz], signed: forward positive, backward negative; isotropic, no damping, no AMB.

        (-w^2 M + w W G + K) phi = 0, linearised as a generalised eigenvalue problem.
        """
        n = self.size
        zero, eye = np.zeros((n, n)), np.eye(n)
        left = np.block([[zero, eye], [self.stiffness, self.speed * self.gyroscopic]])
        right = np.block([[eye, zero], [zero, self.mass]])
        values = eig(left, right, right=False)
        return np.sort(values.real) / (2 * math.pi)

    def at_speed(self, speed: float) -> Rotor:
        """Return the same rotor at another speed [rad/s]."""
        return replace(self, speed=speed)


def offset_disc(diametral_inertia: float = 0.0024, **changes: float) -> Rotor:
    """Return the offset disc of Table 3-1 (I_d is not printed there; chapter 4 prints 0.0024 kg m^2)."""
    data = Rotor(
        mass=np.diag([2.0, diametral_inertia]),
        damping=np.array([[76.0, 11.0], [11.0, 6.0]]),
        gyroscopic=np.diag([0.0, 0.0048]),
        stiffness=np.array([[7.6e5, 8900.0], [8900.0, 2350.0]]),
        amb=0,
        crack=0,
        crack_stiffness=3e5,
        sag=2.6e-5,
        discs=((0, 2.0, 24e-6, math.radians(30)),),
        translations=(0,),
    )
    return replace(data, **changes)


def beam(
    elements: int = 5, length: float = 0.5, diameter: float = 0.016, density: float = 7850.0, elasticity: float = 2.1e11
) -> tuple[np.ndarray, np.ndarray]:
    """Return mass and stiffness of one plane of an Euler-Bernoulli beam, (2 (elements + 1))^2; order [u, phi] per node.

    Consistent mass, no rotary inertia                                            thesis eqs. (B.1), (B.2)
    """
    h = length / elements
    area = math.pi * diameter**2 / 4
    inertia = math.pi * diameter**4 / 64
    m = np.array(
        [
            [156, 22 * h, 54, -13 * h],
            [22 * h, 4 * h**2, 13 * h, -3 * h**2],
            [54, 13 * h, 156, -22 * h],
            [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
        ]
    )
    k = np.array(
        [
            [12, 6 * h, -12, 6 * h],
            [6 * h, 4 * h**2, -6 * h, 2 * h**2],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, 2 * h**2, -6 * h, 4 * h**2],
        ]
    )
    m *= density * area * h / 420
    k *= elasticity * inertia / h**3
    size = 2 * (elements + 1)
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    for e in range(elements):
        part = slice(2 * e, 2 * e + LINK)
        mass[part, part] += m
        stiffness[part, part] += k
    return mass, stiffness


def fe_rigid(elements: int = 5, a0: float = 0.154, a1: float = 1e-5, **changes: float) -> Rotor:
    """Return the rotor of Table 4-1: ends pinned by removing their displacement, disc and AMB at node 3, crack at 4.

    Rayleigh damping of the shaft elements, C = a0 M + a1 K                        thesis eq. (C.4)
    """
    mass, stiffness = beam(elements)
    damping = a0 * mass + a1 * stiffness
    gyroscopic = np.zeros_like(mass)
    disc = 2 * round(2 * elements / 5)
    crack = 2 * round(3 * elements / 5)
    mass[disc, disc] += 2.0
    mass[disc + 1, disc + 1] += 0.0024
    gyroscopic[disc + 1, disc + 1] += 0.0045
    keep = [d for d in range(len(mass)) if d not in (0, len(mass) - 2)]
    part = np.ix_(keep, keep)
    data = Rotor(
        mass=mass[part],
        damping=damping[part],
        gyroscopic=gyroscopic[part],
        stiffness=stiffness[part],
        amb=keep.index(disc),
        crack=keep.index(crack),
        crack_stiffness=3e5,
        sag=2.6e-5,
        discs=((keep.index(disc), 2.0, 24e-6, math.radians(30)),),
        translations=tuple(keep.index(d) for d in keep if d % 2 == 0),
    )
    return replace(data, **changes)


def fe_flexible(
    polar: tuple[float, float] = (0.0045, 0.0045 * 0.75),
    diametral: tuple[float, float] = (0.0024, 0.0024 * 0.75),
    bearing_damping: float = 0.0,
    a0: float = 0.154,
    a1: float = 1e-5,
    **changes: float,
) -> Rotor:
    """Return the rotor of Table 5-1: discs at nodes 2 and 5, AMB at 3, crack at 4, anisotropic supports at 1 and 6.

    Disc inertias and bearing damping are not printed there: they are arguments.
    """
    mass, stiffness = beam()
    damping = a0 * mass + a1 * stiffness
    gyroscopic = np.zeros_like(mass)
    for node, m, ip, i_d in ((1, 2.0, polar[0], diametral[0]), (4, 1.5, polar[1], diametral[1])):
        mass[2 * node, 2 * node] += m
        mass[2 * node + 1, 2 * node + 1] += i_d
        gyroscopic[2 * node + 1, 2 * node + 1] += ip
    c = bearing_damping
    data = Rotor(
        mass=mass,
        damping=damping,
        gyroscopic=gyroscopic,
        stiffness=stiffness,
        amb=4,
        crack=6,
        crack_stiffness=3e5,
        sag=3.1e-5,
        discs=((2, 2.0, 24e-6, math.radians(15)), (8, 1.5, 58e-6, math.radians(45))),
        supports=((0, 495.82e6, 950.13e6, c, c), (10, 355.82e6, 805.82e6, c, c)),
        translations=tuple(range(0, 12, 2)),
    )
    return replace(data, **changes)
