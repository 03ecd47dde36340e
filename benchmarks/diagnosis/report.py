"""What the report of a diagnosis in time costs: python -m benchmarks.diagnosis.report.

The case: a hydraulic cylinder of benchmarks.generic whose valve has overlap, which the diagram lacks; three runs of
4000 to 5000 samples. It is the picture of docs/diagnosis_measured.md, too.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.generic import sets
from benchmarks.harness import Line, at_most, cpu_seconds
from rotorsim import diagnose, load, load_recording
from rotorsim.diagnosis.conclude.verdict import signals_of
from rotorsim.diagnosis.diagnosis import Diagnosis
from rotorsim.jobs.threads import one_thread
from rotorsim.report.diagnosis.report import save_report
from rotorsim.report.figures.missing_signal import missing_signal_figure

DIAGRAM = "hydraulic_cylinder"
DIAGRAMS = Path(sets.__file__).parent / "diagrams"
FIGURES = 3.0  # s: what figures may add to a diagnosis


def overlap(folder: Path) -> Diagnosis:
    """Return the diagnosis of a hydraulic cylinder whose valve has overlap; folder: for its recording."""
    [job] = sets.plan(folder, 1, 0, "one", (DIAGRAM,), ("dead_zone",))
    measured = load_recording(folder / str(sets.one(job)["case"]))
    return diagnose(load(DIAGRAMS / f"{DIAGRAM}.json"), measured, physics={"dead_zone"}, workers=1)


def overlap_picture() -> Figure:
    """Return what a diagnosis draws of the missing signal."""
    with tempfile.TemporaryDirectory() as folder:
        return missing_signal_figure(overlap(Path(folder)).signals[0])


def main() -> None:
    """Print what figures and missing signals cost, beside the target."""
    with tempfile.TemporaryDirectory() as folder, one_thread():
        found = overlap(Path(folder))
        given = found.selection, found.effects, found.after, found.evidence, found.verdict
        save_report(found, Path(folder) / "report")  # fonts are looked for once
        signals = min(cpu_seconds(lambda: signals_of(*given)) for _ in range(3))
        report = min(cpu_seconds(lambda: save_report(found, Path(folder) / "report")) for _ in range(3))
    print(Line("missing signals, CPU", f"{signals:.2f} s"))
    print(at_most("they and the report with its figures, CPU", signals + report, FIGURES, "{:.2f}", "s"))


if __name__ == "__main__":
    main()
