"""Figures of a diagram beside the samples in time that it was identified from: signals, residuals, autocorrelation."""

from __future__ import annotations

from matplotlib.figure import Figure

from rotorsim.identification.in_time import TimeIdentification
from rotorsim.recordings.recording import Recording
from rotorsim.report.figures.samples import Beside, beside_figure, residuals_in_time_figure
from rotorsim.report.identification.parameters import heading

RUNS_OF_USE = {"identify": "fitted runs", "hold_out": "hold-out runs"}


def traces_of(identification: TimeIdentification, use: str) -> list[Beside]:
    """Return every output of every run of a use, where it was measured and does not diverge."""
    return [
        Beside(item.run.id, name, identification.units[name], item.run.time, item.run.values[name], simulated)
        for item in identification.runs
        if item.use == use
        for name, simulated in item.simulated.items()
        if (item.run.values[name] == item.run.values[name]).any() and (simulated == simulated).all()
    ]


def sample_figures(identification: TimeIdentification, recording: Recording) -> dict[str, Figure | None]:
    """Return signals of fitted and of hold-out runs, and the residuals of the fitted ones; None without any."""
    title = heading(identification, recording)
    fitted, held = (traces_of(identification, use) for use in RUNS_OF_USE)
    return {
        "simulated": beside_figure(fitted, f"{RUNS_OF_USE['identify'].capitalize()}, {title}") if fitted else None,
        "hold_out": beside_figure(held, f"{RUNS_OF_USE['hold_out'].capitalize()}, {title}") if held else None,
        "residual": residuals_in_time_figure(fitted, f"Residuals, {title}") if fitted else None,
    }
