"""Intervals and verdicts from orders over the speed: python -m benchmarks.identification.in_orders [MACHINES].

Run-ups and coast-downs of discs that SciPy integrates, 1X of every turn with white or slow noise, and slow roll. The
diagram lacks nothing, or a second plane: the other half of what is measured is then of another stiffness.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.identification import identify
from rotorsim.identification.in_orders import OrderIdentification
from rotorsim.model.load import load
from rotorsim.recordings.orders import load_orders
from tests.identification.waveform.orders import ROTOR, SLOW_ROLL, TRUTH, passage, write

NOISE = 1e-7  # m, standard deviation of real and imaginary part, at amplitudes of 1e-5 to 1e-4
SLOW = 0.8  # correlation of slow noise from turn to turn
SPREAD = {"unbalance.eccentricity": 0.3, "unbalance.phase": 0.5, "rotor.stiffness": 0.05, "rotor.viscous_damping": 0.4}


def machine(random: np.random.Generator) -> dict[str, float]:
    """Return the parameters of a disc."""
    return {name: value * float(np.exp(SPREAD[name] * random.uniform(-1, 1))) for name, value in TRUTH.items()}


def identified(
    diagram: Diagram, folder: Path, seed: int, rate: float, slow: bool, split: float
) -> tuple[OrderIdentification, dict[str, float]]:
    """Return what orders say of a machine, and the truth; split: of the stiffness, in the other plane."""
    random = np.random.default_rng(seed)
    truth = machine(random)
    start = 1250.0 if rate > 0 else 2050.0
    speed, _, vectors = passage(start, rate, 1, rows=100, truth=truth)
    if split:
        other = {**truth, "rotor.stiffness": truth["rotor.stiffness"] * (1 + split)}
        vectors = (vectors + passage(start, rate, 1, rows=100, truth=other)[2]) / 2
    noise = random.normal(size=len(speed)) + 1j * random.normal(size=len(speed))
    if slow:
        noise = lfilter([np.sqrt(1 - SLOW**2)], [1, -SLOW], noise)
    found = identify(diagram, load_orders(write(folder / "r", speed, vectors + SLOW_ROLL + NOISE * noise)))
    assert isinstance(found, OrderIdentification)
    return found, truth


def main() -> None:
    """Print a line per case."""
    machines = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "disc.json").write_text(json.dumps(ROTOR))
        diagram = load(str(folder / "disc.json"))
        for rate, slow, split in (
            (230.0, False, 0.0),
            (-150.0, False, 0.0),
            (230.0, True, 0.0),
            (230.0, False, 0.03),
            (230.0, False, 0.1),
        ):
            held, adequate = [], []
            for seed in range(machines):
                found, truth = identified(diagram, folder, seed, rate, slow, split)
                adequate.append(found.adequate)
                held += [
                    found.parameters[name].interval90[0] <= value <= found.parameters[name].interval90[1]
                    for name, value in truth.items()
                ]
            hidden = f"planes {100 * split:.0f} % apart" if split else "nothing hidden"
            case = f"{rate:+.0f} rpm/s, {'slow' if slow else 'white'} noise, {hidden}"
            share, explained = 100 * np.mean(held), 100 * np.mean(adequate)
            print(f"{case:50} intervals hold {share:3.0f} %, explained {explained:3.0f} %", flush=True)


if __name__ == "__main__":
    main()
