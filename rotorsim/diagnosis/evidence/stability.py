"""Whether the periodic motion of a diagram is one that a machine settles to, run by run."""

from __future__ import annotations

import numpy as np

from rotorsim.identification.experiment import Experiment

__all__ = ["unsettled"]

GROWS = 0.1  # of a disturbance over the window of a run: growth that a recording of a settled motion would show


def unsettled(experiment: Experiment) -> list[int]:
    """Return the runs whose motion, at the values as given, would grow away by more than GROWS over their windows."""
    rates = experiment.motion.growth(experiment.theta0)
    windows = np.broadcast_to(experiment.motion.windows, rates.shape)
    return np.flatnonzero(rates * windows > GROWS).tolist()
