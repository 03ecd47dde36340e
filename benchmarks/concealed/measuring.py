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


NUISANCES = ("hum", "pink", "drift", "lost", "jitter", "pulses")


@dataclass(frozen=True)
class Nuisances:
    """Ordinary defects of a measuring chain, that are no physics of the machine; all off by default.

    hum: lines (frequency [Hz], 0-peak amplitude in standard deviations of the noise), of the displacements alone, free
    phase. pink: corner [Hz] below which flicker noise exceeds the white. drift: of an offset over a run, standard
    deviations of the noise. lost: gaps in a run, each of so many samples that repeat the one before. jitter: of the
    tacho's pulses, more [s]. grid: of the pulses [s], that are seen at the next instant of it.
    """

    hum: tuple[tuple[float, float], ...] = ()
    pink: float = 0.0
    drift: float = 0.0
    lost: tuple[int, int] = (0, 0)
    jitter: float = 0.0
    grid: float = 0.0


def draw_nuisances(rng: np.random.Generator, names: tuple[str, ...], rate: float) -> Nuisances:
    """Draw the sizes of the nuisances named; sizes do not depend on which others are named."""
    mains = float(rng.choice([50.0, 60.0]) + rng.uniform(-0.05, 0.05))
    largest = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))
    hum = tuple(
        (m * mains, largest * share) for m, share in ((1, 1.0), (2, 0.3), (3, 0.5)) if m == 1 or rng.random() < 0.3
    )
    pink, drift = float(rng.uniform(10, 60)), float(np.exp(rng.uniform(np.log(0.1), np.log(2.0))))
    lost = (int(rng.integers(1, 6)), int(rng.integers(1, 4)))
    jitter = float(rng.uniform(1e-6, 8e-6))
    grid = 1 / rate
    return Nuisances(
        hum if "hum" in names else (),
        pink if "pink" in names else 0.0,
        drift if "drift" in names else 0.0,
        lost if "lost" in names else (0, 0),
        jitter if "jitter" in names else 0.0,
        grid if "pulses" in names else 0.0,
    )


def flicker(n: int, corner: float, rate: float, rng: np.random.Generator) -> Array:
    """Return noise (n,) of density corner / f beside white noise of variance one, down to a period of 16 records."""
    long = 16 * int(2 ** np.ceil(np.log2(n)))
    f = np.fft.rfftfreq(long, 1 / rate)
    wave = rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))
    wave[1:] *= np.sqrt(corner / f[1:])
    wave[0] = wave[-1] = 0.0
    return np.fft.irfft(wave, long)[:n] * np.sqrt(long / 2)


def disturbed(
    value: Array, noise: float, hum: bool, nuisances: Nuisances, rate: float, rng: np.random.Generator
) -> Array:
    """Return a signal (n,) with what a recorder adds to it before it is converted: flicker noise, hum, a drift."""
    t = np.arange(len(value)) / rate
    if nuisances.pink:
        value = value + noise * flicker(len(t), nuisances.pink, rate, rng)
    if nuisances.drift:
        u = t / t[-1]
        bend, start = rng.standard_normal(2), rng.uniform(-0.5, 0.5)
        value = value + noise * nuisances.drift * (bend[0] * (u + start) + 0.3 * bend[1] * np.sin(np.pi * u))
    for frequency, size in nuisances.hum if hum else ():
        value = value + noise * size * np.sin(2 * np.pi * frequency * t + rng.uniform(0, 2 * np.pi))
    return value


def hold(columns: dict[str, Array], nuisances: Nuisances, rng: np.random.Generator) -> None:
    """Fill gaps, at the same instants of all columns, with the samples before them."""
    gaps, length = nuisances.lost
    n = len(next(iter(columns.values())))
    for at in rng.integers(1, n - length - 1, gaps):
        for values in columns.values():
            values[at : at + length] = values[at - 1]


def convert(value: Array, noise: float, span: float, lsb: float, rng: np.random.Generator) -> Array:
    """Return noisy readings in whole steps of the converter, as real arrays."""
    read = np.round((value + noise * rng.standard_normal(value.shape)) / lsb)
    top = np.floor(span / lsb)
    return np.clip(read, -top, top - 1) * lsb


def read_signals(
    motion: Motion,
    instruments: Instruments,
    rng: np.random.Generator,
    coarse: float,
    nuisances: Nuisances = Nuisances(),
    rate: float = 5000.0,
    more: np.random.Generator | None = None,
) -> list[dict[str, Array]]:
    """Return for each lane its columns: x3, y3 ... (or x, y on one node), ix, iy, ix2, iy2.

    more: random numbers of nuisances
    """
    probes = [name for name in motion.signals if name[0] == "p"]
    currents = [name for name in motion.signals if name[0] == "c"]
    runs: list[dict[str, Array]] = []
    for lane in range(len(motion.clock.theta)):
        columns: dict[str, Array] = {}
        for name in [*probes, *currents]:
            which = int(name in currents)
            lsb = instruments.lsb[which] if which or not coarse else coarse
            place = "" if len(probes) == 1 else name[1:]
            for axis, value in (("x", motion.signals[name][lane].real), ("y", motion.signals[name][lane].imag)):
                column = f"i{axis}{name.removeprefix('current')}" if which else f"{axis}{place}"
                if more is not None:
                    value = disturbed(value, instruments.noise[which], not which, nuisances, rate, more)
                columns[column] = convert(value, instruments.noise[which], instruments.span[which], lsb, rng)
        if more is not None:
            hold(columns, nuisances, more)
        runs.append(columns)
    return runs


def pulses(
    motion: Motion, duration: float, jitter: float, rng: np.random.Generator, sampling: float = 0.0
) -> list[list[float]]:
    """Return for each lane the times at which the shaft angle passes whole turns, to 0.1 us, or to the next sample."""
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
        t = t + jitter * rng.standard_normal(len(t))
        t = np.round(np.ceil(t / sampling) * sampling if sampling else t, 7)
        out.append([float(v) for v in t if 0 <= v < duration])
    return out
