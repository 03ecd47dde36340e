"""The picture of a missing signal: a valve's overlap that a diagram lacks, in recordings of benchmarks.generic."""

from __future__ import annotations

import tempfile
from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.generic import sets
from rotorsim import diagnose, load, load_recording
from rotorsim.report.figures.missing_signal import missing_signal_figure

DIAGRAM = "hydraulic_cylinder"
DIAGRAMS = Path(sets.__file__).parent / "diagrams"


def overlap_picture() -> Figure:
    """Return what a diagnosis draws of the missing signal of a hydraulic cylinder whose valve has overlap."""
    with tempfile.TemporaryDirectory() as folder:
        [job] = sets.plan(Path(folder), 1, 0, "one", (DIAGRAM,), ("dead_zone",))
        case = str(sets.one(job)["case"])
        measured, diagram = load_recording(Path(folder) / case), load(DIAGRAMS / f"{DIAGRAM}.json")
        found = diagnose(diagram, measured, physics={"dead_zone"}, workers=1)
    return missing_signal_figure(found.signals[0])
