"""A diagram driven as recorded beside what was measured, in time."""

from __future__ import annotations

from matplotlib.figure import Figure

from rotorsim.identification.as_recorded import MEASURED_PREFIX, AsRecorded
from rotorsim.report.comparison.samples import SampleComparison, Trace
from rotorsim.report.figures.samples import SIMULATED_LOOK, beside_figure


def as_recorded_figure(found: AsRecorded) -> Figure:
    """Return the measured signals of a run beside the simulated ones, with the worst stretch of each."""
    result = found.result
    traces = tuple(
        Trace(found.run, name, found.units[name], result.time, result[MEASURED_PREFIX + name], (result[name],))
        for name in found.outputs
    )
    title = f"{result.provenance['diagram']} driven as recorded in {result.provenance['recording']}"
    return beside_figure(SampleComparison((SIMULATED_LOOK,), traces, title))
