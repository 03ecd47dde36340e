"""Figures of an identification: parameters, correlation, and the model beside what was measured.

Measured and predicted side by side; displacements in um, speeds in rpm, bars and intervals 90 %.
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from rotorsim.identification.result import Identification
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import Recording
from rotorsim.report.figures.run import save_figure
from rotorsim.report.identification.parameters import correlation_figure, parameters_figure


def identification_figures(identification: Identification, recording: Recording | OrderRecording) -> dict[str, Figure]:
    """Return the figures of an identification by name, those left out that have nothing to show."""
    made = {
        "parameters": parameters_figure(identification, recording),
        "correlation": correlation_figure(identification, recording),
        **identification.figures_beside(recording),
    }
    return {name: one for name, one in made.items() if one is not None}


def save_figures(
    identification: Identification, recording: Recording | OrderRecording, folder: str | Path
) -> list[Path]:
    """Write the figures of an identification into a folder as PNG; return the files."""
    files = {
        Path(folder) / f"{name}.png": made for name, made in identification_figures(identification, recording).items()
    }
    for file, made in files.items():
        save_figure(made, file)
    return list(files)
