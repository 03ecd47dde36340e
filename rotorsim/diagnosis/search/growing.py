"""Effects that start with every run, told from settled ones of the same place by how 1X drifts within the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rotorsim.diagnosis.catalogue.insertion import Insertion, sizes_at, starts_of
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.search.candidates import Candidate, Round

DRIFTED = "1X drifts within the runs, which {} explains, and this does not"
RESTED = "1X does not drift within the runs as it would"
CAUSE_OF_DRIFT = 0.5  # of the drift beyond noise: a law that explains less is not its cause


def told_by_drift(
    evidence: Evidence, chosen: tuple[Candidate, ...], rounds: Sequence[Round], slack: float
) -> tuple[tuple[Candidate, ...], list[Round]]:
    """Return the choice with a law that grows from the start of every run where 1X drifts as it says.

    Its rivals are then excluded, else it is: the settled motion alone does not separate them. Of both fits to the
    harmonics with their drifts the one with the lower criterion is right; it must explain most of the drift, too.
    """
    further, rounds = evidence.with_drift(), list(rounds)
    if further is None:
        return chosen, rounds
    for k, item in enumerate(chosen):
        pair = _pair(rounds[k], item)
        if pair is None:
            continue
        growing, settled = pair
        still = further.fit(values_in(settled.fit.document, settled.fit.values), [[{}]])
        wide, moved = _with_growth(further, growing, settled)
        rows = still.rows - settled.fit.rows
        drift = still.misfit - settled.fit.misfit
        grows = moved.criterion < still.criterion and still.misfit - moved.misfit > CAUSE_OF_DRIFT * (drift - rows)
        if grows:
            why = DRIFTED.format(growing.insertion.physics)
            best = replace(growing, insertion=wide, fit=moved)
            # in the settled motion it is its rival, and is compared as that with what it is not told from there
            tried = [replace(best, fit=settled.fit), *(one for one in rounds[k].tried if one is not growing)]
            tried = [one if one.insertion.grows else replace(one, refuted=why) for one in tried]
            chosen = (*chosen[:k], best, *(replace(one, fit=moved) for one in chosen[k + 1 :]))
        else:
            tried = [replace(one, refuted=RESTED) if one.insertion.grows else one for one in rounds[k].tried]
            if item.insertion.grows:
                others = [replace(one, fit=settled.fit) for one in chosen[k + 1 :]]
                chosen = (*chosen[:k], settled, *others)
        rounds[k] = rounds[k].with_tried(tried, slack)
    return chosen, rounds


def _pair(found: Round, item: Candidate) -> tuple[Candidate, Candidate] | None:
    """Return as they were tried at the place of a choice a law that grows from the start of every run, and its rival.

    That one is settled, and reads alike; None where there is no such pair, or neither is the choice.
    """
    tried = [found.as_tried(item), *found.tried]
    here = [one for one in tried if not one.fit.failure and one.insertion.spot == item.insertion.spot]
    here.sort(key=lambda one: one.fit.criterion)
    growing = next((one for one in here if one.insertion.grows), None)
    alike = () if growing is None else growing.insertion.fault.confused_with
    settled = next((one for one in here if one.insertion.physics in alike), None)
    if growing is None or settled is None or item.insertion.key not in (growing.insertion.key, settled.insertion.key):
        return None
    return growing, settled


def _with_growth(evidence: Evidence, growing: Candidate, settled: Candidate) -> tuple[Insertion, Fit]:
    """Return a law with what only the drift of 1X shows free as well, and its fit to that.

    It begins beside the settled one, with little growth.
    """
    item = growing.insertion
    fault = item.fault
    wide = replace(item, fault=replace(fault, free={**fault.free, **dict.fromkeys(fault.in_drift, (0.0,))}))
    same = {f"{item.name}.{key}": f"{settled.insertion.name}.{key}" for key in fault.in_drift}
    known = {name: settled.fit.values[name] for name in growing.fit.values if name in settled.fit.values}
    known |= {name: settled.fit.values[other] for name, other in same.items() if other in settled.fit.values}
    document = values_in(growing.fit.document, {**growing.fit.values, **known})
    document["identify"] = {**document["identify"], **{name: {} for name in same}}
    declared = starts_of(item, sizes_at(item, evidence.largest()))
    starts = [dict(zip(item.free, start.values(), strict=True)) for start in declared]
    return wide, evidence.fit(document, [starts])
