"""Figures of a diagram beside the samples in time that it was identified from: signals, residuals, autocorrelation."""

from __future__ import annotations

from matplotlib.figure import Figure

from rotorsim.identification.in_time import TimeIdentification
from rotorsim.recordings.recording import Recording
from rotorsim.report.comparison.samples import SampleComparison, Trace
from rotorsim.report.figures.samples import SIMULATED_LOOK, beside_figure, residuals_in_time_figure
from rotorsim.report.identification.parameters import heading

RUNS_OF_USE = {"identify": "fitted runs", "hold_out": "hold-out runs"}


def traces_of(identification: TimeIdentification, use: str) -> tuple[Trace, ...]:
    """Return every output of every run of a use, where it was measured and does not diverge."""
    return tuple(
        Trace(item.run.id, name, identification.units[name], item.run.time, item.run.values[name], (simulated,))
        for item in identification.runs
        if item.use == use
        for name, simulated in item.simulated.items()
        if (item.run.values[name] == item.run.values[name]).any() and (simulated == simulated).all()
    )


def sample_figures(identification: TimeIdentification, recording: Recording) -> dict[str, Figure | None]:
    """Return signals of fitted and of hold-out runs, and the residuals of the fitted ones; None without any."""
    title = heading(identification, recording)

    def beside(use: str, what: str) -> SampleComparison | None:
        traces = traces_of(identification, use)
        return SampleComparison((SIMULATED_LOOK,), traces, f"{what}, {title}") if traces else None

    fitted, held = (beside(use, words.capitalize()) for use, words in RUNS_OF_USE.items())
    residual = beside("identify", "Residuals")
    return {
        "simulated": None if fitted is None else beside_figure(fitted),
        "hold_out": None if held is None else beside_figure(held),
        "residual": None if residual is None else residuals_in_time_figure(residual),
    }
