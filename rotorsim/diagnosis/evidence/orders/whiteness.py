"""Whether rows are white: the portmanteau test at its true level, and a test for beats."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.stats import chi2

ROW_LAGS = 20  # rows over which what is left is asked for structure, a quarter of all at most
DRAWN = 40_000  # sets of white rows that a probability is counted in: twice 1 in them is below `not_explained`
MANY_ROWS = 1000  # from which the sum of the portmanteau test is chi-squared: its variance is within 3 %


def whiteness_of(left: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return the probability that rows (n,) of some runs are white, and the largest share that a row predicts.

    White rows are not alike over some rows, and hold no beat (`_beat_of`).
    Q = 2 sum_k n_k |r_k|^2: r_k the complex autocorrelation over k = 1 ... K rows, from n_k pairs.
    share: max_k |r_k|^2. Q of many rows is chi-squared of 2 K. Of 100 rows and 20 lags it is above the quantile of
    0.01 % in 0.2 % of all cases, so that the probability is counted in white rows that are drawn.
    Source: G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297-303.
    """
    there = [np.isfinite(part) for part in left]
    count = sum(int(part.sum()) for part in there)
    lags = min(ROW_LAGS, count // 4)
    if lags < 1 or not any(np.abs(part[here]).any() for part, here in zip(left, there, strict=True)):
        return 1.0, 0.0
    [total], [share] = _portmanteau(
        [np.where(here, part, 0)[None] for part, here in zip(left, there, strict=True)], there, lags
    )
    if count < MANY_ROWS:
        drawn = _of_white(tuple(part.tobytes() for part in there), lags)
        alike = float(1 + len(drawn) - np.searchsorted(drawn, total)) / (1 + len(drawn))
    else:
        alike = float(chi2.sf(total, 2 * lags))
    beat, part = _beat_of(left)
    return min(2 * min(alike, beat), 1.0), float(min(share if alike <= beat else part, 1.0))


def _portmanteau(left: Sequence[np.ndarray], there: Sequence[np.ndarray], lags: int) -> tuple[np.ndarray, np.ndarray]:
    """Return Q and the largest |r_k|^2 of sets of rows (sets, n) of runs, zero where there is none; there: (n,)."""
    square = sum((np.abs(part) ** 2).sum(axis=1) for part in left)
    count = sum(int(here.sum()) for here in there)
    total, share = np.zeros(len(left[0])), np.zeros(len(left[0]))
    for k in range(1, lags + 1):
        pairs = sum(int((here[:-k] & here[k:]).sum()) for here in there)
        if pairs:
            r = sum(np.einsum("sn,sn->s", part[:, :-k].conj(), part[:, k:]) for part in left) / square * count / pairs
            total, share = total + 2 * pairs * np.abs(r) ** 2, np.maximum(share, np.abs(r) ** 2)
    return total, share


@lru_cache(maxsize=64)
def _of_white(there: tuple[bytes, ...], lags: int) -> np.ndarray:
    """Return Q of `DRAWN` sets of white rows, in ascending order; there: whether there is a row, run by run."""
    random = np.random.default_rng(0)
    rows = [np.frombuffer(one, bool) for one in there]
    found = []
    for _ in range(40):
        shapes = [(DRAWN // 40, len(here)) for here in rows]
        sets = [random.normal(size=shape) + 1j * random.normal(size=shape) for shape in shapes]
        found.append(_portmanteau([one * here for one, here in zip(sets, rows, strict=True)], rows, lags)[0])
    return np.sort(np.concatenate(found))


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
