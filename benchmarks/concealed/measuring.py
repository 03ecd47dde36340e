"""From motion to what a recorder holds: noise, converters, pulses of the tacho."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.simulate import Motion

Array = NDArray[Any]


@dataclass(frozen=True)
class Instruments:
    """Noise (standard deviation) and converters of displacement [m] and current [A]; jitter of the tacho [s]."""

    noise: tuple[float, float]
    span: tuple[float, float]  # the converter covers +-span
    bits: int
    jitter: float

    @property
    def lsb(self) -> tuple[float, float]:
        """Steps of the converters."""
        return self.span[0] * 2.0 ** (1 - self.bits), self.span[1] * 2.0 ** (1 - self.bits)


def draw_instruments(rng: np.random.Generator, peaks: tuple[float, float]) -> Instruments:
    """Draw instruments whose spans hold the largest motion and current."""
    noise = np.exp(rng.uniform(np.log([6e-9, 1e-4]), np.log([5e-8, 8e-4])))
    steps = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0])
    span = []
    for peak, unit in zip(peaks, (1e-5, 0.1), strict=True):
        fits = np.concatenate([steps * unit * 10.0**k for k in range(4)])
        span.append(float(fits[np.searchsorted(fits, 1.3 * peak)]))
    return Instruments(
        (float(noise[0]), float(noise[1])),
        (span[0], span[1]),
        int(rng.choice([16, 18])),
        float(rng.uniform(3e-7, 2e-6)),
    )


def convert(value: Array, noise: float, span: float, lsb: float, rng: np.random.Generator) -> Array:
    """Return noisy readings in whole steps of the converter, as real arrays."""
    read = np.round((value + noise * rng.standard_normal(value.shape)) / lsb)
    top = np.floor(span / lsb)
    return np.clip(read, -top, top - 1) * lsb


def read_signals(
    motion: Motion, instruments: Instruments, rng: np.random.Generator, coarse: float
) -> list[dict[str, Array]]:
    """Return for each lane its columns: x3, y3 ... (or x, y on one node), ix, iy."""
    probes = [name for name in motion.signals if name[0] == "p"]
    runs: list[dict[str, Array]] = []
    for lane in range(len(motion.clock.theta)):
        columns: dict[str, Array] = {}
        for name in [*probes, "current"]:
            which = int(name == "current")
            lsb = instruments.lsb[which] if which or not coarse else coarse
            place = "" if len(probes) == 1 else name[1:]
            for axis, value in (("x", motion.signals[name][lane].real), ("y", motion.signals[name][lane].imag)):
                column = f"i{axis}" if which else f"{axis}{place}"
                columns[column] = convert(value, instruments.noise[which], instruments.span[which], lsb, rng)
        runs.append(columns)
    return runs


def pulses(motion: Motion, duration: float, jitter: float, rng: np.random.Generator) -> list[list[float]]:
    """Return for each lane the times at which the shaft angle passes whole turns, to 0.1 us."""
    grid = np.linspace(0.0, duration, 2001)
    theta = motion.angle(grid[None, None])[:, 0]
    out = []
    for lane, angle in enumerate(theta):
        turns = 2 * np.pi * np.arange(np.ceil(angle[0] / (2 * np.pi)), np.floor(angle[-1] / (2 * np.pi)) + 1)
        t = np.interp(turns, angle, grid)
        for _ in range(4):  # secant steps on the true angle
            here = motion.angle(t[None, None])[lane, 0]
            slope = (motion.angle((t + 1e-6)[None, None])[lane, 0] - here) / 1e-6
            t = t - (here - turns) / slope
        t = np.round(t + jitter * rng.standard_normal(len(t)), 7)
        out.append([float(v) for v in t if 0 <= v < duration])
    return out
