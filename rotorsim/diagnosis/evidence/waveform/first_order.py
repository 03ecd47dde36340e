"""What a law promises by first-order sensitivities, and from where it is to start, before any of it is searched.

An effect that is made small changes the outputs by d. Beside what the free parameters and the starts of the runs
change, J, it takes up of the residual r as much as

(d^T r - h^T H^-1 J^T r)^2 / (d^T d - h^T H^-1 h),   h = J^T d,   H = J^T J,   all weighted,

and its size follows from the same step. Of the start whose shape takes up most, the sensitivities by all parameters at
that size promise c - g^T H^-1 g: exact where a law is linear in what it adds, whatever its angles and sizes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rotorsim.identification.waveform.evaluation import Evaluation, solved
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.starting import WORSE

FIRST_ORDER_STARTS = 9  # starts of a law, evenly among those that are declared
# relative difference of the misfits of diagrams whose sensitivities are those of one another: which modes are left out
# differs a little with the law; the size of a start needs no more than two digits
SHARED = 1e-3
SMALLER, REDUCTIONS = 1e-2, 12  # factor by which an effect is made smaller until the simulation stands it
ABSENT = 1e-9  # relative difference of the misfits of diagrams without an effect, whatever its other parameters are
SIGNIFICANT = 1e-9  # of d^T d: what is left of it beside J, of which anything can be told


@dataclass(frozen=True, eq=False)
class Start:
    """A point from which a law may be followed, and how much of the misfit its shape takes up there.

    sized: with the size that takes up most, which the simulation may not stand.
    """

    point: np.ndarray
    gain: float
    sized: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Sensitivities of a diagram in which an effect is absent, by all else; free (k,): these of the unknowns.

    others: the free parameters that are not the effect's, with their values.
    """

    search: OutputErrorSearch
    evaluation: Evaluation
    free: np.ndarray
    others: Mapping[str, float]

    def hold_for(self, search: OutputErrorSearch, cost: float, others: Mapping[str, float]) -> bool:
        """Return whether they do for another law: beside the same runs, signals and parameters, and that misfit."""
        outputs = [system.signals for system in search.systems]
        same = [*map(id, self.search.runs)] == [*map(id, search.runs)] and self.others == others
        same = same and outputs == [system.signals for system in self.search.systems]
        return same and abs(self.evaluation.cost - cost) <= SHARED * cost


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """A law beside parts of runs. first (q,): unknowns as the diagram states them; old: parameters of no effect.

    known: the last sensitivities of a diagram from which a law is absent, for the next.
    """

    search: OutputErrorSearch
    first: np.ndarray
    starts: Sequence[Mapping[str, float]]
    old: Collection[str]
    known: list[Sensitivities] = field(default_factory=list)

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
        return promised(self._at(self.ranked[0])) if self.ranked else np.inf

    def points(self, most: int) -> list[np.ndarray]:
        """Return the points of so many starts, those that take up most first."""
        best = self.ranked[:most]
        return [one.point if one.sized is None else self._at(one, sensitivities=False).unknowns for one in best]

    def _at(self, start: Start, sensitivities: bool = True) -> Evaluation:
        """Return a start of the size that takes up most, or as it is where that costs far more than no effect."""
        for point in (start.sized, start.point):
            if point is not None:
                here = self.search.evaluate(point, self.search.substeps(point), sensitivities)
                if point is start.sized and here.cost <= WORSE * self._vanishing[1].cost:
                    break
        return here

    @cached_property
    def _named(self) -> list[int]:
        """The parameters of the effect."""
        named = {name for start in self.starts for name in start}
        return [j for j, item in enumerate(self.search.free) if item.name in named and item.name not in self.old]

    @property
    def _sizes(self) -> list[int]:
        """Those with which the effect vanishes: as few as leave what all at zero leave; none if it never does."""
        return self._vanishing[0]

    @cached_property
    def _vanishing(self) -> tuple[list[int], Evaluation]:
        """`_sizes`, and the motion without the effect."""
        stated = self.search.stated(self.first, self.starts[0] if self.starts else {})
        low, high = self.search.bounds
        found = [j for j in self._named if stated[j] != 0 and low[j] <= 0 <= high[j]]
        absent = self._simulated(self._times(stated, found, 0.0)) if found else Evaluation(stated, 1)
        if not np.isfinite(absent.cost):
            return [], absent
        for j in found:
            less = [k for k in found if k != j]
            if less and abs(self._simulated(self._times(stated, less, 0.0)).cost - absent.cost) <= ABSENT * absent.cost:
                found = less
        return found, absent

    @cached_property
    def _beside(self) -> Sensitivities:
        """What is changed by all but the effect, where it is absent."""
        sizes, absent = self._vanishing
        named = [(j, item.name) for j, item in enumerate(self.search.free) if j not in self._named]
        others = {name: float(self.first[j]) for j, name in named}
        for one in self.known:
            if one.hold_for(self.search, absent.cost, others):
                return one
        free = np.setdiff1d(np.arange(len(self.first)), self._named)
        point = self._times(self.search.stated(self.first, self.starts[0]), sizes, 0.0)
        evaluation = self.search.evaluate(point, self.search.substeps(point))
        self.known[:] = [Sensitivities(self.search, evaluation, free, others)]
        return self.known[0]

    def _times(self, point: np.ndarray, which: Sequence[int], factor: float) -> np.ndarray:
        point = point.copy()
        point[which] *= factor
        return np.asarray(np.clip(point, *self.search.bounds))

    def _simulated(self, point: np.ndarray) -> Evaluation:
        return self.search.evaluate(point, self.search.substeps(point), sensitivities=False)

    def _as_stated(self, point: np.ndarray) -> Start | None:
        cost = self._simulated(point).cost
        return Start(point, -cost) if np.isfinite(cost) else None

    def _scaled(self, stated: np.ndarray) -> Start | None:
        """Return a start with the size that takes up most beside all that is free; None where it diverges."""
        without, beside = self._vanishing[1], self._beside
        known, free = beside.evaluation, beside.free
        if not np.isfinite(known.cost):
            return None
        factor = 1.0
        for _ in range(REDUCTIONS):
            point = self._times(stated, self._sizes, factor)
            here = self._simulated(point)
            if np.isfinite(here.cost) and here.cost <= WORSE * without.cost:
                break
            # the change grows with the size: from how much there is, or blindly where there is too much
            excess = (WORSE - 1) / 2 * without.cost / (here.cost - without.cost) if np.isfinite(here.cost) else 0.0
            factor *= max(np.sqrt(max(excess, 0.0)), SMALLER)
        else:
            return None
        square, inner, cross = 0.0, 0.0, np.zeros(len(known.unknowns))
        for k in range(len(self.search.systems)):
            for r in range(len(self.search.runs)):
                weight = self.search.root(k, r) ** 2
                before = np.nan_to_num(without.residuals[k][r])
                d = np.nan_to_num(here.residuals[k][r]) - before
                square += float(np.vdot(weight * d, d))
                inner += float(np.vdot(weight * d, before))
                J = known.jacobians[k][r]
                own = beside.search.columns(k, r)[: J.shape[2]]
                cross[own] += np.tensordot(J, weight * d, axes=([0, 1], [0, 1]))
        both = solved(known.information[np.ix_(free, free)], np.stack([cross[free], known.gradient[free]], 1))
        curvature = square - float(cross[free] @ both[:, 0])
        slope = inner - float(cross[free] @ both[:, 1])
        if curvature <= SIGNIFICANT * square:
            return Start(point, 0.0)
        best = self._times(stated, self._sizes, -factor * slope / curvature)
        if not best[self._sizes].any():  # it would have to be of the other sign
            return Start(point, 0.0)
        return Start(point, slope**2 / curvature, best)


def promised(here: Evaluation) -> float:
    """Return the misfit that the sensitivities at a point promise: c - g^T H^-1 g."""
    if not np.isfinite(here.cost):
        return np.inf
    return max(here.cost - float(here.gradient @ solved(here.information, here.gradient)), 0.0)
