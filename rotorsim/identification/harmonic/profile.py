"""Profile-likelihood intervals: how far one parameter can go while all others follow as well as they can."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotorsim.criteria import Z90
from rotorsim.errors import RotorsimError
from rotorsim.identification.harmonic.estimate import Estimate, Search
from rotorsim.model.heard import gives_up, remark

PARABOLA_TOLERANCE = 0.02  # the profile agrees so well with a parabola that its end points are those of the parabola
PROFILE_STEPS = 8
UNBOUNDED_WIDTH = 1e3  # standard widths beyond which an interval is called unbounded


def profile_intervals(search: Search, estimate: Estimate, widen: float = 1.0) -> np.ndarray:
    """Return 90 % intervals (m, 2) [SI] at which the profile of minus twice the log likelihood rises by 2.71.

    widen: factor on standard deviations where the model does not explain the data. Intervals end at the physical
    bounds. Source: Pawitan, In All Likelihood (2001), ch. 3; Raue et al., Bioinformatics 25 (2009) 1923.
    """
    polar = _polar(search)
    coordinates = polar.coordinates
    at, limits = coordinates.inside(estimate.theta), coordinates.bounds
    best = polar.residual(at)
    least = float(best @ best)
    slopes = np.diag(coordinates.jacobian(estimate.theta))
    covariance, whole = (of / np.outer(slopes, slopes) for of in (estimate.covariance, _unbounded(estimate)))
    intervals = np.column_stack([coordinates.low, coordinates.high])
    for j in np.flatnonzero(~estimate.undetermined):
        used = whole if estimate.at_bound[j] else covariance
        std = float(np.sqrt(max(used[j, j], 0.0))) * widen
        if not 0 < std < np.inf:
            continue
        ridge = used[:, j] / used[j, j]
        for side, sign in enumerate((-1.0, 1.0)):
            end = _end(polar, at, ridge, int(j), sign * Z90 * std, least, (Z90 * widen) ** 2)
            if limits[0][j] < end < limits[1][j]:
                intervals[j, side] = coordinates.moved(estimate.theta[j], int(j), end - at[j])
    return intervals


def linear_intervals(search: Search, estimate: Estimate) -> np.ndarray:
    """Return 90 % intervals (m, 2) [SI] by linear theory, cut at the physical bounds: where undetermined, all between.

    At a bound the profile rises by 2 b x + h x^2 over a step x off it, h = |J_j|^2 and b = J_j^T r beside all other
    parameters: the interval is one-sided, up to the x of a rise by 2.71.
    """
    low, high = search.coordinates.low, search.coordinates.high
    half = Z90 * estimate.std
    intervals = np.column_stack([np.maximum(estimate.theta - half, low), np.minimum(estimate.theta + half, high)])
    for k in search.coordinates.series:  # in q, of which the response is nearly linear
        width = Z90 * estimate.std[k] / search.coordinates.jacobian(estimate.theta)[k, k]
        ends = [search.coordinates.moved(estimate.theta[k], k, step) for step in (-width, width)]
        intervals[k] = np.clip(ends, low[k], high[k])
    if not estimate.at_bound.any():
        return intervals
    polar = _polar(search)  # of an amplitude at its bound the angle is free
    q, limits = polar.coordinates.inside(estimate.theta), polar.coordinates.bounds
    r, J = polar.residual(q), polar.jacobian(q)
    base, _, _ = np.linalg.svd(_units(J[:, ~estimate.at_bound]), full_matrices=False)
    for j in np.flatnonzero(estimate.at_bound):
        below = q[j] - limits[0][j] <= limits[1][j] - q[j]
        own = (1.0 if below else -1.0) * (J[:, j] - base @ (base.T @ J[:, j]))
        h, b = float(own @ own), max(float(own @ r), 0.0)
        # x = (sqrt(b^2 + h 2.71) - b) / h, without its difference of large numbers
        rise = Z90**2 / (b + np.sqrt(b**2 + h * Z90**2)) if h > 0 or b > 0 else np.inf
        end = polar.coordinates.moved(estimate.theta[j], int(j), rise if below else -rise)
        intervals[j] = (low[j], min(end, high[j])) if below else (max(end, low[j]), high[j])
    return intervals


def _units(J: np.ndarray) -> np.ndarray:
    """Return columns of length one, without those of none."""
    size = np.linalg.norm(J, axis=0)
    return np.asarray(J[:, size > 0] / size[size > 0])


def joint_factor(correlation: np.ndarray) -> float:
    """Return by how much 90 % intervals of single parameters must be widened to hold all of them at once in 90 %.

    From the largest of m correlated standard normal numbers, 20 000 draws.
    """
    m = len(correlation)
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0))
    draws = np.random.default_rng(0).standard_normal((20_000, m)) @ root.T
    return float(np.quantile(np.abs(draws).max(axis=1), 0.9) / Z90)


def _unbounded(estimate: Estimate) -> np.ndarray:
    """Return the covariance (m, m) of theta as it would be if no parameter were at its bound."""
    if not estimate.at_bound.any():
        return estimate.covariance
    free = replace(estimate, at_bound=np.zeros(len(estimate.free), bool))
    return free.covariance


def _polar(search: Search) -> Search:
    """Return the search in the parameters themselves, so that an amplitude or an angle can be held."""
    scale = search.coordinates.scale.copy()
    scale[[b for _, b in search.coordinates.pairs]] = 1.0
    return search.in_coordinates(replace(search.coordinates, pairs=(), scale=scale))


def _end(search: Search, at: np.ndarray, ridge: np.ndarray, j: int, step: float, least: float, rise: float) -> float:
    """Return the q of parameter j at which the profile has risen so far, or its bound; at: q (m,) of the estimate."""
    low, high = (limits[j] for limits in search.coordinates.bounds)
    share = 1.0
    known = [(0.0, 0.0)]  # (share of the step, root of the rise)
    for _ in range(PROFILE_STEPS):
        value = float(np.clip(at[j] + share * step, low, high))
        reached = (value - at[j]) / step
        try:
            root = np.sqrt(max(_profile(search, at, ridge, j, value) - least, 0.0) / rise)
        except RotorsimError as error:
            if gives_up(error):
                raise
            remark(search.free[j].name, "its 90 % interval is that of linear theory: trials fail on the way to its end")
            return float(np.clip(at[j] + step * np.sqrt(rise) / Z90, low, high))
        known.append((reached, root))
        if abs(root - 1) < PARABOLA_TOLERANCE or (reached < share and root < 1):  # there, or at the bound
            return float(at[j] + reached * step / root) if abs(root - 1) < PARABOLA_TOLERANCE else value
        below = max((pair for pair in known if pair[1] < 1), key=lambda pair: pair[0])
        above = min((pair for pair in known if pair[1] >= 1), key=lambda pair: pair[0], default=None)
        if above is None:
            share = min(2 * reached / max(root, 0.25), 4 * reached)
            if share > UNBOUNDED_WIDTH:
                return float(high if step > 0 else low)
        else:
            share = below[0] + (1 - below[1]) / (above[1] - below[1]) * (above[0] - below[0])
    return float(at[j] + share * step)


def _profile(search: Search, at: np.ndarray, ridge: np.ndarray, j: int, value: float) -> float:
    """Return the least of minus twice the log likelihood with q of parameter j held at a value."""
    q = np.clip(at + ridge * (value - at[j]), *search.coordinates.bounds)
    q[j] = value
    others = [k for k in range(len(q)) if k != j]
    r = search.residual(q)
    cost = float(r @ r)
    for _ in range(4):
        J = search.jacobian(q)[:, others]
        step, *_ = np.linalg.lstsq(J, -r, rcond=1e-9)
        trial = q.copy()
        trial[others] += step
        trial = np.clip(trial, *search.coordinates.bounds)
        r_new = search.residual(trial)
        lower = float(r_new @ r_new)
        if lower > cost * (1 + 1e-9):
            found = search.minimise(q, held=(j,))
            r = search.residual(found)
            return min(float(r @ r), cost)
        gained, q, r, cost = cost - lower, trial, r_new, lower
        if gained < 1e-3:
            break
    return cost
