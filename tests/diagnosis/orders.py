"""Order vectors of discs with what a diagram lacks, in two planes, by SciPy: nothing of the product.

m q'' + c q' + k q + dk conj(q) - i kc q + k3 |q|^2 q = m e (W^2 - i W') e^{i b} + k bow e^{i (theta + bow_phase)},
q = x + i y, b = theta + phase. Conjugated: dk is half of k_x - k_y.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from tests.identification.waveform.orders import CHANNEL, RPM, SLOW_ROLL, TRUTH

NOISE = 1e-7  # m, standard deviation of real and imaginary part, at amplitudes of 1e-5 to 1e-4
SPREAD = {"unbalance.eccentricity": 0.3, "unbalance.phase": 0.5, "rotor.stiffness": 0.05, "rotor.viscous_damping": 0.4}


@dataclass(frozen=True)
class Disc:
    """A disc of 1 kg; bow [m], split: of its stiffness, k_x - k_y [N/m], cross stiffness [N/m], cubic [N/m^3]."""

    known: dict[str, float] = field(default_factory=lambda: dict(TRUTH))
    bow: float = 0.0
    bow_phase: float = 1.2
    split: float = 0.0
    cross: float = 0.0
    cubic: float = 0.0


def drawn(seed: int, **hidden: float) -> Disc:
    """Return a disc of chance."""
    random = np.random.default_rng(seed)
    known = {name: value * float(np.exp(SPREAD[name] * random.uniform(-1, 1))) for name, value in TRUTH.items()}
    return Disc(known, **hidden)


def passage(disc: Disc, start: float, rate: float, rows: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Return speed [rpm] and 1X [m] along x and y, (rows, 2), of successive turns, after 2.5 s of turning."""
    W0, a = start * RPM, rate * RPM
    e, phase, k, c = disc.known.values()

    def rhs(t: float, s: np.ndarray) -> list[float]:
        W, theta = W0 + a * t, W0 * t + a * t**2 / 2
        q, v = complex(s[0], s[1]), complex(s[2], s[3])
        force = e * (W**2 - 1j * a) * np.exp(1j * (theta + phase)) + k * disc.bow * np.exp(
            1j * (theta + disc.bow_phase)
        )
        force -= k * q + disc.split / 2 * q.conjugate() - 1j * disc.cross * q + disc.cubic * abs(q) ** 2 * q + c * v
        return [v.real, v.imag, force.real, force.imag]

    ends = (np.sqrt(W0**2 + 2 * a * 2 * np.pi * np.arange(rows + 1)) - W0) / a
    found = solve_ivp(rhs, (-2.5, ends[-1]), [0.0] * 4, "DOP853", dense_output=True, rtol=1e-8, atol=1e-13)
    theta = 2 * np.pi * (np.arange(rows)[:, None] + (np.arange(64) + 0.5) / 64)
    time = (np.sqrt(W0**2 + 2 * a * theta) - W0) / a
    x = found.sol(time.ravel())[:2].reshape(2, *theta.shape)
    return 2 * np.pi / np.diff(ends) / RPM, 2 * (x * np.exp(-1j * theta)).mean(axis=2).T


def recorded(vectors: np.ndarray, seed: int, memory: float = 0.0, noise: float = NOISE) -> np.ndarray:
    """Return vectors with slow roll and noise, of which a row keeps a share of the one before."""
    random = np.random.default_rng([seed, 7])
    white = random.normal(size=vectors.shape) + 1j * random.normal(size=vectors.shape)
    return vectors + SLOW_ROLL + noise * lfilter([np.sqrt(1 - memory**2)], [1, -memory], white, axis=0)


def write_runs(
    folder: Path, runs: dict[str, tuple[np.ndarray, np.ndarray]], axes: str = "x", held: str = "", **keys: Any
) -> Path:
    """Write runs {id: (speed [rpm], vectors [m] (n, axes))} as order vectors in um, 0-peak, lead; held: an id."""
    folder.mkdir(exist_ok=True)
    entries = []
    for name, (speed, vectors) in runs.items():
        columns = {"rpm": speed}
        for axis, one in zip(axes, vectors.T, strict=True):
            columns |= {f"amp_{axis}": np.abs(one) * 1e6, f"ph_{axis}": np.degrees(np.angle(one))}
        rows = (",".join(f"{x:.9g}" for x in row) for row in zip(*columns.values(), strict=True))
        (folder / f"{name}.csv").write_text("\n".join([",".join(columns), *rows]) + "\n")
        use = "hold_out" if name == held else "identify"
        entries.append({"id": name, "file": f"{name}.csv", "speed": "rpm", "turns": 1, "use": use})
    channels = {
        f"{axis} 1X": {**CHANNEL, "axis": axis, "amplitude": f"amp_{axis}", "phase": f"ph_{axis}"} for axis in axes
    }
    document = {"kind": "orders", "name": "disc", "source": "made by SciPy", "amplitude": "0-peak", "phase": "lead"}
    (folder / "recording.json").write_text(json.dumps({**document, "channels": channels, "runs": entries, **keys}))
    return folder


def run_up(folder: Path, disc: Disc, seed: int, memory: float = 0.0, axes: str = "x", **keys: Any) -> Path:
    """Write 1X of a run-up through the critical speed of a disc."""
    speed, vectors = passage(disc, 1250.0, 230.0)
    return write_runs(folder, {"up": (speed, recorded(vectors[:, : len(axes)], seed, memory))}, axes, **keys)
