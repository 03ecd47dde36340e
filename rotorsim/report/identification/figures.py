"""Figures of an identification: parameters, correlation, full spectra, curves over speed, orbits.

Measured and predicted side by side; displacements in um, speeds in rpm, amplitudes 0-peak, bars and intervals 90 %.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from rotorsim.identification.experiment import open_experiment
from rotorsim.identification.identification import Identification
from rotorsim.identification.likelihood import Likelihood
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import Recording
from rotorsim.report.comparison.harmonics import Comparison, predicted_runs
from rotorsim.report.figures.orbits import orbits_figure
from rotorsim.report.figures.run import save_figure
from rotorsim.report.figures.spectra import spectra_figure
from rotorsim.report.figures.speed_curves import speed_curves_figure
from rotorsim.report.identification.parameters import correlation_figure, heading, parameters_figure
from rotorsim.report.style import RED, Look

MODEL = Look("model", RED, "o", "--", 8.0)


def compare(identification: Identification, recording: Recording) -> Comparison:
    """Return the identified model beside the recording that it was made from."""
    experiment = open_experiment(
        identification.diagram,
        recording,
        runs=[item.run for item in identification.runs],
        given=identification.settings.get("given", ()),
        free=identification.free,
        harmonics=identification.runs,
    )
    theta = np.array([identification.parameters[item.name].value for item in experiment.free])
    with one_thread():
        runs = predicted_runs(experiment, theta, Likelihood(experiment).evaluate(theta).Y)
    return Comparison(((MODEL, runs),), heading(identification, recording))


def identification_figures(identification: Identification, recording: Recording) -> dict[str, Figure]:
    """Return the figures of an identification by name, those left out that have nothing to show."""
    compared = compare(identification, recording)
    made = {
        "parameters": parameters_figure(identification, recording),
        "correlation": correlation_figure(identification, recording),
        "spectrum": spectra_figure(compared),
        "speed_curve": speed_curves_figure(compared),
        "orbits": orbits_figure(compared),
    }
    return {name: one for name, one in made.items() if one is not None}


def save_figures(identification: Identification, recording: Recording, folder: str | Path) -> list[Path]:
    """Write the figures of an identification into a folder as PNG; return the files."""
    files = {
        Path(folder) / f"{name}.png": made for name, made in identification_figures(identification, recording).items()
    }
    for file, made in files.items():
        save_figure(made, file)
    return list(files)
