"""What a law promises by first-order sensitivities, and from where it is to start, before any of it is searched.

An effect that is made small changes the outputs by d. Beside what the free parameters and the starts of the runs
change, J, it takes up of the residual r as much as

(d^T r - h^T H^-1 J^T r)^2 / (d^T d - h^T H^-1 h),   h = J^T d,   H = J^T J,   all weighted,

and its size follows from the same step. Of the start whose shape takes up most, the sensitivities by all parameters at
that size promise c - g^T H^-1 g: exact where a law is linear in what it adds, whatever its angles and sizes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorsim.identification.waveform.evaluation import Evaluation, solved
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.starting import WORSE

FIRST_ORDER_STARTS = 9  # starts of a law, evenly among those that are declared
SMALLER, REDUCTIONS = 1e-2, 12  # factor by which an effect is made smaller until the simulation stands it
ABSENT = 1e-9  # relative difference of the misfits of diagrams without an effect, whatever its other parameters are
SIGNIFICANT = 1e-9  # of d^T d: what is left of it beside J, of which anything can be told


@dataclass(frozen=True, eq=False)
class Start:
    """A point from which a law may be followed, and how much of the misfit its shape takes up there."""

    point: np.ndarray
    gain: float


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """A law beside parts of runs. first (q,): unknowns as the diagram states them; old: parameters of no effect."""

    search: OutputErrorSearch
    first: np.ndarray
    starts: Sequence[Mapping[str, float]]
    old: Collection[str]

    @cached_property
    def ranked(self) -> list[Start]:
        """Starts of which the simulation stands the effect, those that take up most first."""
        some = self.starts[:: -(-len(self.starts) // FIRST_ORDER_STARTS) or 1]
        points = [self.search.stated(self.first, start) for start in some]
        distinct = [*{point.tobytes(): point for point in points}.values()]
        found = (self._scaled(point) for point in distinct) if len(self._sizes) else map(self._as_stated, distinct)
        return sorted((start for start in found if start is not None), key=lambda start: -start.gain)

    @property
    def promise(self) -> float:
        """The misfit that the sensitivities at the best start promise, infinite without a start."""
        if not self.ranked:
            return np.inf
        point = self.ranked[0].point
        return promised(self.search.evaluate(point, self.search.substeps(point)))

    @cached_property
    def _named(self) -> list[int]:
        """The parameters of the effect."""
        named = {name for start in self.starts for name in start}
        return [j for j, item in enumerate(self.search.free) if item.name in named and item.name not in self.old]

    @cached_property
    def _sizes(self) -> list[int]:
        """Those with which the effect vanishes: as few as leave what all at zero leave; none if it never does."""
        if not self.starts:
            return []
        stated = self.search.stated(self.first, self.starts[0])
        low, high = self.search.bounds
        found = [j for j in self._named if stated[j] != 0 and low[j] <= 0 <= high[j]]
        absent = self._cost(self._times(stated, found, 0.0)) if found else np.inf
        if not np.isfinite(absent):
            return []
        for j in found:
            less = [k for k in found if k != j]
            if less and abs(self._cost(self._times(stated, less, 0.0)) - absent) <= ABSENT * absent:
                found = less
        return found

    @cached_property
    def _absent(self) -> Evaluation:
        point = self._times(self.search.stated(self.first, self.starts[0]), self._sizes, 0.0)
        return self.search.evaluate(point, self.search.substeps(point))

    def _times(self, point: np.ndarray, which: Sequence[int], factor: float) -> np.ndarray:
        point = point.copy()
        point[which] *= factor
        return np.asarray(np.clip(point, *self.search.bounds))

    def _cost(self, point: np.ndarray) -> float:
        return self.search.evaluate(point, self.search.substeps(point), sensitivities=False).cost

    def _as_stated(self, point: np.ndarray) -> Start | None:
        cost = self._cost(point)
        return Start(point, -cost) if np.isfinite(cost) else None

    def _scaled(self, stated: np.ndarray) -> Start | None:
        """Return a start with the size that takes up most beside all that is free; None where it diverges."""
        without = self._absent
        if not np.isfinite(without.cost):
            return None
        factor = 1.0
        for _ in range(REDUCTIONS):
            point = self._times(stated, self._sizes, factor)
            here = self.search.evaluate(point, self.search.substeps(point), sensitivities=False)
            if np.isfinite(here.cost) and here.cost <= WORSE * without.cost:
                break
            # the change grows with the size: from how much there is, or blindly where there is too much
            excess = (WORSE - 1) / 2 * without.cost / (here.cost - without.cost) if np.isfinite(here.cost) else 0.0
            factor *= max(np.sqrt(max(excess, 0.0)), SMALLER)
        else:
            return None
        square, inner, cross = 0.0, 0.0, np.zeros(len(stated))
        for k in range(len(self.search.systems)):
            for r in range(len(self.search.runs)):
                weight = self.search.root(k, r) ** 2
                before = np.nan_to_num(without.residuals[k][r])
                d = np.nan_to_num(here.residuals[k][r]) - before
                square += float(np.vdot(weight * d, d))
                inner += float(np.vdot(weight * d, before))
                J = without.jacobians[k][r]
                own = self.search.columns(k, r)[: J.shape[2]]
                cross[own] += np.tensordot(J, weight * d, axes=([0, 1], [0, 1]))
        free = np.setdiff1d(np.arange(len(stated)), self._named)
        both = solved(without.information[np.ix_(free, free)], np.stack([cross[free], without.gradient[free]], 1))
        curvature = square - float(cross[free] @ both[:, 0])
        slope = inner - float(cross[free] @ both[:, 1])
        if curvature <= SIGNIFICANT * square:
            return Start(point, 0.0)
        best = self._times(stated, self._sizes, -factor * slope / curvature)
        if not best[self._sizes].any():  # it would have to be of the other sign
            return Start(point, 0.0)
        return Start(best if self._cost(best) <= WORSE * without.cost else point, slope**2 / curvature)


def promised(here: Evaluation) -> float:
    """Return the misfit that the sensitivities at a point promise: c - g^T H^-1 g."""
    if not np.isfinite(here.cost):
        return np.inf
    return max(here.cost - float(here.gradient @ solved(here.information, here.gradient)), 0.0)
