"""A Jeffcott rotor in a magnetic bearing that runs up and coasts down, by matrix exponentials, and what is recorded.

m q'' + c q' + (k - k_s + K_a) q = -k_i i + f,   i = K_P q + K_I int q dt + K_D q',   q = x + i y
f = f_crack + m e (W^2 - i W') e^{i (theta + beta)} + k b e^{i (theta + gamma)},   K_a q = k_a y in the plane of y

f_crack = 1/2 s(a) dk sag (1 + e^{2 i a}), s = 1/2 + 2/pi (cos a - cos 3a / 3 + ...), a = theta + phase. Thesis (2.26).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import tau
from pathlib import Path

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from rotorsim.errors import Place
from rotorsim.recordings.recording import Channel, Recording, Run

MASS, STIFFNESS, SAG = 2.0, 7.6e5, 26e-6
RATE = 5000.0
NOISE = {"x": 3e-8, "y": 3e-8, "ix": 5e-4, "iy": 5e-4}  # white, rms; a third of it is slow, a third pick-up
JITTER = 1.5e-6  # s, of a pulse
GAINS = {"controller.KP": 12200.0, "controller.KI": 2000.0, "controller.KD": 3.0}
OTHER = {"controller.KP": 9500.0, "controller.KI": 2000.0, "controller.KD": 4.2}
CHANNELS = {
    name: Channel(name, signal, name[-1], None, None, unit)
    for name, signal, unit in (
        ("x", "rotor.displacement", "m"),
        ("y", "rotor.displacement", "m"),
        ("ix", "controller.current", "A"),
        ("iy", "controller.current", "A"),
    )
}
GAUSS = ((0.5 - np.sqrt(0.15), 5 / 18), (0.5, 8 / 18), (0.5 + np.sqrt(0.15), 5 / 18))  # nodes and weights in a step

Angle = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]  # of t: theta, W, W'


@dataclass(frozen=True)
class Machine:
    """Parameters as the diagram `jeffcott` names them, and what it has not: a bow [m], a stiffness in y [N/m]."""

    viscous_damping: float = 82.0
    crack_stiffness: float = 2.4e5
    crack_phase: float = -0.4
    eccentricity: float = 17e-6
    unbalance_phase: float = 0.9
    force_displacement_factor: float = 107e3
    force_current_factor: float = 43.0
    bow: float = 0.0
    bow_phase: float = 1.2
    stiffness_y: float = 0.0

    @property
    def parameters(self) -> dict[str, float]:
        """What `identify` is to find."""
        hidden = ("bow", "bow_phase", "stiffness_y")
        return {name: value for name, value in vars(self).items() if name not in hidden}


def drawn(seed: int) -> Machine:
    """Return a machine of chance."""
    rng = np.random.default_rng(seed)
    return Machine(
        viscous_damping=rng.uniform(60, 95),
        crack_stiffness=rng.uniform(1.5e5, 3.5e5),
        crack_phase=rng.uniform(-3, 3),
        eccentricity=rng.uniform(12e-6, 24e-6),
        unbalance_phase=rng.uniform(-3, 3),
        force_displacement_factor=rng.uniform(9.8e4, 11.2e4),
        force_current_factor=rng.uniform(40, 44.5),
    )


def ramp(first: float, last: float, duration: float, bent: float = 0.0) -> Angle:
    """Return an angle whose speed goes from one value [rpm] to another; bent: share of an S in it."""
    a, b = first * tau / 60, last * tau / 60

    def angle(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        u, w = t / duration, tau / duration
        theta = 0.7 + a * t + (b - a) * (duration * u**2 / 2 + bent * (np.cos(w * t) - 1) / (tau * w))
        speed = a + (b - a) * (u - bent * np.sin(w * t) / tau)
        return theta, speed, (b - a) / duration * (1 - bent * np.cos(w * t))

    return angle


def held(angle: Angle, since: float) -> Angle:
    """Return an angle that goes on at the speed it has at an instant."""
    there = [float(part[0]) for part in angle(np.array([since]))]

    def after(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        theta, speed, acceleration = angle(np.minimum(t, since))
        late = t > since
        theta = np.where(late, there[0] + there[1] * (t - since), theta)
        return theta, speed, np.where(late, 0.0, acceleration)

    return after


def motion(machine: Machine, gains: Mapping[str, float], angle: Angle, t: np.ndarray) -> np.ndarray:
    """Return displacement and current [x, y, ix, iy] (n, 4) at even instants, settled at the speed of the first."""
    KP, KI, KD = gains.values()
    k, h = STIFFNESS - machine.force_displacement_factor, t[1] - t[0]
    ki, m = machine.force_current_factor, MASS
    A = np.zeros((6, 6))  # q, q', int q, each in x and y
    A[:2, 2:4] = A[4:, :2] = np.eye(2)
    A[2:4, :2] = -np.diag([k + ki * KP, k + ki * KP + machine.stiffness_y]) / m
    A[2:4, 2:4] = -np.eye(2) * (machine.viscous_damping + ki * KD) / m
    A[2:4, 4:] = -np.eye(2) * ki * KI / m
    B = np.vstack([np.zeros((2, 2)), np.eye(2) / m, np.zeros((2, 2))])
    values, vectors = np.linalg.eig(A)
    before = np.arange(-round(1.0 / h), 0) * h + t[0]  # the slow integrators are settled by their mean below
    every = np.concatenate([before, t])
    theta0, speed0, _ = (float(part[0]) for part in angle(t[:1]))

    def force(at: np.ndarray) -> np.ndarray:
        theta, speed, acceleration = angle(np.maximum(at, t[0]))
        early = at < t[0]
        theta = np.where(early, theta0 + speed0 * (at - t[0]), theta)
        acceleration = np.where(early, 0.0, acceleration)
        a = theta + machine.crack_phase
        opening = 0.5 + 2 / np.pi * sum((-1) ** j / (2 * j + 1) * np.cos((2 * j + 1) * a) for j in range(5))
        f = 0.5 * opening * machine.crack_stiffness * SAG * (1 + np.exp(2j * a))
        turned = np.exp(1j * (theta + machine.unbalance_phase))
        f = f + m * machine.eccentricity * (speed**2 - 1j * acceleration) * turned
        f = f + STIFFNESS * machine.bow * np.exp(1j * (theta + machine.bow_phase))
        return np.stack([f.real, f.imag], axis=1)

    left = np.linalg.inv(vectors)
    pushed = sum(
        weight * h * force(every[:-1] + node * h) @ (left @ expm(A * h * (1 - node)) @ B).T for node, weight in GAUSS
    )
    mean = force(every[: len(before)]).mean(axis=0)
    start = left @ np.concatenate([np.zeros(4), mean / (ki * KI)])  # the integrators carry the mean force
    modal = np.stack(
        [
            lfilter([1.0], [1.0, -np.exp(value * h)], np.concatenate([[x], own]))
            for value, x, own in zip(values, start, pushed.T, strict=True)
        ],
        axis=1,
    )
    state = (modal @ vectors.T).real[len(before) :]
    current = KP * state[:, :2] + KD * state[:, 2:4] + KI * state[:, 4:]
    return np.concatenate([state[:, :2], current], axis=1)


@dataclass(frozen=True)
class Ring:
    """A stator ring that the rotor rubs on: gap [m], stiffness [N/m], friction; the surface moves forwards."""

    gap: float = 9e-6
    stiffness: float = 3e5
    friction: float = 0.1


def rubbing(machine: Machine, ring: Ring, gains: Mapping[str, float], angle: Angle, t: np.ndarray) -> np.ndarray:
    """Return displacement and current [x, y, ix, iy] (n, 4) by Runge-Kutta steps of half a sample, from rest."""
    KP, KI, KD = gains.values()
    k, h = STIFFNESS - machine.force_displacement_factor, (t[1] - t[0]) / 2
    ki, m = machine.force_current_factor, MASS
    theta, speed, acceleration = angle(t[0] + h / 2 * np.arange(4 * len(t) + 1))
    a = theta + machine.crack_phase
    opening = 0.5 + 2 / np.pi * sum((-1) ** j / (2 * j + 1) * np.cos((2 * j + 1) * a) for j in range(5))
    f = 0.5 * opening * machine.crack_stiffness * SAG * (1 + np.exp(2j * a))
    turned = np.exp(1j * (theta + machine.unbalance_phase))
    force = (f + m * machine.eccentricity * (speed**2 - 1j * acceleration) * turned).tolist()
    gap, stiff, turn = ring.gap, ring.stiffness, 1 + 1j * ring.friction

    def rates(q: complex, v: complex, z: complex, f: complex) -> tuple[complex, complex, complex]:
        rho = abs(q)
        pressed = stiff * (rho - gap) * turn * q / rho if rho > gap else 0.0
        return v, (f - pressed - (k + ki * KP) * q - (machine.viscous_damping + ki * KD) * v - ki * KI * z) / m, q

    mean = np.mean(force[: len(force) // 20])
    x = (0j, 0j, complex(mean / (ki * KI)))
    rows = []
    for n in range(2 * len(t)):
        if n % 2 == 0:
            rows.append((x[0], KP * x[0] + KD * x[1] + KI * x[2]))
        start, middle, end = force[2 * n : 2 * n + 3]
        k1 = rates(*x, start)
        k2 = rates(*(s + h / 2 * d for s, d in zip(x, k1, strict=True)), middle)
        k3 = rates(*(s + h / 2 * d for s, d in zip(x, k2, strict=True)), middle)
        k4 = rates(*(s + h * d for s, d in zip(x, k3, strict=True)), end)
        x = tuple(s + h / 6 * (a + 2 * b + 2 * c + d) for s, a, b, c, d in zip(x, k1, k2, k3, k4, strict=True))
    q, i = np.array(rows).T
    return np.stack([q.real, q.imag, i.real, i.imag], axis=1)


def pulses(angle: Angle, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return when the angle passes whole turns, with jitter, to 0.1 us."""
    theta = angle(t)[0]
    turns = tau * np.arange(np.ceil(theta[0] / tau), np.floor(theta[-1] / tau) + 1)
    at = np.interp(turns, theta, t)
    for _ in range(3):
        now, speed, _ = angle(at)
        at = at - (now - turns) / speed
    return np.round(at + JITTER * rng.normal(size=len(at)), 7)


