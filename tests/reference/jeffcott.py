"""Cracked Jeffcott rotor in an AMB: thesis chapter 2, data of Table 2-1.

m r'' + c r' + k r = f_crack + f_unbalance + k_s r - k_i i,   i = K_P r + K_I int r + K_D r'
                                                                    thesis eqs. (2.24), (2.27), (2.28)
State of the time solution: y = [int x, int y, x, y, vx, vy].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from tests.reference.excitation import RPM, crack_force, participation, unbalance_force
from tests.reference.linear import ForcedLinear

Force = Callable[[float, complex, complex], complex]


@dataclass(frozen=True)
class Jeffcott:
    """Data of Table 2-1, SI units."""

    mass: float = 2.0
    stiffness: float = 7.6e5
    damping: float = 76.0
    crack_stiffness: float = 3e5
    sag: float = 2.6e-5
    terms: int = 5
    eccentricity: float = 24e-6
    phase: float = math.radians(30)
    force_displacement: float = 105210.0
    force_current: float = 42.1
    kp: float = 12200.0
    ki: float = 2000.0
    kd: float = 3.0
    speed: float = 1500 * RPM
    acceleration: float = 0.0
    bias_current: float = 0.0
    gap: float = 0.0
    breathing_width: float = 0.0

    def angle(self, t: float) -> tuple[float, float]:
        """Return the angle (integral of speed) and the speed."""
        return self.speed * t + 0.5 * self.acceleration * t * t, self.speed + self.acceleration * t

    def amb(self, displacement: complex, current: complex) -> complex:
        """Return the AMB force on the rotor; nonlinear per axis when a gap is given.

        linear: k_s r - k_i i                                                     thesis eq. (2.25)
        nonlinear: K ((i0 - i)^2 / (g - x)^2 - (i0 + i)^2 / (g + x)^2), K from k_i = 4 K i0 / g^2
        """
        if self.gap == 0.0:
            return self.force_displacement * displacement - self.force_current * current
        constant = self.force_current * self.gap**2 / (4 * self.bias_current)

        def axis(x: float, i: float) -> float:
            pull = ((self.bias_current - i) / (self.gap - x)) ** 2
            return constant * (pull - ((self.bias_current + i) / (self.gap + x)) ** 2)

        return complex(axis(displacement.real, current.real), axis(displacement.imag, current.imag))

    def crack(self, theta: float, displacement: complex) -> complex:
        """Return the crack force: weight-dominated, or, given a breathing width, opened by the deflection.

        breathing: xi = Re((r + delta_x) exp(-i th)), f = (1 + tanh(xi / width)) / 2 dk xi exp(i th)    thesis eq. (2.3)
        """
        if self.breathing_width > 0.0:
            turn = complex(math.cos(theta), math.sin(theta))
            normal = ((displacement + self.sag) * turn.conjugate()).real
            return 0.5 * (1 + math.tanh(normal / self.breathing_width)) * self.crack_stiffness * normal * turn
        return crack_force(theta, self.crack_stiffness, self.sag, self.terms)

    def current(self, y: np.ndarray) -> np.ndarray:
        """Return i_x + j i_y [A] of one state (6,) or of many (n, 6)."""
        part = [y[..., k] + 1j * y[..., k + 1] for k in (0, 2, 4)]
        return self.ki * part[0] + self.kp * part[1] + self.kd * part[2]

    def rhs(self, t: float, y: np.ndarray) -> list[float]:
        """Return dy/dt."""
        theta, speed = self.angle(t)
        integral, r, v = complex(y[0], y[1]), complex(y[2], y[3]), complex(y[4], y[5])
        current = self.kp * r + self.ki * integral + self.kd * v
        force = self.crack(theta, r) + self.amb(r, current)
        force += unbalance_force(theta, speed, self.mass, self.eccentricity, self.phase)
        a = (force - self.damping * v - self.stiffness * r) / self.mass
        return [r.real, r.imag, v.real, v.imag, a.real, a.imag]

    def solve(self, time: np.ndarray, start: np.ndarray | None = None, rtol: float = 1e-11) -> np.ndarray:
        """Return y at the times (n, 6) by Dormand-Prince 8(5,3)."""
        y0 = np.zeros(6) if start is None else start
        largest = math.pi / 8 / max(self.speed, 1.0)  # no step may jump over the crack's switching
        found = solve_ivp(self.rhs, (0.0, float(time[-1])), y0, "DOP853", time, rtol=rtol, atol=1e-15, max_step=largest)
        return found.y.T

    def linear(self) -> ForcedLinear:
        """Return the linear model at constant speed, state [int r, r, r'] (complex)."""
        m = self.mass
        stiffness = self.stiffness - self.force_displacement + self.force_current * self.kp
        damping = self.damping + self.force_current * self.kd
        matrix = np.array([[0, 1, 0], [0, 0, 1], [-self.force_current * self.ki / m, -stiffness / m, -damping / m]])
        forces = {k: p * self.crack_stiffness * self.sag + 0j for k, p in participation(self.terms).items()}
        unbalance = m * self.eccentricity * self.speed**2 * np.exp(1j * self.phase)
        forces[1] = forces.get(1, 0j) + unbalance
        return ForcedLinear(matrix, {k: np.array([0, 0, f / m]) for k, f in forces.items()}, self.speed)

    def settled(self) -> tuple[dict[int, complex], dict[int, complex]]:
        """Return the harmonics of displacement and current of the settled motion (the integral included)."""
        states = self.linear().settled()
        displacement = {k: complex(y[1]) for k, y in states.items()}
        current = {k: complex(self.ki * y[0] + self.kp * y[1] + self.kd * y[2]) for k, y in states.items()}
        return displacement, current

    def exact(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return r(t) and i(t), complex, from rest: settled motion plus exact transient (constant speed)."""
        y = self.linear().at(time, np.zeros(3))
        return y[:, 1], self.ki * y[:, 0] + self.kp * y[:, 1] + self.kd * y[:, 2]
