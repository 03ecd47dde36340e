"""Effects that start with every run, separated from settled ones by the drift of 1X within the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Insertion, limits_of, sizes_at, starts_of
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.search.candidates import Candidate, Round

DRIFTED = "1X drifts within the runs, which {} explains, and this does not"
RESTED = "1X does not drift within the runs as it would"


def told_by_drift(
    evidence: Evidence, chosen: tuple[Candidate, ...], rounds: Sequence[Round], slack: float
) -> tuple[tuple[Candidate, ...], list[Round]]:
    """Return the choice with a law that grows from the start of every run where 1X drifts as it says.

    What the settled motion does not separate from it is excluded then; where 1X does not drift so, the law is. Where
    the runs do not tell, both stay. The choice has the parameters of the fit to harmonics and their drift, and the
    misfit of the harmonics, as all that it is compared with.
    """
    further, rounds = evidence.with_drift(), list(rounds)
    if further is None:
        return chosen, rounds
    for k, item in enumerate(chosen):
        pair = _pair(rounds[k], item)
        if pair is None:
            continue
        bare = _without(chosen[-1].fit.document, item.insertion.name)
        if {one.insertion.name for one in pair} & {*bare["blocks"]}:
            continue
        growing, settled = pair
        decided = _decided(evidence, further, chosen[-1].fit, bare, growing, settled)
        if decided is None:
            continue
        meant, fit = decided
        reach = settled.fit.criterion + slack + CRITERIA.equivalent
        tried = [one for one in rounds[k].tried if one.insertion.key != meant.key]
        if meant.grows:
            why = DRIFTED.format(meant.physics)
            tried = [replace(one, refuted=why) if one.fit.criterion <= reach else one for one in tried]
            own = replace(growing, insertion=meant)
        else:
            tried = [replace(one, refuted=RESTED) if one.insertion.grows else one for one in tried]
            own = settled
        # the settled motion has them both alike, and compares either with its rivals as the settled one
        rounds[k] = rounds[k].with_tried([replace(own, fit=settled.fit), *tried], slack)
        found = [*chosen[:k], own, *chosen[k + 1 :]]  # with its fit beside those before it
        chosen = (*found[:-1], replace(found[-1], fit=fit))
    return chosen, rounds


def _pair(found: Round, item: Candidate) -> tuple[Candidate, Candidate] | None:
    """Return a law that grows from the start of every run, as tried at the place of a choice, and its settled rival.

    One of them is the choice, they read alike, and both are forces; None where there is no such pair.
    """
    tried = [found.as_tried(item), *found.tried]
    here = [one for one in tried if not one.fit.failure and one.insertion.spot == item.insertion.spot]
    here = [one for one in here if one.insertion.fault.enters == "force"]
    here.sort(key=lambda one: (one.insertion.key != item.insertion.key, one.fit.criterion))
    growing = next((one for one in here if one.insertion.grows), None)
    alike = () if growing is None else growing.insertion.fault.confused_with
    settled = next((one for one in here if one.insertion.physics in alike and one.physical), None)
    if growing is None or settled is None or item.insertion.key not in (growing.insertion.key, settled.insertion.key):
        return None
    return growing, settled


def _decided(
    evidence: Evidence, further: Evidence, whole: Fit, bare: Mapping[str, Any], growing: Candidate, settled: Candidate
) -> tuple[Insertion, Fit] | None:
    """Return which of two laws is meant, and its fit beside all others; None where the drift does not tell.

    whole: the fit of all effects; bare: its document without either. The one that grows is meant if it explains more
    of the drift of 1X than noise lets it, and most of what noise does not make, at a lower criterion, and is physical.
    The settled one if the other, from nothing at the start of every run, is worse by `Criteria.equivalent`.
    """
    law, known = growing.insertion, {**settled.fit.values, **whole.values}
    sizes = sizes_at(law, evidence.largest())
    limits, declared = limits_of(law, sizes), starts_of(law, sizes)
    starts = [[dict(zip(law.free, start.values(), strict=True)) for start in declared]]
    begun = {key: known.get(f"{settled.insertion.name}.{key}", 0.0) for key in law.fault.in_drift}
    wide = replace(law, fault=replace(law.fault, free={**law.fault.free, **dict.fromkeys(begun, (0.0,))}))

    def beside(item: Insertion, start: Mapping[str, float]) -> dict[str, Any]:
        document = item.document(bare, start, limits)
        return values_in(document, {name: value for name, value in known.items() if name in document["identify"]})

    own = {key: known.get(f"{settled.insertion.name}.{key}", 0.0) for key in settled.insertion.fault.free}
    still = further.fit(beside(settled.insertion, own), [[{}]])
    moved = further.fit(beside(wide, {**declared[0], **begun}), starts)
    if still.failure or moved.failure:
        return None
    harmonics = [further.at(fit) for fit in (still, moved)]
    if any(fit.failure for fit in harmonics):
        return None
    rows = still.rows - harmonics[0].rows
    drift, left = (fit.misfit - own.misfit for fit, own in zip((still, moved), harmonics, strict=True))
    if rows <= 0:
        return None
    more = len(moved.free) - len(still.free)
    seen = chi2.sf(drift - left, more) < CRITERIA.drift and drift - left > CRITERIA.cause_of_drift * (drift - rows)
    if seen and moved.criterion < still.criterion and Candidate(wide, moved).physical:
        if left > rows:  # not to the last as one exponential: what harmonics say must not suffer for that
            looser = evidence.with_drift(left / rows)
            again = moved if looser is None else looser.fit(moved.document, [[moved.values]])
            moved = moved if again.failure else again
        return _unless_failed(wide, evidence.at(moved))
    narrow = further.fit(beside(law, declared[0]), starts)
    if narrow.failure or narrow.criterion <= still.criterion + CRITERIA.equivalent:
        return None
    return _unless_failed(settled.insertion, evidence.at(still))


def _unless_failed(meant: Insertion, fit: Fit) -> tuple[Insertion, Fit] | None:
    return None if fit.failure else (meant, fit)


def _without(document: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a document without a block that adds a force."""
    blocks, free = dict(document["blocks"]), dict(document["identify"])
    blocks.pop(name, None)
    wires = [wire for wire in document["wires"] if not any(end.strip().startswith(f"{name}.") for end in wire)]
    free = {key: value for key, value in free.items() if not key.startswith(f"{name}.")}
    return {**document, "blocks": blocks, "wires": wires, "identify": free}
