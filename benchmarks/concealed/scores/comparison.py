"""Two folders of diagnoses of the same recordings, beside each other: what a change of the program changed.

Verdicts, names with their classes, and places must be the same. Numbers are the same if they differ by at most 1e-6
of the larger one or, where both belong to an estimate, of its standard deviation: an angle of 1e-9 rad known to 0.1 rad
has no digits to keep. Probabilities are the same within 1e-6. Prose, reasons, counts and times are not compared.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.concealed.scores.compact import compact, read_diagnoses

__all__ = ["RELATIVE", "compare_diagnoses", "compare_folders", "text"]

RELATIVE = 1e-6


def compare_folders(before: Path, after: Path, only_common: bool = False) -> dict[str, Any]:
    """Return the comparison of each case, and whether all are the same.

    only_common: cases that one folder lacks do not count.

    Raises:
        FileNotFoundError: a folder is not there, or holds no diagnosis
    """
    sides = [read_diagnoses(folder) for folder in (before, after)]
    for folder, found in zip((before, after), sides, strict=True):
        if not found:
            raise FileNotFoundError(f"{folder}: no CASE/diagnosis.json and no diagnoses.jsonl")
    lacking = {
        str(folder): sorted(set(other) - set(own))
        for folder, own, other in ((before, *sides), (after, sides[1], sides[0]))
    }
    cases = [
        {"case": case, **compare_diagnoses(sides[0][case], sides[1][case])} for case in sides[0] if case in sides[1]
    ]
    same = all(case["same"] for case in cases) and (only_common or not any(lacking.values()))
    return {"same": bool(cases) and same, "relative": RELATIVE, "lacking": lacking, "cases": cases}


def compare_diagnoses(before: dict[str, Any] | None, after: dict[str, Any] | None) -> dict[str, Any]:
    """Return whether two diagnoses agree in verdict, names, places and numbers, and the values that differ.

    None is a diagnosis that cannot be read; it agrees with nothing.
    """
    if before is None or after is None:
        said = {when: "unreadable" if data is None else "-" for when, data in (("before", before), ("after", after))}
        differences = [{"what": "file", **said, "relative": None}]
        decisions = dict.fromkeys(("verdict", "names", "places"), False)
        return {"same": False, **decisions, "numbers": 0, "largest": None, "differences": differences}
    one, two = ({key: value for key, value in compact(data).items() if key != "cpu_s"} for data in (before, after))
    decided = {
        "verdict": (one["verdict"], two["verdict"]),
        "names": (_names(one), _names(two)),
        "places": (_places(one), _places(two)),
    }
    differences = [
        {"what": what, "before": first, "after": second, "relative": None}
        for what, (first, second) in decided.items()
        if first != second
    ]
    values, others = dict(_leaves(one)), dict(_leaves(two))
    largest, numbers = 0.0, 0
    for what in [*values, *(key for key in others if key not in values)]:
        (first, scale), (second, other) = values.get(what, (None, 0.0)), others.get(what, (None, 0.0))
        if _is_number(first) and _is_number(second):
            numbers += 1
            off = _difference(float(first), float(second), max(scale, other))
            largest = max(largest, off)
            if off <= RELATIVE:
                continue
        elif first == second:
            continue
        else:
            off = math.inf
        differences.append(
            {"what": what, "before": first, "after": second, "relative": off if math.isfinite(off) else None}
        )
    return {
        "same": not differences,
        **{what: first == second for what, (first, second) in decided.items()},
        "numbers": numbers,
        "largest": largest,
        "differences": differences,
    }


def _names(data: dict[str, Any]) -> str:
    """Return what is missing, each with its class."""
    items = ((item["physics"], sorted(set(item.get("class", [])) - {item["physics"]})) for item in data["missing"])
    return ", ".join(physics + (f" ({', '.join(rivals)})" if rivals else "") for physics, rivals in items) or "-"


def _places(data: dict[str, Any]) -> str:
    """Return the places, the most probable first; places of the same probability in any order."""
    ranked = sorted(
        (-round(float(place.get("probability") or 0.0), 6), _place(place)) for place in data.get("where", [])
    )
    return ", ".join(name for _, name in ranked) or "-"


def _place(place: dict[str, Any]) -> str:
    parts = (place.get(key) for key in ("wire", "block", "port", "node", "axis"))
    return ".".join(str(part) for part in parts if part is not None)


def _leaves(data: dict[str, Any]) -> Iterator[tuple[str, tuple[Any, float]]]:
    """Yield every value that is compared number by number, with the scale that a small one is measured by."""
    for place in data.get("where", []):
        yield f"probability of {_place(place)}", (place.get("probability"), 1.0)
    for item in data["missing"]:
        yield f"probability of {item['physics']}", (item.get("probability"), 1.0)
        yield from _estimates(item["physics"], item["parameters"])
        yield from _plain(f"{item['physics']}, explained", item.get("explained"))
    for when, parameters in data["parameters"].items():
        yield from _estimates(f"parameters {when}", parameters)
    for key in ("fit", "nearest", "residual", "outside", "detectable"):
        yield from _plain(key, data.get(key))
    yield "rejected", (", ".join(sorted(data["rejected"])), 0.0)


def _estimates(of: str, parameters: dict[str, Any]) -> Iterator[tuple[str, tuple[Any, float]]]:
    """Yield values, standard deviations and ends of intervals; the scale is the standard deviation."""
    for name, item in parameters.items():
        estimate = item if isinstance(item, dict) else {"value": item}
        scale = float(estimate.get("std") or 0.0)
        for key, (value, _) in _plain(f"{of}, {name}", estimate):
            yield key, (value, scale)


def _plain(of: str, value: Any) -> Iterator[tuple[str, tuple[Any, float]]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _plain(f"{of}, {key}", item)
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from _plain(f"{of}[{number}]", item)
    elif value is not None:
        yield of, (value, 1.0 if of.endswith("goodness") else 0.0)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _difference(first: float, second: float, scale: float) -> float:
    """Return |first - second| over the largest of both and the scale."""
    if first == second:
        return 0.0
    if not (math.isfinite(first) and math.isfinite(second)):
        return math.inf
    return abs(first - second) / max(abs(first), abs(second), scale)


def text(result: dict[str, Any]) -> str:
    """Return the comparison as a table, and below it every value that differs."""
    wide = max((len(case["case"]) for case in result["cases"]), default=4)
    lines = [
        f"{'case':{wide}} {'verdict':8} {'names':8} {'places':8} {'numbers':>8} {'largest':>9}  beyond {RELATIVE:g}"
    ]
    for case in result["cases"]:
        said = (("same" if case[what] else "DIFFERS") for what in ("verdict", "names", "places"))
        largest = "-" if case["largest"] is None else f"{case['largest']:.2g}"
        beyond = sum(item["what"] not in ("verdict", "names", "places") for item in case["differences"]) or "-"
        words = " ".join(f"{word:8}" for word in said)
        lines.append(f"{case['case']:{wide}} {words} {case['numbers']:8} {largest:>9}  {beyond}")
    for folder, cases in result["lacking"].items():
        if cases:
            lines.append(f"not in {folder}: {', '.join(cases)}")
    for case in result["cases"]:
        for item in case["differences"]:
            off = "" if item["relative"] is None else f"  ({item['relative']:.2g})"
            lines.append(f"{case['case']}: {item['what']}: {_shown(item['before'])} -> {_shown(item['after'])}{off}")
    same = sum(case["same"] for case in result["cases"])
    lines.append(f"{same} of {len(result['cases'])} the same")
    return "\n".join(lines)


def _shown(value: Any) -> str:
    return f"{value:.9g}" if isinstance(value, float) else "-" if value is None else json.dumps(value).strip('"')
