"""Noise of order vectors: white from row to row, or what a row keeps of the one before, where no more is left.

Differences of the sixth order between rows show white noise beside any smooth motion (`order_noise`). Noise that a
tracking filter has made slow looks like motion to them. It is told from motion that is missing by what it is: after
each row has lost a share of the row before, nothing of it can be predicted. Missing physics leaves more: a smooth curve
over the speed, or a beat, whose rows are alike over many rows, beside the white noise of the recorder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.evidence.orders.whiteness import whiteness_of
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.order_tracking import (
    OrderSearch,
    TrackedOrders,
    order_noise,
    order_search,
    vectors_of,
)

MOST_MEMORY = 0.95  # of a row, of the row before: twenty rows count as one
# of the largest eigenvalue of the scaled information: below, a direction changes the rows by less than thrice what a
# simulation may be wrong by, which does not know what was before the first row (FORGOTTEN)
DETERMINED_BY_ROWS = 1e-7
DIFFERENCED = 3.17  # rows that count as one in a variance by sixth differences: C(24, 12) / C(12, 6)^2


@dataclass(frozen=True)
class RowNoise:
    """Noise e_n = memory e_(n-1) + d_n of the rows of a channel, the same in real and imaginary part.

    variance: of the real part of d. rows: independent real numbers that it is known from. whiteness: probability that d
    is white, of what was left where it was judged.
    """

    variance: float
    memory: float
    rows: float
    whiteness: float

    @property
    def std(self) -> float:
        """The standard deviation of the real part of e: sqrt(variance / (1 - memory^2))."""
        return float(np.sqrt(self.variance / (1 - self.memory**2)))


@dataclass(frozen=True, eq=False)
class WhitenedSearch(OrderSearch):
    """A search on rows that have lost what they keep of the row before: memory, by channel.

    z_n = y_n - memory y_(n-1),   z_n = sqrt(1 - memory^2) y_n after a gap
    """

    memory: Mapping[str, float] | None = None

    @cached_property
    def measured(self) -> list[list[np.ndarray]]:
        """The measured vectors of each run, whitened, (n, 2 c) real."""
        return [[self._whitened(y, r) for r, y in enumerate(plain(self).measured[0])]]

    def simulated(
        self, unknowns: np.ndarray, k: int, r: int, sub: int, sensitivities: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the order vectors of a run as rows that have lost their memory (n, 2 c), and their derivatives."""
        y, dy = super().simulated(unknowns, k, r, sub, sensitivities)
        return self._whitened(y, r), self._whitened(dy, r)

    def _whitened(self, y: np.ndarray, r: int) -> np.ndarray:
        """Return y (n, 2 c, ...) of a run without what each row keeps of the measured row before it."""
        assert self.tracked is not None
        memory = self.memory or {}
        shares = np.repeat([memory.get(label, 0.0) for label in self.tracked.labels], 2)
        return _without_memory(y, np.repeat(np.isfinite(self.tracked.tracks[r].vectors), 2, axis=1), shares)


