"""Do the intervals hold what they promise? Many seeds of noise on data of an independent program.

python -m benchmarks.identification.coverage [SEEDS]

S1, upper range, additive white noise of 5 % rms, one and two sets of gains.
"""

from __future__ import annotations

import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

LEVEL = 0.05
GAINS = ((12200.0, 2000.0, 3.0), (9000.0, 2000.0, 4.5))
COUNTED = ("crack_stiffness", "eccentricity")


@lru_cache(maxsize=4)
def _clean(sets: int) -> Any:
    from tests.reference.recordings import UPPER, Truth, jeffcott_run

    return [jeffcott_run(Truth(), speed, gains=gains) for gains in GAINS[:sets] for speed in UPPER["jeffcott"]]


def one_seed(argument: dict[str, int]) -> dict[str, Any]:
    """Return values, intervals and verdicts of one draw of the noise."""
    from threadpoolctl import threadpool_limits

    from rotorsim.identification.harmonic.estimate import Search, estimate
    from rotorsim.identification.harmonic.experiment import open_experiment
    from rotorsim.identification.harmonic.likelihood import Likelihood
    from rotorsim.identification.harmonic.profile import profile_intervals
    from rotorsim.identification.verdict import judge
    from rotorsim.model.load import load
    from rotorsim.recordings.loading import load_recording
    from tests.reference.recordings import add_noise, write_recording

    runs = [add_noise(run, LEVEL, (argument["seed"], k)) for k, run in enumerate(_clean(argument["sets"]))]
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1, "blas"):
        recording = load_recording(write_recording(Path(folder), runs, "noisy"))
        search = Search(Likelihood(open_experiment(load("jeffcott"), recording)))
        found = estimate(search)
        intervals = profile_intervals(search, found)
        verdicts = judge(found, intervals)
    return {
        "names": [item.name for item in found.free],
        "values": found.theta.tolist(),
        "std": found.std.tolist(),
        "intervals": intervals.tolist(),
        "identified": [verdict.identifiable for verdict in verdicts],
        "known": [
            [verdict.combination.factors, verdict.combination.value, verdict.combination.std]
            if verdict.combination
            else None
            for verdict in verdicts
        ],
        "goodness": found.goodness,
    }


def cramer_rao(sets: int) -> np.ndarray:
    """Return the standard deviations that no unbiased estimate can undercut, from the sensitivities at the truth."""
    from rotorsim.identification.harmonic.experiment import open_experiment
    from rotorsim.identification.harmonic.likelihood import Likelihood
    from rotorsim.model.load import load
    from rotorsim.recordings.loading import load_recording
    from tests.reference.recordings import Truth, add_noise, write_recording

    runs = [add_noise(run, LEVEL, (0, k)) for k, run in enumerate(_clean(sets))]
    with tempfile.TemporaryDirectory() as folder:
        recording = load_recording(write_recording(Path(folder), runs, "noisy"))
        likelihood = Likelihood(open_experiment(load("jeffcott"), recording))
    truth = Truth()
    J = likelihood.expected(np.array([truth[item.name] for item in likelihood.experiment.free]))
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(J.T @ J))))


def study(seeds: int = 400) -> dict[str, Any]:
    """Return the figures of the promise: coverage, verdicts on k_s, rms errors over the Cramer-Rao bound."""
    from rotorsim.jobs.jobs import run_jobs
    from tests.reference.recordings import Truth

    truth = Truth()
    found: dict[str, Any] = {}
    for sets in (1, 2):
        results = run_jobs(one_seed, [{"seed": seed, "sets": sets} for seed in range(seeds)], chunk=5)
        names = results[0]["names"]
        true = np.array([truth[name] for name in names])
        values = np.array([r["values"] for r in results])
        intervals = np.array([r["intervals"] for r in results])
        inside = (intervals[..., 0] <= true) & (true <= intervals[..., 1])
        error = values - true
        scale = np.where(true == 0, 1.0, np.abs(true))
        rms = np.sqrt((error**2).mean(axis=0))
        entry = {
            "coverage": dict(zip(names, inside.mean(axis=0).tolist(), strict=True)),
            "pooled": float(inside.mean()),
            "rms": dict(zip(names, (rms / scale).tolist(), strict=True)),
            "over_bound": dict(zip(names, (rms / cramer_rao(sets)).tolist(), strict=True)),
            "identified": dict(zip(names, np.mean([r["identified"] for r in results], axis=0).tolist(), strict=True)),
        }
        j = names.index("force_displacement_factor")
        known = [r["known"][j] for r in results if r["known"][j]]
        held = [
            abs(sum(f * truth[name] for name, f in factors.items()) - value) <= 1.645 * std
            for factors, value, std in known
        ]
        entry["combination_coverage"] = float(np.mean(held)) if held else None
        found[str(sets)] = entry
    return found


def main() -> None:
    """Print the coverage and the errors."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    for sets, entry in study(seeds).items():
        print(f"S1, upper range, additive white noise {LEVEL:.0%} rms, {sets} set(s) of gains, {seeds} seeds")
        print(f"{'parameter':28}{'coverage':>10}{'rms error':>12}{'/ bound':>9}{'identified':>12}")
        for name in entry["coverage"]:
            print(
                f"{name:28}{entry['coverage'][name]:10.1%}{entry['rms'][name]:12.3%}{entry['over_bound'][name]:9.2f}"
                f"{entry['identified'][name]:12.1%}"
            )
        print(f"all parameters: {entry['pooled']:.1%} covered")
        if entry["combination_coverage"] is not None:
            print(f"known combination with force_displacement_factor: {entry['combination_coverage']:.1%} covered")


if __name__ == "__main__":
    main()
