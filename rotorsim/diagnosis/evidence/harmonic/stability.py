"""Whether the periodic motion of a diagram is one that a machine settles to, run by run."""

from __future__ import annotations

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.identification.harmonic.experiment import Experiment


def unsettled(experiment: Experiment) -> list[int]:
    """Return the runs whose motion, as given, would grow by more than ``growth`` over their windows."""
    rates = experiment.motion.growth(experiment.theta0)
    windows = np.broadcast_to(experiment.motion.windows, rates.shape)
    return np.flatnonzero(rates * windows > CRITERIA.growth).tolist()