def _without_memory(y: np.ndarray, there: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Return y (n, c, ...) without the share (c,) that each row keeps of the one before; there: which are, (n, c).

    The first after a gap keeps its variance.
    """
    if not shares.any():
        return y
    more = [1] * (y.ndim - 2)
    follows = there & np.concatenate([np.zeros((1, there.shape[1]), bool), there[:-1]])
    before = np.concatenate([np.zeros_like(y[:1]), y[:-1]])
    alone = np.sqrt(1 - shares**2).reshape(1, -1, *more) * y
    return np.asarray(np.where(follows.reshape(*there.shape, *more), y - shares.reshape(1, -1, *more) * before, alone))


def whitened_search(tracked: TrackedOrders, noise: Mapping[str, RowNoise]) -> WhitenedSearch:
    """Return the search on tracked orders, weighed by their noise."""
    made = order_search(tracked, {("", label): noise[label].variance for label in tracked.labels})
    memory = {label: noise[label].memory for label in tracked.labels}
    return WhitenedSearch(made.systems, made.runs, made.weights, tracked=tracked, memory=memory)


def plain(search: OrderSearch) -> OrderSearch:
    """Return a search on rows as they are, of the same unknowns."""
    return OrderSearch(search.systems, search.runs, search.weights, search.least, search.hold, tracked=search.tracked)


def white_noise(tracked: TrackedOrders, simulated: Sequence[np.ndarray] | None = None) -> dict[str, RowNoise]:
    """Return noise that is white, as differences between rows show it; simulated: taken away before, (n, c) a run."""
    found = {}
    for (_, label), variance in order_noise(tracked, CRITERIA.resolution, simulated).items():
        c = tracked.labels.index(label)
        rows = sum(int(np.isfinite(track.vectors[:, c]).sum()) for track in tracked.tracks)
        found[label] = RowNoise(variance, 0.0, 2 * rows / DIFFERENCED, 0.0)
    return found


def noise_beside(search: OrderSearch, evaluation: Evaluation) -> dict[str, RowNoise]:
    """Return the noise of every channel beside a fit: all that it leaves where that is noise, else its white part.

    What is left is noise where it is white once each row has lost the share `memory` of the row before.
    """
    tracked = search.tracked
    assert tracked is not None
    simulated = vectors_of(plain(search), evaluation)
    raw, beside = white_noise(tracked), white_noise(tracked, simulated)
    left = [
        [t.vectors[:, c] - y[:, c] for t, y in zip(tracked.tracks, simulated, strict=True)]
        for c in range(len(tracked.labels))
    ]
    at = plain(search).evaluate(evaluation.unknowns, evaluation.sub)
    open_ones = ~search.at_bound(evaluation.unknowns)
    sensitivities = [np.zeros((*part.shape, len(open_ones))) for part in at.residuals[0]]
    for r, J in enumerate(at.jacobians[0]):
        sensitivities[r][:, :, search.columns(0, r)] = J
    begun = np.array([memory_of(parts) for parts in left])
    variances, memory = restricted(at.residuals[0], [J[:, :, open_ones] for J in sensitivities], begun)
    searched = int(open_ones.sum())
    found = {}
    for c, label in enumerate(tracked.labels):
        white = [_without_memory(p[:, None], np.isfinite(p)[:, None], memory[c : c + 1])[:, 0] for p in left[c]]
        whiteness, _ = whiteness_of(white)
        # differences are right for white rows whatever the test says, but far too low for rows that are alike
        if whiteness < (CRITERIA.not_explained if memory[c] else CRITERIA.surprise):
            least = min(raw[label], beside[label], key=lambda one: one.variance)
            found[label] = replace(least, whiteness=whiteness)
            continue
        rows = max(2 * sum(int(np.isfinite(part).sum()) for part in white) - searched / len(left), 1.0)
        floor = CRITERIA.resolution**2 * _moved(tracked, c)
        found[label] = RowNoise(max(variances[c], floor, 1e-300), float(memory[c]), rows, whiteness)
    return found


def restricted(
    left: Sequence[np.ndarray], sensitivities: Sequence[np.ndarray], begun: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the variance of d and the memory of every channel, (c,) each, by restricted maximum likelihood.

    -2 log L = r^T V^-1 r + log |V| + log |J^T V^-1 J|
    r: left (n, 2 c) by a fit of each run, refitted by linear theory with the weights V^-1; J: sensitivities
    (n, 2 c, q). A fit takes up some of slow noise, and what it leaves is less slow. begun: memory to begin at, (c,);
    zero stays.
    Source: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545-554.
    """
    there = [np.isfinite(part) for part in left]
    residuals = [np.nan_to_num(part)[:, :, None] for part in left]
    sensitivities = [np.where(here[:, :, None], J, 0) for here, J in zip(there, sensitivities, strict=True)]
    every = np.concatenate([J.reshape(-1, J.shape[2]) for J in sensitivities])
    size = np.maximum(np.linalg.norm(every, axis=0), 1e-300)
    _, values, directions = np.linalg.svd(every / size, full_matrices=False)
    to_known = directions[values**2 > DETERMINED_BY_ROWS * values.max(initial=0.0) ** 2].T / size[:, None]
    both = [np.concatenate([y, J @ to_known], axis=2) for y, J in zip(residuals, sensitivities, strict=True)]
    rows = sum(here[:, ::2].sum(axis=0) for here in there)
    alone = sum((here & ~np.concatenate([np.zeros_like(here[:1]), here[:-1]]))[:, ::2].sum(axis=0) for here in there)
    squares = sum((part[:, :, 0] ** 2).sum(axis=0) for part in both)
    level = np.sqrt(np.maximum((squares[::2] + squares[1::2]) / (2 * rows), 1e-300))
    slow = begun > 0

    def split(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        memory = np.zeros(len(begun))
        memory[slow] = point[len(begun) :]
        return level * np.exp(point[: len(begun)]), memory

    def likelihood(point: np.ndarray) -> float:
        deviation, memory = split(point)
        weighed = [
            _without_memory(part, here, np.repeat(memory, 2)) / np.repeat(deviation, 2)[:, None]
            for part, here in zip(both, there, strict=True)
        ]
        stack = np.concatenate([part.reshape(-1, part.shape[2]) for part in weighed])
        basis, triangle = np.linalg.qr(stack[:, 1:])
        left = stack[:, 0] - basis @ (basis.T @ stack[:, 0])
        volume = 4 * rows @ np.log(deviation) - 2 * alone @ np.log(1 - memory**2)
        return float(left @ left + volume + 2 * np.log(np.abs(np.diag(triangle))).sum())

    start = np.concatenate([np.zeros(len(begun)), begun[slow]])
    bounds = [(-12.0, 2.0)] * len(begun) + [(0.0, MOST_MEMORY)] * int(slow.sum())
    deviation, memory = split(minimize(likelihood, start, method="L-BFGS-B", bounds=bounds).x)
    return deviation**2, memory


def memory_of(left: Sequence[np.ndarray]) -> float:
    """Return the share that rows (n,) of some runs keep of the row before; zero where it may be chance."""
    inner, square, count = 0.0, 0.0, 0
    for part in left:
        pairs = np.conj(part[:-1]) * part[1:]
        inner, square = inner + float(np.nansum(pairs.real)), square + float(np.nansum(np.abs(part) ** 2))
        count += int(np.isfinite(pairs).sum())
    share = inner / square if square > 0 else 0.0
    return min(share, MOST_MEMORY) if share * np.sqrt(2 * count) > CRITERIA.significant else 0.0


def _moved(tracked: TrackedOrders, c: int) -> float:
    """Return the mean square of what varies of a channel, of a real part."""
    every = np.concatenate([track.vectors[:, c] for track in tracked.tracks])
    there = every[np.isfinite(every)]
    return float(np.mean(np.abs(there - there.mean()) ** 2)) / 2 if len(there) else 0.0
