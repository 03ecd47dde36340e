"""Fault candidates as they were fitted, and the rounds of the selection that tried them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rotorsim.criteria import Z90
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.evidence.evidence import Promise
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass

SAME = 0.01  # of -2 log likelihood: says nothing

Job = tuple[dict[str, Any], list[list[dict[str, float]]]]  # a document with an insertion, groups of starts


@dataclass(frozen=True, eq=False)
class Candidate:
    """An insertion and the refitted diagram with it.

    astray: parameters of the diagram that have left all reason. final: whether the fit was carried to the end. needed:
    whether the diagram was refitted without it from there, and explains less. refuted: by what, beside the misfit.
    """

    insertion: Insertion
    fit: Fit
    astray: str = ""
    final: bool = True
    needed: bool = False
    refuted: str = ""

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of the parameters of the fault in the diagram."""
        return tuple(name for name in self.insertion.free if name in self.fit.values)

    @property
    def ended(self) -> tuple[str, ...]:
        """The parameters of the fault that ended at a bound."""
        ended = {item.name for item, end in zip(self.fit.free, self.fit.at_bound, strict=True) if end}
        return tuple(name for name in self.parameters if name in ended)

    @property
    def physical(self) -> bool:
        """Whether this can be: see `unphysical`."""
        return not self.unphysical

    @property
    def unphysical(self) -> str:
        """Why this cannot be, empty where it can.

        A parameter of the fault ended at a bound; none of its sizes differs significantly from zero (their 90 %
        intervals hold it, were the rest of its law known), unless it is needed; its 90 % interval holds a simpler law;
        it needs a parameter of the diagram far beyond all reason, as one that cancels the effect is; or it is refuted.
        """
        fit = self.fit
        if fit.failure:
            return ""
        if self.refuted:
            return self.refuted
        if self.ended:
            return f"its {', '.join(name.rpartition('.')[2] for name in self.ended)} ended at a physical bound"
        names = [item.name for item in fit.free]
        sizes = [name for name in self.parameters if name.rpartition(".")[2] in self.insertion.fault.sizes]
        std = fit.alone if len(fit.alone) else np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
        significant = (abs(fit.theta[j]) > Z90 * std[j] for j in map(names.index, sizes))
        if sizes and not self.needed and not any(significant):
            keys = " and ".join(name.rpartition(".")[2] for name in sizes)
            return f"its {keys} is not significantly different from zero"
        if self.simpler is not None:
            key, value, other = self.simpler
            return f"its {key} is not significantly different from {value:g}: {other}"
        return f"needs {self.astray}" if self.astray else ""

    @property
    def simpler(self) -> tuple[str, float, str] | None:
        """The parameter whose 90 % interval holds a simpler law, its value there, and the physics of that law."""
        names = [item.name for item in self.fit.free]
        for name in self.parameters:
            key, j = name.rpartition(".")[2], names.index(name)
            value, other = self.insertion.fault.simpler.get(key, (np.nan, ""))
            found, half = self.fit.values[name], Z90 * float(np.sqrt(max(self.fit.covariance[j, j], 0.0)))
            off = abs(found) if np.isinf(value) else abs(found - value)  # 1/found is off 0 by half / found^2
            if half >= off:
                return key, value, other
        return None


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the selection: what was tried on top of ``before``, the best first; classes: of free signals.

    hypotheses: how many, physics and places, were looked at, with those of which too little was promised to try them.
    elsewhere: what was not tried, and promises nearly as much as the same law does at its best place; untried: all that
    was not, where promises of laws are known. likely: the keys of what another measure of the noise may make the most
    promising, None where promises are not known. excluded: what leaves too much by linear theory of its law. shares:
    what was promised, by key, as a share of what the diagram leaves; weighed_by: the noise by which it was.
    """

    before: Fit
    tried: tuple[Candidate, ...]
    classes: tuple[PlaceClass, ...] = ()
    hypotheses: int = 0
    elsewhere: tuple[tuple[Insertion, Job], ...] = ()
    untried: tuple[tuple[Insertion, Job], ...] = ()
    likely: frozenset[str] | None = None
    excluded: tuple[tuple[Insertion, Promise], ...] = ()
    shares: Mapping[str, float] = field(default_factory=dict)
    weighed_by: Mapping[Any, float] = field(default_factory=dict)

    @property
    def best(self) -> Candidate | None:
        """The best candidate that is physical."""
        return next((item for item in self.tried if not item.fit.failure and item.physical), None)

    @property
    def nearest(self) -> Candidate | None:
        """The candidate that leaves least, be it physical or not."""
        fitted = [item for item in self.tried if not item.fit.failure]
        return min(fitted, key=lambda item: item.fit.misfit, default=None)

    def as_tried(self, candidate: Candidate) -> Candidate:
        """Return a candidate with the fit that it has in this round."""
        same = self.of(candidate)
        return Candidate(candidate.insertion, candidate.fit if same is None else same.fit)

    def of(self, candidate: Candidate) -> Candidate | None:
        """Return what was tried here of a candidate; None if it was not, or has no fit."""
        fitted = (item for item in self.tried if not item.fit.failure)
        return next((item for item in fitted if item.insertion.key == candidate.insertion.key), None)

    def worth_again(self, most: int) -> dict[str, dict[str, float]]:
        """Return the values of the best fits that another measure of the noise may make the best, by their keys."""
        fitted = [item for item in self.tried if not item.fit.failure]
        best = [item for item in fitted if self.likely is None or item.insertion.key in self.likely][:most]
        return {item.insertion.key: item.fit.values for item in best}

    def with_tried(self, tried: Sequence[Candidate], slack: float) -> Round:
        """Return the round with what was tried until now; slack: see `simplest_first`."""
        done = {item.insertion.key for item in tried}
        elsewhere, untried = (
            tuple(pair for pair in pairs if pair[0].key not in done) for pairs in (self.elsewhere, self.untried)
        )
        return replace(self, tried=tuple(simplest_first(tried, slack)), elsewhere=elsewhere, untried=untried)

    def beside(self, chosen: Insertion, physics: Collection[str], *, every: bool) -> list[tuple[Insertion, Job]]:
        """Return what is left to try beside a choice: its law where it promises as much, these physics in its place.

        Or at those that no free signal tells from it. They depend on no further signal, or on the same one. every: all
        physics in its very place.
        """
        pairs = {item.key: (item, job) for item, job in self.elsewhere if item.law == chosen.law}
        alike = next((one.places for one in self.classes if chosen.spot in one.places), ())
        for item, job in self.untried:
            here = item.spot == chosen.spot
            if item.depends_on in ("", chosen.depends_on) and (
                (here and every) or ((here or item.spot in alike) and item.physics in physics)
            ):
                pairs[item.key] = item, job
        return [*pairs.values()]


def simplest_first(tried: Sequence[Candidate], slack: float) -> list[Candidate]:
    """Return candidates by their criterion; of those that it does not tell from the best, the simplest first.

    A signal that is wrong where it is taken is simpler than one whose reading is wrong as well.
    """
    tried = sorted(tried, key=lambda item: (bool(item.fit.failure), item.fit.criterion))
    least = next((item.fit.criterion for item in tried if not item.fit.failure and item.physical), np.inf)
    most = least + max(slack, SAME)
    near = [item for item in tried if not item.fit.failure and item.physical and item.fit.criterion <= most]
    near.sort(key=lambda item: (len(item.fit.free), bool(item.insertion.spot.side), item.fit.criterion))
    return [*near, *(item for item in tried if item not in near)]
