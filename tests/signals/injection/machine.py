"""A rotor in magnetic bearings with an injected test signal, in closed form: nothing of rotorsim is used.

Two axes with gyroscopic coupling, controllers with a lag and a delay. Records are made by FFT from S itself, over twice
their length: band-limited test signals have their exact response, transients at the ends of the record included.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

AXES = ("x", "y")


@dataclass(frozen=True)
class Machine:
    """m q'' + (c - i g of a circle) q' + (k - k_s) q = -k_i i, i = PID with lag and delay of V1; SI."""

    mass: float = 2.0
    damping: float = 76.0
    stiffness: float = 654790.0
    gyroscopic: float = 100.0
    force_per_current: float = 42.1
    kp: float = 12200.0
    ki: float = 2000.0
    kd: float = 6.0
    lag: float = 2e-5
    delay: float = 1e-4
    difference: float = 0.1  # of the stiffness of y

    def open_loop(self, hz: np.ndarray) -> np.ndarray:
        """Return G (n, 2, 2), V2 = -G V1."""
        s = 2j * np.pi * np.maximum(np.asarray(hz, float), 1e-6)
        controller = (self.kp + self.ki / s + self.kd * s) * np.exp(-s * self.delay) / (1 + self.lag * s)
        diagonal = self.mass * s**2 + self.damping * s
        D = np.zeros((len(s), 2, 2), complex)
        D[:, 0, 0] = diagonal + self.stiffness
        D[:, 1, 1] = diagonal + self.stiffness * (1 + self.difference)
        D[:, 0, 1], D[:, 1, 0] = self.gyroscopic * s, -self.gyroscopic * s
        return np.linalg.inv(D) * (self.force_per_current * controller)[:, None, None]

    def sensitivity(self, hz: np.ndarray) -> np.ndarray:
        """Return S (n, 2, 2), V1 = S E."""
        return np.linalg.inv(np.eye(2) + self.open_loop(hz))

    def is_stable(self) -> bool:
        """Return whether no pole of S grows, by the argument of det(I + G) along the imaginary axis."""
        hz = np.concatenate([np.geomspace(1e-3, 1.0, 4000), np.arange(1.0, 2e4, 0.02)])
        det = np.linalg.det(np.eye(2) + self.open_loop(hz))
        turned = np.unwrap(np.angle(det))
        return bool(abs(turned[-1] - turned[0] - 2 * (np.pi / 2)) < 1.0)  # two integrators, and no zero to the right


def chirp(time: np.ndarray, low: float, high: float, logarithmic: bool = False) -> np.ndarray:
    """Return a sweep of unit amplitude from 5 to 95 % of a record."""
    time, last = time - 0.05 * time[-1], 0.9 * time[-1]
    if logarithmic:
        rate = np.log(high / low) / last
        phase = 2 * np.pi * low * np.expm1(rate * time) / rate
    else:
        phase = 2 * np.pi * (low * time + (high - low) * time**2 / 2 / last)
    return np.where((time >= 0) & (time <= last), np.sin(phase), 0.0)


def stepped(time: np.ndarray, low: float, high: float, count: int) -> np.ndarray:
    """Return sines of frequencies one after the other, each for as long."""
    which = np.minimum((time / time[-1] * count).astype(int), count - 1)
    return np.sin(2 * np.pi * np.geomspace(low, high, count)[which] * time)


def measured(
    machine: Machine, test: np.ndarray, rate: float, noise: np.ndarray, motion: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return V1 and V2 (n, 2) of a test signal (n, 2), noise of the sensors (n, 2), and steady motion (n, 2) of V2."""
    n = len(test)
    padded = 2 * n
    S = machine.sensitivity(np.fft.rfftfreq(padded, 1 / rate))
    S[-1] = S[-1].real  # at half of the rate a record has no phase

    def through(x: np.ndarray) -> np.ndarray:
        return np.fft.irfft(np.einsum("nij,nj->ni", S, np.fft.rfft(x, padded, axis=0)), padded, axis=0)[:n]

    after = through(test) + through(noise) + (0.0 if motion is None else motion)
    return after, after - test


def write(
    folder: Path,
    rate: float,
    runs: dict[str, dict[str, np.ndarray]],
    roles: tuple[str, ...] = ("test", "before", "after"),
    **of_run: object,
) -> Path:
    """Write a recording of runs: of each "test", "before", "after" (n, 2), in um."""
    folder.mkdir(parents=True, exist_ok=True)
    channels = {
        f"{role} {axis}": {"signal": "controller.displacement", "axis": axis, "injection": role, "unit": "um"}
        for axis in AXES
        for role in roles
    }
    for name, signals in runs.items():
        columns = {f"{role} {axis}": 1e6 * signals[role][:, k] for k, axis in enumerate(AXES) for role in roles}
        np.savez(folder / f"{name}.npz", **columns)
    entries = [{"id": name, "file": f"{name}.npz", "sample_rate": rate, **of_run} for name in runs]
    document = {"kind": "injection", "name": "rig", "source": "closed form", "channels": channels, "runs": entries}
    (folder / "recording.json").write_text(json.dumps(document, indent=1))
    return folder
