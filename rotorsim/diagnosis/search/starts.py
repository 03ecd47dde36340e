"""Where fits begin: where a fault declares, where it is known to be near, and off the bounds that held a parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import STARTS_TRIED, Insertion, fixed_of, limits_of, sizes_at, starts_of
from rotorsim.diagnosis.evidence.evidence import Promise
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.search.candidates import Job

DECLARED = 2  # starts of a law that are tried beside one that is known to be near
RESTART = 0.1  # of its scale: how far off a bound a parameter of the diagram begins again


def jobs_of(
    found: Sequence[Insertion],
    document: Mapping[str, Any],
    largest: Mapping[str, float],
    away: Mapping[str, float],
    given: Mapping[str, float] | None,
) -> list[Job]:
    """Return the document of each insertion, and groups of starts of its parameters.

    largest: magnitudes of signals. away: parameters of the diagram off their bounds, from which each start is tried
    as well; given: values of the diagram from which all are tried once more, None where that costs too much.
    """
    jobs = []
    for item in found:
        sizes = sizes_at(item, largest)
        starts, fixed = starts_of(item, sizes), fixed_of(item, sizes)
        here = [dict(zip(item.free, start.values(), strict=True)) for start in starts[:STARTS_TRIED]]
        groups = [[{**off, **start} for off in (({}, away) if away else ({},)) for start in here]]
        if given is not None:
            groups.append([{**given, **start} for start in here])
        jobs.append((item.document(document, {**fixed, **starts[0]}, limits_of(item, sizes)), groups))
    return jobs


def led(groups: list[list[dict[str, float]]], start: dict[str, float]) -> list[list[dict[str, float]]]:
    """Return one that is known to be near, the same beside the diagram as given, and DECLARED starts, in one group."""
    if not start:
        return groups
    return [[start, {**groups[-1][0], **start}, *({**start, **group[0]} for group in groups[:DECLARED])]]


def near_laws(jobs: Sequence[Job], laws: Mapping[int, Promise]) -> list[Job]:
    """Return jobs with what is known of their laws {job: promise} as one start more."""
    pairs = ((job, laws[k].start if k in laws else {}) for k, job in enumerate(jobs))
    return [(document, with_near(groups, start)) for (document, groups), start in pairs]


def with_near(groups: list[list[dict[str, float]]], start: Mapping[str, float]) -> list[list[dict[str, float]]]:
    """Return groups with one start more in the first, which may be near; what it leaves open is that of the last group.

    Where there are several, its law in the last as well, which begins beside the diagram as given.
    """
    if not start:
        return groups
    law = {name: value for name, value in start.items() if name in groups[0][0]}
    near = {**groups[-1][0], **start}
    last = [[{**groups[-1][0], **law}, *groups[-1]]] if len(groups) > 1 else []
    return [[near, *groups[0]], *groups[1:-1], *last]


def off_bounds(fit: Fit, nominal: Mapping[str, float]) -> dict[str, float]:
    """Return where parameters of the diagram as given that ended at a bound begin again: as given, off the bound.

    What held one there may be gone with the next effect.
    """
    found = {}
    for item, ended in zip(fit.free, fit.at_bound, strict=True):
        if ended and item.name in nominal:
            off = min(RESTART * (item.scale or 1.0), (item.high - item.low) / 2)
            found[item.name] = float(np.clip(nominal[item.name], item.low + off, item.high - off))
    return found
