"""A force outside the catalogue: what the evidence says of it, and a map of it fitted in the loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Effort, Fit
from rotorsim.diagnosis.search.candidates import Job
from rotorsim.diagnosis.search.work import Work

FORCE_TERMS = ("cubic", "damping_growth", "drag", "friction", "quadratic", "cross", "cross_cubic", "quintic")
MOST_TERMS = 4
FORCE_MAP = "force_map"


@dataclass(frozen=True, eq=False)
class UnknownForce:
    """What is known of a force: plain data for diagnosis.json, a description in words, and the fitted map."""

    data: Mapping[str, Any]
    description: str
    fit: Fit | None


def unknown_force(base: Fit, work: Work, spot: Spot) -> UnknownForce:
    """Return what can be said of an unknown force at a spot, beside the fitted diagram as given."""
    document = values_in(base.document, base.values)
    known = work.evidence.unknown_force(document, spot)
    data, words = {"place": str(spot), **known.data}, [*known.words]
    mapped = _mapped(base, document, work, spot)
    if mapped is not None:
        fit, terms = mapped
        share = 1 - fit.misfit / base.misfit
        data["map"] = {"terms": {t: fit.values[f"{FORCE_MAP}.{t}"] for t in terms}, "explains": share}
        if terms:
            words.append(
                f"a map of displacement and velocity ({', '.join(terms)}) explains {100 * share:.3g} % of the misfit"
                + ("; the rest has memory or another cause" if fit.misfit > 4 * fit.freedom else "")
            )
    text = f"The unknown force at {spot}: " + "; ".join(words) + "." if words else ""
    return UnknownForce(data, text, mapped[0] if mapped else None)


def _mapped(base: Fit, document: Mapping[str, Any], work: Work, spot: Spot) -> tuple[Fit, Sequence[str]] | None:
    """Return the diagram with a force map whose terms were chosen one by one, refitted in the loop."""
    node = work.evidence.load(document).nodes.get(spot.block)
    if node is None or spot.port not in node.inputs or "velocity" not in node.outputs:
        return None
    index = "" if spot.node is None else f"[{spot.node}]"
    ports = (("displacement", f"{FORCE_MAP}.displacement"), ("velocity", f"{FORCE_MAP}.velocity"))
    wires = [[f"{spot.block}.{port}{index}", target] for port, target in ports]
    wires.append([f"{FORCE_MAP}.force", f"{spot.block}.{spot.port}{index}"])
    scales = _scales(work.evidence, spot)
    best, chosen = base, tuple[str, ...]()
    while len(chosen) < MOST_TERMS:
        tried = [(*chosen, term) for term in FORCE_TERMS if term not in chosen]
        jobs: list[Job] = []
        for terms in tried:
            values = {t: best.values.get(f"{FORCE_MAP}.{t}", 1e-3 * scales[t]) for t in terms}
            block = {"type": "force_map", "parameters": {**values, "width": scales["width"]}}
            new = values_in(document, best.values)
            new["blocks"][FORCE_MAP] = block
            new["wires"] = [*new["wires"], *wires]
            new["identify"] = {**new.get("identify", {}), **{f"{FORCE_MAP}.{t}": {} for t in terms}}
            jobs.append((new, [[{}]]))
        found = work.fits(jobs, Effort(most=12))
        fits = {terms: fit for terms, fit in zip(tried, found, strict=True) if not fit.failure}
        terms = min(fits, key=lambda terms: fits[terms].misfit, default=())
        if not terms or fits[terms].misfit > (1 - CRITERIA.map_term) * best.misfit:
            break
        best, chosen = fits[terms], terms
        if best.misfit < 1.1 * best.freedom:
            break
    return best, chosen


def _scales(evidence: Evidence, spot: Spot) -> dict[str, float]:
    """Return the size of each term that makes a force of one newton at the largest motion."""
    largest = evidence.largest()
    sizes = {
        port: max((v for name, v in largest.items() if name.startswith(f"{spot.block}.{port}")), default=0.0)
        for port in ("displacement", "velocity")
    }
    q = sizes["displacement"] or 1e-5
    v = sizes["velocity"] or 100.0 * q
    return {
        "quadratic": 1 / q**2,
        "cubic": 1 / q**3,
        "quintic": 1 / q**5,
        "drag": 1 / v**2,
        "friction": 1.0,
        "damping_growth": 1 / (q**2 * v),
        "cross": 1 / q,
        "cross_cubic": 1 / q**3,
        "width": 0.05 * v,
    }
