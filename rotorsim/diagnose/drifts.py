"""Offsets of channels that drift within the runs, and what that leaves of their means."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from rotorsim.diagnose.fitting import Fit, Source
from rotorsim.diagnose.values import values_in
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identify.likelihood import Likelihood
from rotorsim.identify.motion import Motion
from rotorsim.recordings.harmonics import RunHarmonics
from rotorsim.recordings.recording import Recording
from rotorsim.units import conversion

__all__ = ["drift_warnings", "find_drifts", "tells_drifts", "with_drifts"]

FALSE_ALARM = 1e-3  # for a channel of a recording
# a random walk that starts with a run has Var(mean) = s^2 T / 3, and s^2 3 T / 10 in its slope's Legendre coefficient
MEAN = 10 / 9
NORM = np.array([3.0, 5.0])  # over n: variance of the Legendre coefficients of degree 1 and 2 for white noise
DRIFTING = 2.0  # times the noise: a diagram that leaves more does not say what drifts of itself
LEAST = 1e-9  # of a channel's information that slow states leave: below, they take all of its drift


def find_drifts(base: Fit, source: Source) -> dict[str, float]:
    """Return channels whose offset drifts within the runs by more than noise, and the rms of the slope, SI.

    The slope is the Legendre coefficient of degree one: half of what the offset changes over a run. What slow states of
    the fitted diagram, which are not in rest yet, share between the channels is no drift of an offset. What remains may
    be any channel's that shares them: each is counted as if it were its own alone.
    """
    try:
        experiment = source.open(source.load(values_in(base.document, base.values)))
    except RotorsimError:
        return {}
    if not isinstance(experiment.motion, Motion):
        return {}
    response = Likelihood(experiment).response(experiment.theta0)
    c = len(experiment.predicted)
    power, size, count = np.zeros(c), np.zeros(c), 0
    for r, item in enumerate(experiment.runs):
        columns = experiment.columns[r][:c]
        if len(item.fit.drift) < 2:
            continue
        std = np.sqrt(np.maximum(np.diag(item.fit.noise.at_order(0)).real[columns] / item.fit.samples, 1e-300))
        slow = response.C[r] @ response.slow_states(r) / std[:, None]
        length = np.linalg.norm(slow, axis=0)
        q = np.linalg.qr(slow[:, length > 0] / length[length > 0])[0]
        free = np.maximum(1 - (q**2).sum(axis=1), LEAST)
        white = item.fit.drift[:2][:, columns] / std
        rest = (white - (white @ q) @ q.T) / free
        known = free > LEAST
        power[known] += (rest**2 * free / NORM[:, None]).sum(axis=0)[known]
        size[known] += (rest[0] ** 2 * std**2)[known] - (NORM[0] * std**2 / free)[known]
        count += 1
    if not count:
        return {}
    drifts = (power > chi2.isf(FALSE_ALARM, 2 * count)) & experiment.use_mean[:c] & (size > 0)
    return {experiment.predicted[k]: float(np.sqrt(size[k] / count)) for k in np.flatnonzero(drifts)}


def with_drifts(runs: Sequence[RunHarmonics], drifts: Mapping[str, float]) -> tuple[RunHarmonics, ...]:
    """Return runs whose means are as uncertain as the offsets of their channels drift."""
    if not drifts:
        return tuple(runs)
    found = []
    for item in runs:
        variance = MEAN * np.array([drifts.get(name, 0.0) for name in item.fit.names]) ** 2
        hum = {**item.fit.hum, 0: item.fit.hum.get(0, 0.0) + variance}
        found.append(replace(item, fit=replace(item.fit, hum=hum)))
    return tuple(found)


def tells_drifts(found: Fit) -> bool:
    """Return whether a fit to runs without their drifts leaves so little that those are drifts of offsets."""
    return not found.failure and found.misfit <= DRIFTING * found.freedom


def drift_warnings(drifts: Mapping[str, float], recording: Recording) -> list[Problem]:
    """Return what is to be said of channels that drift."""
    units = {channel.name: channel.unit for channel in recording.channels.values()}
    warnings = []
    for name, slope in drifts.items():
        size = 2 * slope / conversion(units[name], None)
        what = f"its offset drifts, by {size:.2g} {units[name]} over a run: its mean counts less"
        warnings.append(Problem(what, name, severity="warning"))
    return warnings
