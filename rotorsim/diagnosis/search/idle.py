"""Laws without what the data do not ask of them: idle parameters, and wider laws where a case of them does as well."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from rotorsim.criteria import CRITERIA, Z90
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate
from rotorsim.diagnosis.search.candidates import SAME, Candidate, Round
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT


def without_idle(evidence: Evidence, fit: Fit, laws: Sequence[Insertion]) -> Fit:
    """Return a fit without parameters of its laws whose size the data do not tell from zero.

    One by one, the least significant first, with the angle that means nothing without it, while the criterion falls.
    """
    while True:
        names = [item.name for item in fit.free]
        ratio = {name: value for law in laws for name, value in _idle(fit, law).items()}
        for name in sorted(ratio, key=lambda name: ratio[name]):
            gone = _with_angle(name, names)
            document = values_in(fit.document, {**fit.values, name: 0.0})
            document["identify"] = {key: value for key, value in document["identify"].items() if key not in gone}
            less = evidence.fit(document, [[{}]])
            if not less.failure and less.criterion < fit.criterion:
                fit = less
                break
        else:
            return fit


def _idle(fit: Fit, law: Insertion) -> dict[str, float]:
    """Return the parameters of a law that may be zero, as far as the data tell: how many standard deviations off."""
    names = [item.name for item in fit.free]
    own = [name for name in law.free if name in names]
    ratio: dict[str, float] = {}
    for name in own:
        j = names.index(name)
        item, std = fit.free[j], float(np.sqrt(max(fit.covariance[j, j], 0.0)))
        may_be_zero = item.unit != ANGLE_UNIT and item.low <= 0 <= item.high
        small = abs(fit.theta[j]) <= CRITERIA.significant * std
        if may_be_zero and small and len({*own} - _with_angle(name, own)) > 0:
            ratio[name] = abs(float(fit.theta[j])) / std if std else 0.0
    return ratio


def _with_angle(name: str, names: Collection[str]) -> set[str]:
    """Return a parameter with the angle of the same pair, where there is one."""
    block, _, key = name.rpartition(".")
    letters = key.rstrip("0123456789")
    angles = {f"{block}.{key.replace('amplitude', 'phase')}", f"{block}.{letters}_phase{key[len(letters) :]}"}
    return {name, *(angles & set(names))}


def simplified(evidence: Evidence, found: Round, slack: float) -> Round:
    """Return a round whose laws that explain the data, and may be named, have no idle parameters.

    Else a law would lose against another only by a parameter that it does not need. Of laws of a signal, of which each
    term is a law by itself (a square, a cube); orders of a machine's fault come together. Not where it becomes a case
    of its own that was tried (a drift without a rate): that one is meant.
    """
    if is_adequate(found.before) or not any(is_adequate(item.fit) for item in found.tried):
        return found
    found = _with_needed(evidence, found, slack)
    best = found.best
    if best is None or not is_adequate(best.fit):
        return found
    tried = list(found.tried)
    for k, item in enumerate(tried):
        if not (_of_signal(item) and is_adequate(item.fit) and item.final and item.physical):
            continue
        idle = {each for name in _idle(item.fit, item.insertion) for each in _with_angle(name, item.parameters)}
        charged = len(idle) * float(np.log(max(item.fit.equations, item.fit.rows, 2)))
        if idle and item.fit.criterion - charged <= best.fit.criterion + CRITERIA.equivalent:
            less = without_idle(evidence, item.fit, [item.insertion])
            cases = (one.fit for one in tried if _is_case(one, item))
            if less is not item.fit and all(less.criterion < case.criterion - SAME for case in cases):
                tried[k] = replace(item, fit=less)
    return found.with_tried(tried, slack)


def _with_needed(evidence: Evidence, found: Round, slack: float) -> Round:
    """Return a round in which laws of one size count that explain the data, and nothing without it does.

    Where parameters of the diagram can change along with the size, its interval holds zero although no values there
    explain as much: they end at bounds before. By likelihood, as from the interval: 90 % (chi-squared of one unknown).
    """
    tried, best = list(found.tried), found.best
    most = np.inf if best is None or not is_adequate(best.fit) else best.fit.criterion + CRITERIA.equivalent
    for k, item in enumerate(tried):
        helps = not item.physical and replace(item, needed=True).physical and len(item.parameters) == 1
        if helps and _of_signal(item) and item.final and is_adequate(item.fit) and item.fit.criterion <= most:
            [size] = item.parameters
            document = values_in(item.fit.document, {**item.fit.values, size: 0.0})
            document["identify"] = {key: value for key, value in document["identify"].items() if key != size}
            without = evidence.fit(document, [[{}]])
            least = min(found.before.misfit, np.inf if without.failure else without.misfit)
            tried[k] = replace(item, needed=least > item.fit.misfit + Z90**2)
    return found.with_tried(tried, slack)


def nested(evidence: Evidence, found: Round, item: Candidate, slack: float) -> tuple[Round, Candidate]:
    """Return a round and its choice, or the case of its law that is meant where the data do not tell the two apart.

    They are compared as sharpened where both are approximations (`Insertion.smoothed`): a wider law makes up for what
    is wrong with the narrower one. Where the case is meant, the wider one explains no more wherever both were tried.
    """
    own = found.of(item)
    other = None if own is None else next((one for one in found.tried if _is_nested(own, one)), None)
    if own is None or other is None:
        return found, item
    wider, case = (own, other) if _holds(own, other) else (other, own)
    sharp, exact = (replace(one, fit=evidence.sharpened(one.fit, [one.insertion])[1]) for one in (wider, case))
    if not exact.physical or not (sharp.simpler or exact.fit.criterion <= sharp.fit.criterion):
        return found, item if own is wider else other
    tried = list(found.tried)
    for k, one in enumerate(tried):
        narrow = next((two for two in tried if one.insertion.law == wider.insertion.law and _is_case(two, one)), None)
        if narrow is not None and not one.fit.failure:
            tried[k] = replace(one, fit=replace(one.fit, misfit=max(one.fit.misfit, narrow.fit.misfit)))
    return found.with_tried(tried, slack), item if own is case else other


def _of_signal(item: Candidate) -> bool:
    return item.insertion.fault.enters in ("signal", "replace")


def _is_case(narrow: Candidate, wide: Candidate) -> bool:
    """Return whether a law was fitted where one was that holds it."""
    return _is_here(narrow, wide) and _holds(wide, narrow) and not narrow.fit.failure


def _holds(wider: Candidate, case: Candidate) -> bool:
    return case.insertion.physics in wider.insertion.fault.special_cases


def _is_nested(one: Candidate, other: Candidate) -> bool:
    """Return whether of two approximate laws at one place that explain the data one holds the other."""
    smoothed = bool(one.insertion.smoothed and other.insertion.smoothed)
    both = is_adequate(one.fit) and is_adequate(other.fit) and other.final
    return _is_here(one, other) and smoothed and both and (_holds(one, other) or _holds(other, one))


def _is_here(one: Candidate, other: Candidate) -> bool:
    """Return whether two laws act at one place, and depend on the same other signal, if on any."""
    a, b = one.insertion, other.insertion
    return a.spot == b.spot and a.depends_on == b.depends_on
