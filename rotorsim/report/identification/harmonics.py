"""Figures of a model beside the measured harmonics that it was identified from: spectra, curves over speed, orbits."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from rotorsim.identification.harmonic.experiment import open_experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.identification.identification import HarmonicIdentification
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import Recording
from rotorsim.report.comparison.harmonics import Comparison, predicted_runs
from rotorsim.report.figures.orbits import orbits_figure
from rotorsim.report.figures.spectra import spectra_figure
from rotorsim.report.figures.speed_curves import speed_curves_figure
from rotorsim.report.identification.parameters import heading
from rotorsim.report.style import RED, Look

MODEL = Look("model", RED, "o", "--", 8.0)


def compare(identification: HarmonicIdentification, recording: Recording) -> Comparison:
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


def harmonic_figures(identification: HarmonicIdentification, recording: Recording) -> dict[str, Figure | None]:
    """Return full spectra, curves over speed and orbits, None where there is nothing to show."""
    compared = compare(identification, recording)
    return {
        "spectrum": spectra_figure(compared),
        "speed_curve": speed_curves_figure(compared),
        "orbits": orbits_figure(compared),
    }
