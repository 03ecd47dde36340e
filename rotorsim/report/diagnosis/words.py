"""Numbers, parameters and what is known of an unknown force, as they stand in the report of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.conclude.result import estimates
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.search.candidates import Candidate
from rotorsim.diagram.resolve.registry import all_types
from rotorsim.units import format_quantity

UNITS = {"orders": "N, 0-peak", "phase_to_displacement_deg": "deg"}
MAP = "force_map"  # the block whose terms are the map of an unknown force


def plain_words(name: str) -> str:
    """Return a name without underscores."""
    return name.replace("_", " ")


def percent(value: float | None) -> str:
    """Return a share in percent, nothing for none."""
    return f"{100 * value:.3g} %" if value is not None and math.isfinite(value) else ""


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """Return a value with its unit; angles in degrees."""
    if value is None or not math.isfinite(value):
        return "unbounded"
    if unit == "rad":
        return f"{math.degrees(value):.{digits}g} deg"
    return format_quantity(float(value), None if unit in ("", "1") else unit, digits)


def estimate(item: Mapping[str, Any]) -> list[str]:
    """Return value and 90 % interval of an estimate, with as many digits as its interval has."""
    value, unit, (low, high) = item["value"], item["unit"], item["interval90"]
    if item.get("at_bound"):
        return [quantity(value, unit, 3), "at its bound"]
    digits = 5
    if low is not None and high is not None and high > low and value:
        digits = int(np.clip(2 - math.floor(math.log10((high - low) / abs(value))), 2, 8))
    return [quantity(value, unit, digits), f"{quantity(low, unit, digits)} to {quantity(high, unit, digits)}"]


def own_parameters(candidate: Candidate, fit: Fit) -> str:
    """Return the parameters of a candidate with their values in a fit."""
    known = estimates(fit)
    own = {name.rpartition(".")[2]: known[name] for name in candidate.insertion.free if name in known}
    return ", ".join(f"{name} {quantity(item.value, item.unit)}" for name, item in own.items())


def place_words(insertion: Insertion) -> str:
    """Return where a fault acts in words, with the other signal that it depends on."""
    other = f", depends on {insertion.depends_on}" if insertion.depends_on else ""
    return f"{insertion.spot.words}{other}"


def flat(data: Mapping[str, Any], prefix: str = "", *, speeds: Sequence[float] = ()) -> list[tuple[str, str]]:
    """Return nested plain data as (name, text); speeds: of the runs [rpm], beside what is given for each."""
    rows: list[tuple[str, str]] = []
    for key, value in data.items():
        unit = UNITS.get(key, "")
        name = f"{prefix}{plain_words(key.removesuffix('_deg'))}" + (f" [{unit}]" if unit else "")
        if key == "terms":
            rows += [(f"{prefix}{plain_words(term)}", _term(term, size)) for term, size in value.items()]
        elif isinstance(value, Mapping) and not (value and all(str(k).isdigit() for k in value)):
            rows += flat(value, f"{name}: ")
        else:
            rows.append((name, _text(key, value, speeds)))
    return rows


def _text(key: str, value: Any, speeds: Sequence[float]) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{k}X {v:.3g}" for k, v in value.items())
    if isinstance(value, list | tuple):
        if key == "work_per_turn" and len(value) == len(speeds):
            by_speed = sorted(zip(speeds, value, strict=True))
            return ", ".join(f"{speed:.0f} rpm: {format_quantity(work, 'J', 3)}" for speed, work in by_speed)
        return ", ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in value)
    if isinstance(value, float):
        return f"{percent(value)} of the misfit" if key == "explains" else f"{value:.4g}"
    return str(value)


def _term(name: str, size: float) -> str:
    """Return the value of a term of a map with the unit that the block declares for it."""
    kind = all_types().get(MAP)
    declared = None if kind is None else kind.parameters.get(name)
    return f"{size:.4g} {'' if declared is None else declared.unit or ''}".strip()
