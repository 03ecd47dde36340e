"""Parameters from samples in time with their robust covariance: what an output-error search says of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import t as student

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Free
from rotorsim.identification.left_out import Products
from rotorsim.identification.waveform.evaluation import Evaluation, solved
from rotorsim.identification.waveform.noise import INVERTED, goodness_left_out, products_of, robust_covariance
from rotorsim.identification.waveform.noise_model import NoiseModel
from rotorsim.identification.waveform.search import OutputErrorSearch

PART = 0.01  # of a direction that the data say nothing about: who takes part by more is not determined


@dataclass(frozen=True, eq=False)
class TimeEstimate:
    """The end of an output-error search.

    unknowns (q,): the m parameters first. robust (q, q): covariance of all unknowns by the scatter of the B stretches;
    products: of these. at_bound (m,). misfit: weighted sum of squares; rows: independent samples. goodness: probability
    of so large misfits of stretches left out if the model is adequate.
    """

    search: OutputErrorSearch
    evaluation: Evaluation
    robust: np.ndarray
    products: Products
    misfit: float
    rows: int
    goodness: float

    @property
    def free(self) -> tuple[Free, ...]:
        """The free parameters as they were before."""
        return self.search.free

    @property
    def m(self) -> int:
        """The number of parameters."""
        return self.search.m

    @property
    def theta(self) -> np.ndarray:
        """The estimates (m,)."""
        return self.evaluation.unknowns[: self.m]

    @cached_property
    def at_bound(self) -> np.ndarray:
        """Whether the search ended at a bound, (m,)."""
        return self.search.at_bound(self.evaluation.unknowns)[: self.m]

    @property
    def covariance(self) -> np.ndarray:
        """The robust covariance of theta (m, m), zero at bounds."""
        return self.robust[: self.m, : self.m]

    @property
    def excess(self) -> float:
        """Variance of the residual over what counts as noise."""
        return self.misfit / max(self.rows - self.m, 1)

    @property
    def adequate(self) -> bool:
        """Whether what cannot be predicted explains what it leaves."""
        return self.goodness >= CRITERIA.not_explained or self.excess <= CRITERIA.model_error

    @property
    def quantile(self) -> float:
        """The 95 % quantile of Student's t of as many degrees of freedom as stretches less one.

        Source: A. C. Cameron, D. L. Miller, J. Human Resources 50 (2015) 317-372, section VI.
        """
        return float(student.ppf(0.95, max(len(self.products.squares) - 1, 1)))

    @cached_property
    def information(self) -> np.ndarray:
        """What the data and priors say about theta (m, m) beside unknown starts, as if the noise were white."""
        return without_starts(self.evaluation.information, self.m)

    @cached_property
    def undetermined(self) -> np.ndarray:
        """Which of theta (m,) the data say nothing about, alone or beside the others."""
        H = self.information.copy()
        H[self.at_bound], H[:, self.at_bound] = 0.0, 0.0
        own = np.sqrt(np.maximum(np.diag(self.evaluation.information)[: self.m], 0.0))
        size = np.where(own > 0, own, 1.0)
        values, vectors = np.linalg.eigh(H / np.outer(size, size))
        nothing = vectors[:, values <= INVERTED * max(values.max(initial=0.0), 1.0)]
        nothing[self.at_bound] = 0.0
        return np.asarray((np.abs(nothing) > PART).any(axis=1) | ((own == 0) & ~self.at_bound))

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (m,): robust, infinite where undetermined, of an interval's reach at a bound."""
        reach = np.abs(self.intervals - self.theta[:, None]).max(axis=1) / self.quantile
        std = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return np.where(self.undetermined, np.inf, np.where(self.at_bound, reach, std))

    @cached_property
    def intervals(self) -> np.ndarray:
        """90 % intervals (m, 2) within the bounds: one-sided at one, all between them where undetermined.

        A parameter at a bound reaches as far inwards as a normal one about the point beyond the bound where the cost
        would be least: sqrt(d^2 + t^2 s^2) - d, with the distance d of that point.
        """
        low, high = np.array([(item.low, item.high) for item in self.free]).reshape(-1, 2).T
        half = self.quantile * np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        ends = np.column_stack([np.maximum(self.theta - half, low), np.minimum(self.theta + half, high)])
        for j in np.flatnonzero(self.at_bound):
            below = self.theta[j] <= low[j]
            variance, beyond = self._released(int(j))
            reach = np.sqrt(beyond**2 + self.quantile**2 * variance) - beyond
            ends[j] = (low[j], min(low[j] + reach, high[j])) if below else (max(high[j] - reach, low[j]), high[j])
        ends[self.undetermined] = np.column_stack([low, high])[self.undetermined]
        return ends

    def _released(self, j: int) -> tuple[float, float]:
        """Return the robust variance of parameter j without its bound, and how far beyond it the cost is least."""
        at_bound = self.search.at_bound(self.evaluation.unknowns)
        searched = ~at_bound
        searched[j] = True
        covariance = _robust(self.search, self.evaluation, self.products, self.rows, searched)
        H, g = self.evaluation.information[np.ix_(searched, searched)], self.evaluation.gradient[searched]
        step = solved(H, -g, INVERTED)
        return float(covariance[j, j]), abs(float(step[int(searched[:j].sum())]))

    def conditional(self, j: int) -> float:
        """Return the standard deviation of parameter j if all others were known, robust as that beside them is."""
        size = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        white = np.linalg.pinv(self.information / np.outer(size, size), rcond=INVERTED, hermitian=True)[j, j]
        if not (self.information[j, j] > 0 and white > 0):
            return np.inf
        return float(np.sqrt(self.covariance[j, j] / white))


def without_starts(information: np.ndarray, m: int) -> np.ndarray:
    """Return the information about the first m unknowns (m, m) beside the others: the Schur complement."""
    cross, rest = information[:m, m:], information[m:, m:]
    scale = np.sqrt(np.where(np.diag(rest) > 0, np.diag(rest), 1.0))
    known = np.linalg.pinv(rest / np.outer(scale, scale), rcond=INVERTED, hermitian=True) / np.outer(scale, scale)
    return np.asarray(information[:m, :m] - cross @ known @ cross.T)


def _robust(
    search: OutputErrorSearch, evaluation: Evaluation, products: Products, rows: int, searched: np.ndarray
) -> np.ndarray:
    """Return the robust covariance of the unknowns (q, q) that are searched; a prior counts as a measured value."""
    prior = np.zeros(len(evaluation.unknowns))
    for j, item in enumerate(search.free):
        prior[j] = 0.0 if item.prior_std is None else 1 / item.prior_std**2
    return robust_covariance(evaluation.information, products, searched, rows, prior)


def time_estimate(search: OutputErrorSearch, evaluation: Evaluation, noise: NoiseModel) -> TimeEstimate:
    """Return the estimate at the end of a search."""
    products = products_of(search, evaluation, noise.stretches)
    at_bound = search.at_bound(evaluation.unknowns)
    left = products.of(np.flatnonzero(~at_bound[: search.m])).left_out()
    return TimeEstimate(
        search,
        evaluation,
        _robust(search, evaluation, products, noise.rows, ~at_bound),
        products,
        float(products.squares.sum()),
        noise.rows,
        goodness_left_out(left, noise.allowed),
    )
