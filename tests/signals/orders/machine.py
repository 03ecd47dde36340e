"""A rotor of a few modes that runs up, by scipy's DOP853: nothing of rotorsim, and no envelope is assumed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from rotorsim.errors import Place
from rotorsim.recordings.recording import ANGLE, Channel, Recording, Run

RATE = 5000.0  # Hz


@dataclass(frozen=True)
class Mode:
    """w [rad/s], z; unbalance force per mass along x and y [m], complex; order: what drives it, constant unless 1."""

    frequency: float
    damping: float
    x: complex = 0.0
    y: complex = 0.0
    order: int = 1


def run_up(
    modes: Sequence[Mode],
    first: float,
    last: float,
    duration: float,
    *,
    noise: float = 0.0,
    slow_roll: complex = 0.0,
    hum: float = 0.0,
    seed: int = 0,
) -> Recording:
    """Return x and y [m] of a run from first to last [rad/s] at constant acceleration, and the shaft angle."""
    a = (last - first) / duration
    time = np.arange(int(duration * RATE)) / RATE

    def angle(t):
        return first * t + a * t**2 / 2

    def rates(t, q):
        n = len(modes)
        out = np.empty_like(q)
        for k, mode in enumerate(modes):
            speed = first + a * t
            g = (speed**2 - 1j * a) if mode.order == 1 else 1.0
            force = g * np.exp(1j * mode.order * angle(t))
            for axis, part in enumerate((mode.x, mode.y)):
                j = 2 * k + axis
                out[j] = q[2 * n + j]
                free = -(mode.frequency**2) * q[j] - 2 * mode.damping * mode.frequency * q[2 * n + j]
                out[2 * n + j] = free + (part * force).real
        return out

    found = solve_ivp(rates, (0.0, time[-1]), np.zeros(4 * len(modes)), "DOP853", time, rtol=1e-9, atol=1e-14)
    x, y = (found.y[axis : 2 * len(modes) : 2].sum(axis=0) for axis in (0, 1))
    turning = (slow_roll * np.exp(1j * angle(time))).real
    mains = hum * np.sin(2 * np.pi * 50.0 * time + 0.4)
    return _recorded(time, angle(time), x + turning + mains, y + mains, noise, seed)


def gyroscopic_run_up(
    w: float, z: float, gyro: float, eccentricity: float, first: float, last: float, duration: float, noise: float
) -> Recording:
    """Return a run of one mode with gyroscopic moments: q'' + (2 z w - i W gyro) q' + w^2 q = e (W^2 - i W') e^it."""
    a = (last - first) / duration
    time = np.arange(int(duration * RATE)) / RATE

    def rates(t, q):
        speed = first + a * t
        force = eccentricity * (speed**2 - 1j * a) * np.exp(1j * (first * t + a * t**2 / 2))
        return np.array([q[1], force - (2 * z * w - 1j * speed * gyro) * q[1] - w**2 * q[0]])

    found = solve_ivp(rates, (0.0, time[-1]), np.zeros(2, complex), "DOP853", time, rtol=1e-9, atol=1e-14)
    return _recorded(time, first * time + a * time**2 / 2, found.y[0].real, found.y[0].imag, noise, 0)


def _recorded(time, angle, x, y, noise, seed) -> Recording:
    rng = np.random.default_rng(seed)
    values = {
        "x": x + noise * rng.standard_normal(len(time)),
        "y": y + noise * rng.standard_normal(len(time)),
        "angle": angle,
    }
    channels = {
        "x": Channel("x", "rotor.displacement", "x", None, None, "m"),
        "y": Channel("y", "rotor.displacement", "y", None, None, "m"),
        "angle": Channel("angle", ANGLE, None, None, None, "rad"),
    }
    run = Run("up", "up", time, values, None, None, {}, "identify", Place("up"))
    return Recording("machine", "DOP853", Path(), channels, (run,))
