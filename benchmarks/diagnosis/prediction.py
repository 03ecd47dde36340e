"""Simulation of a run from its beginning: python -m benchmarks.diagnosis.prediction FOLDER DIAGRAM ... [--start 50].

FOLDER holds a recording (recording.json). Each diagram is simulated as it is through every run with "use": "hold_out";
the state at the first sample is estimated from the first ``--start`` samples alone, and the error of the rest is
printed, its root mean square in the unit of the signal and in parts of its scatter.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.noise import variance_scale
from rotorsim.identification.waveform.recorded.data import channels_of
from rotorsim.identification.waveform.recorded.reading import read_runs
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.subsystems import subsystems_of
from rotorsim.model.load import load
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.recording import Recording

START = 50  # samples
SUBSTEPS = 8  # between samples, of the simulation


@dataclass(frozen=True)
class Error:
    """Root mean square of the error of a signal after the first samples of a run, and of the signal about its mean."""

    rms: float
    scatter: float
    unit: str


def predicted(diagram: Diagram, recording: Recording, start: int = START) -> Mapping[tuple[str, str], Error]:
    """Return the errors of a diagram as it is in hold-out runs, {(run, signal): error}."""
    channels = channels_of(diagram, recording)
    runs = read_runs(diagram, recording.select("hold_out"), channels)
    units = {name: recording.channels[column].unit for name, column in channels.columns.items()}
    found: dict[tuple[str, str], Error] = {}
    for run in runs:
        systems = subsystems_of(diagram, channels)[:1]
        search = OutputErrorSearch(systems, [run.first(start)], {}, SUBSTEPS, hold="theta")
        scale = variance_scale(search)
        search = OutputErrorSearch(systems, search.runs, {k: 1 / v for k, v in scale.items()}, SUBSTEPS, hold="theta")
        known = search.starts(search.minimise(search.first()).unknowns)
        whole = OutputErrorSearch(systems, [run], search.weights, SUBSTEPS, hold="theta")
        unknowns = whole.first(known)
        evaluation = whole.evaluate(unknowns, whole.substeps(unknowns), sensitivities=False)
        for c, signal in enumerate(systems[0].equations.outputs):
            if not np.isfinite(evaluation.cost):
                found[run.id, signal] = Error(np.inf, 1.0, units[signal])
                continue
            error, measured = evaluation.residuals[0][0][start:, c], whole.measured[0][0][start:, c]
            rms = float(np.sqrt(np.nanmean(error**2)))
            found[run.id, signal] = Error(rms, float(np.nanstd(measured)), units[signal])
    return found


def main() -> None:
    """Print the errors of every diagram."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("diagrams", nargs="+")
    parser.add_argument("--start", type=int, default=START)
    given = parser.parse_args()
    recording = load_recording(given.folder)
    for name in given.diagrams:
        for (run, signal), error in predicted(load(name), recording, given.start).items():
            share = 100 * error.rms / error.scatter
            print(
                f"{name}: {run} after {given.start} samples: {signal} {error.rms:.4g} {error.unit} rms, {share:.3g} %"
            )


if __name__ == "__main__":
    main()