def recorded(
    name: str,
    machine: Machine,
    angle: Angle,
    duration: float,
    seed: int,
    gains: Mapping[str, float] = GAINS,
    ring: Ring | None = None,
) -> Run:
    """Return a run with white noise, slow noise, and pick-up of 50 Hz."""
    rng, n = np.random.default_rng(seed), round(duration * RATE)
    t = np.arange(n) / RATE
    moved = motion(machine, gains, angle, t) if ring is None else rubbing(machine, ring, gains, angle, t)
    clean = dict(zip(NOISE, moved.T, strict=True))
    values = {}
    for column, signal in clean.items():
        pole = np.exp(-tau * 5 / RATE)
        slow = lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.normal(size=n + 3000))[3000:]
        hum = np.sqrt(2) * np.sin(tau * 50.02 * t + rng.uniform(0, 7))
        values[column] = signal + NOISE[column] * (rng.normal(size=n) + slow / 3 + hum / 3)
    tacho = pulses(angle, t, rng)
    return Run(name, f"{name}.npz", t, values, None, tacho, dict(gains), "identify", Place(""), RATE)


def recording(*runs: Run) -> Recording:
    """Return a recording in memory."""
    return Recording("rig", "simulated", Path(), CHANNELS, runs)


def runs_of(machine: Machine, seed: int = 1, duration: float = 5.0, ring: Ring | None = None) -> Recording:
    """Return a run-up, a coast-down, and a run-up with other gains."""
    up, down, other = (
        ramp(500, 5600, duration, 0.5),
        ramp(5600, 600, 0.8 * duration, 0.3),
        ramp(550, 4800, 0.7 * duration),
    )
    return recording(
        recorded("up", machine, up, duration, 10 * seed, ring=ring),
        recorded("down", machine, down, 0.8 * duration, 10 * seed + 1, ring=ring),
        recorded("other", machine, other, 0.7 * duration, 10 * seed + 2, OTHER, ring),
    )
