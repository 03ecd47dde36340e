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
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.identification.waveform.order_tracking import (
    OrderSearch,
    TrackedOrders,
    order_noise,
    order_search,
    vectors_of,
)
from rotorsim.identification.waveform.search import Evaluation

MOST_MEMORY = 0.95  # of a row, of the row before: twenty rows count as one
ROW_LAGS = 20  # rows over which what is left is asked for structure, a quarter of all at most
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
        if not shares.any():
            return y
        there = np.repeat(np.isfinite(self.tracked.tracks[r].vectors), 2, axis=1)
        follows = there & np.concatenate([np.zeros((1, there.shape[1]), bool), there[:-1]])
        shape = (*there.shape, *([1] * (y.ndim - 2)))
        before = np.concatenate([np.zeros_like(y[:1]), y[:-1]])
        alone = np.broadcast_to(np.sqrt(1 - shares**2), there.shape).reshape(shape) * y
        return np.asarray(np.where(follows.reshape(shape), y - shares.reshape(1, -1, *shape[2:]) * before, alone))


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
    searched = int((~search.at_bound(evaluation.unknowns)).sum())
    found = {}
    for c, label in enumerate(tracked.labels):
        left = [track.vectors[:, c] - y[:, c] for track, y in zip(tracked.tracks, simulated, strict=True)]
        memory = memory_of(left)
        white = [_without_memory(part, memory) for part in left]
        whiteness, _ = whiteness_of(white)
        count = 2 * sum(int(np.isfinite(part).sum()) for part in white)
        least = min(raw[label], beside[label], key=lambda one: one.variance)
        if whiteness < CRITERIA.surprise:
            found[label] = replace(least, whiteness=whiteness)
            continue
        rows = max(count - searched / len(tracked.labels), 1.0)
        square = sum(float(np.nansum(np.abs(part) ** 2)) for part in white)
        floor = CRITERIA.resolution**2 * _moved(tracked, c)
        found[label] = RowNoise(max(square / rows, floor, 1e-300), memory, rows, whiteness)
    return found


def memory_of(left: Sequence[np.ndarray]) -> float:
    """Return the share that rows (n,) of some runs keep of the row before; zero where it may be chance."""
    inner, square, count = 0.0, 0.0, 0
    for part in left:
        pairs = np.conj(part[:-1]) * part[1:]
        inner, square = inner + float(np.nansum(pairs.real)), square + float(np.nansum(np.abs(part) ** 2))
        count += int(np.isfinite(pairs).sum())
    share = inner / square if square > 0 else 0.0
    return min(share, MOST_MEMORY) if share * np.sqrt(2 * count) > CRITERIA.significant else 0.0


def whiteness_of(left: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return the probability that rows (n,) of some runs are white, and the largest share that a row predicts.

    White rows are not alike over some rows, and hold no beat (`_beat_of`).
    Q = 2 sum_k n_k |r_k|^2, chi-squared of 2 K: r_k the complex autocorrelation over k = 1 ... K rows, from n_k pairs;
    share: max_k |r_k|^2.
    Source: G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297-303.
    """
    square = sum(float(np.nansum(np.abs(part) ** 2)) for part in left)
    count = sum(int(np.isfinite(part).sum()) for part in left)
    lags = min(ROW_LAGS, count // 4)
    if square <= 0 or lags < 1:
        return 1.0, 0.0
    total, share = 0.0, 0.0
    for k in range(1, lags + 1):
        products = [np.conj(part[:-k]) * part[k:] for part in left if len(part) > k]
        pairs = sum(int(np.isfinite(one).sum()) for one in products)
        if not pairs:
            continue
        r = sum(complex(np.nansum(one)) for one in products) / square * count / pairs
        total += 2 * pairs * abs(r) ** 2
        share = max(share, abs(r) ** 2)
    alike = float(chi2.sf(total, 2 * lags))
    beat, part = _beat_of(left)
    return min(2 * min(alike, beat), 1.0), min(share if alike <= beat else part, 1.0)


def _beat_of(left: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return the probability that rows (n,) of some runs hold no beat, and the share of the strongest.

    A beat of what rings with what follows the shaft goes faster and faster, exp(i a n^2), so that its rows are not
    alike, but products of neighbours are a line: z_n = conj(e_n) e_(n+1). Of n ordinates of the periodogram of z the
    largest has a part g of the sum with probability n (1 - g)^(n - 1) at most. Source: R. A. Fisher, Proc. R. Soc. A
    125 (1929) 54-59.
    """
    probability, share = 1.0, 0.0
    for part in left:
        power = np.abs(np.fft.fft(np.nan_to_num(np.conj(part[:-1]) * part[1:]))) ** 2
        if power.sum() > 0:
            g = float(power.max() / power.sum())
            here = len(left) * len(power) * (1 - g) ** (len(power) - 1)
            if here < probability:
                probability, share = here, float(np.sqrt(g))
    return probability, share


def _without_memory(rows: np.ndarray, memory: float) -> np.ndarray:
    """Return rows (n,) without what each keeps of the one before; the first after a gap at the same variance."""
    before = np.concatenate([[np.nan], rows[:-1]])
    return np.where(np.isfinite(before), rows - memory * before, np.sqrt(1 - memory**2) * rows)


def _moved(tracked: TrackedOrders, c: int) -> float:
    """Return the mean square of what varies of a channel, of a real part."""
    every = np.concatenate([track.vectors[:, c] for track in tracked.tracks])
    there = every[np.isfinite(every)]
    return float(np.mean(np.abs(there - there.mean()) ** 2)) / 2 if len(there) else 0.0
