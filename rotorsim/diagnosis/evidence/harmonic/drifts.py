"""What drifts within the runs: offsets of channels, with what that leaves of their means, and vectors of 1X."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.harmonic.drifting import DriftingLikelihood
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.recordings.recording import Recording
from rotorsim.settled.growing import DEGREES
from rotorsim.signals.harmonics import RunHarmonics
from rotorsim.units import conversion

# a random walk that starts with a run has Var(mean) = s^2 T / 3, and s^2 3 T / 10 in its slope's Legendre coefficient
MEAN = 10 / 9
SCORINGS = 20  # steps of Fisher's scoring
COURSE_INSTANTS = 65  # of a run: Markov on the second derivative lets degree four hide 80 / (2 64^2) = 1 % between them
DRIFT_INFORMATION = 1e-9  # of a channel's information that slow states leave: below, they take all of its drift


def find_drifts(base: Fit, runs: HarmonicRuns) -> dict[str, float]:
    """Return channels whose offset drifts within the runs by more than noise, and the rms of the slope, SI.

    The slope is the Legendre coefficient of degree one: half of what the offset changes over a run. What slow states of
    the fitted diagram, which are not in rest yet, share between the channels is no drift of an offset. What remains may
    be any channel's that shares them: each is counted as if it were its own alone.
    """
    try:
        experiment = runs.open(runs.load(values_in(base.document, base.values)))
    except RotorsimError:
        return {}
    if not experiment.motion.is_linear:
        return {}
    response = Likelihood(experiment).response(experiment.theta0)
    c = len(experiment.predicted)
    power, count = np.zeros(c), 0
    pairs: list[tuple[np.ndarray, np.ndarray]] = []  # of the drift: square of its slope, variance
    for r, item in enumerate(experiment.runs):
        columns = experiment.columns[r][:c]
        if len(item.fit.drift) < 2:
            continue
        for degree in (1, 2):
            variance = np.maximum(item.fit.noise.of_drift(degree)[columns] / item.fit.samples, 1e-300)
            slow = response.C[r] @ response.slow_states(r) / np.sqrt(variance)[:, None]
            length = np.linalg.norm(slow, axis=0)
            q = np.linalg.qr(slow[:, length > 0] / length[length > 0])[0]
            free = np.maximum(1 - (q**2).sum(axis=1), DRIFT_INFORMATION)
            white = item.fit.drift[degree - 1, columns] / np.sqrt(variance)
            rest = (white - (white @ q) @ q.T) / free
            power += np.where(free > DRIFT_INFORMATION, rest**2 * free, 0.0)
            if degree == 1:
                pairs.append((rest**2 * variance, np.where(free > DRIFT_INFORMATION, variance / free, np.inf)))
        count += 1
    if not count:
        return {}
    squares, noise = (np.array([pair[k] for pair in pairs]) for k in (0, 1))
    size = _variance(squares, noise)
    drifts = (power > chi2.isf(CRITERIA.drift, 2 * count)) & experiment.use_mean[:c] & (size > 0)
    return {experiment.predicted[k]: float(np.sqrt(size[k])) for k in np.flatnonzero(drifts)}


def _variance(squares: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return the most likely variance (c,) of slopes beside noise's, from squares of what is seen, both (R, c)."""
    size = np.zeros(squares.shape[1])
    for _ in range(SCORINGS):  # Fisher's scoring
        weight = 1 / (noise + size) ** 2
        size = np.maximum((weight * np.where(np.isfinite(noise), squares - noise, 0.0)).sum(axis=0), 0.0)
        size = size / np.maximum(weight.sum(axis=0), 1e-300)
    return size


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


def tells_drifts(fit: Fit) -> bool:
    """Return whether a fit to runs without their drifts leaves so little that those are drifts of offsets."""
    return not fit.failure and fit.misfit <= CRITERIA.drift_judged * fit.freedom


def drift_warnings(drifts: Mapping[str, float], recording: Recording) -> list[Problem]:
    """Return what is to be said of channels that drift."""
    units = {channel.name: channel.unit for channel in recording.channels.values()}
    warnings = []
    for name, slope in drifts.items():
        size = 2 * slope / conversion(units[name], None)
        what = f"its offset drifts, by {size:.2g} {units[name]} over a run: its mean counts less"
        warnings.append(Problem(what, name, severity="warning"))
    return warnings


def unexplained_drift(fit: Fit, runs: HarmonicRuns) -> str:
    """Return in words where 1X drifts most within a run, if noise and a fit do not explain it; empty if they do.

    Noise: by chi-squared of the drifts of all runs that tell them, with the probability `Criteria.drift` of a false
    alarm. A fit: `Criteria.cause_of_drift` of the rest, since what grows need not do so as its law says to the last.
    """
    try:
        experiment = runs.open(runs.load(values_in(fit.document, fit.values)))
        likelihood = DriftingLikelihood(experiment)
        likelihood.evaluate(experiment.theta0)  # the motion about which what grows is linearised
        rest = likelihood.drift - likelihood.grown(experiment.theta0)
    except FAILURES:
        return ""
    seen, left = ((likelihood.white_drift(part) ** 2).sum(axis=1) for part in (likelihood.drift, rest))
    rows = sum(drift.told for drift in likelihood.drifts) * DEGREES * (2 * rest.shape[2] - 1)
    explained = seen.sum() - left.sum() > CRITERIA.cause_of_drift * (seen.sum() - rows)
    if not rows or left.sum() <= chi2.isf(CRITERIA.drift, rows) or explained:
        return ""
    r = int(left.argmax())
    fitted = experiment.fits[r]
    columns = experiment.columns[r][: rest.shape[2]]
    course = np.polynomial.legendre.legvander(np.linspace(-1, 1, COURSE_INSTANTS), DEGREES)[:, 1:] @ rest[r]
    sizes = 2 * np.abs(course).max(axis=0)
    c = int((sizes / np.maximum(fitted.rms[columns], 1e-300)).argmax())
    name = experiment.predicted[c]
    unit = next(channel.unit for channel in runs.recording.channels.values() if channel.name == name)
    pair = np.array([sizes[c], 2 * abs(fitted.values[1, columns[c]])]) / conversion(unit, None)
    most = f"{pair[0]:.2g} {unit} of {pair[1]:.2g} {unit} 0-peak"
    return f"1X of {name} drifts within run {experiment.runs[r].run.id}, by up to {most}, unexplained."
