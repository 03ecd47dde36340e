"""How often 90 % intervals from samples in time hold the truth: python -m benchmarks.identification.in_time [MACHINES].

Oscillators by matrix exponentials; noise of 2 % with white, slow (first order below 2 Hz) and 50 Hz parts.
"""

from __future__ import annotations

import sys

import numpy as np

from rotorsim.identification.identification import identify
from rotorsim.model.load import load
from tests.identification.waveform.in_time import OSCILLATOR, RATE, TRUTH, even, measured, recording

CASES = ((4000, 1), (1500, 3), (1000, 1), (400, 1))  # samples of a run, runs
NOISE = 0.02  # of the position's standard deviation


def coverage(samples: int, runs: int, machines: int) -> tuple[float, float]:
    """Return the share of intervals that hold the truth, and the rms of (estimate - truth) / std."""
    held, errors = [], []
    for seed in range(machines):
        made = recording(*(measured(f"run{k}", 100 * seed + k, even(samples), NOISE) for k in range(runs)))
        found = identify(load(OSCILLATOR), made).parameters
        held += [found[name].interval90[0] <= truth <= found[name].interval90[1] for name, truth in TRUTH.items()]
        errors += [(found[name].value - truth) / found[name].std for name, truth in TRUTH.items()]
    return float(np.mean(held)), float(np.sqrt(np.mean(np.square(errors))))


def main() -> None:
    """Print a line per case."""
    machines = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for samples, runs in CASES:
        share, rms = coverage(samples, runs, machines)
        print(f"{runs} x {samples} samples ({samples / RATE:g} s): {100 * share:.0f} % held, errors {rms:.2f} std rms")


if __name__ == "__main__":
    main()
