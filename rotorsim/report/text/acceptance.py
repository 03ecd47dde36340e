"""Acceptance of a machine as text and data."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotorsim.acceptance.acceptance import Acceptance
from rotorsim.acceptance.conditions import Conditions
from rotorsim.acceptance.criterion import Criterion
from rotorsim.files import json_number
from rotorsim.report.text.table import rpm, table

CRITERION_COLUMNS = ("verdict", "quantity", "where", "value", "limit", "", "clause")
LEFT = (0, 1, 2, 5, 6)


def acceptance_text(result: Acceptance) -> str:
    """Return every criterion, part by part, and the verdict."""
    parts = [f"{result.name}: {conditions_text(result.conditions)}"]
    for part in result.parts:
        lines = [part.title]
        if part.criteria:
            lines.append(table(CRITERION_COLUMNS, [cells(one) for one in part.criteria], left=LEFT))
        parts.append("\n".join([*lines, *(f"note: {note}" for note in part.notes)]))
    return "\n\n".join([*parts, verdict_text(result)])


def verdict_text(result: Acceptance) -> str:
    """Return the verdict and what it counts."""
    return f"verdict: {result.verdict} ({result.statement})"


def conditions_text(given: Conditions) -> str:
    """Return the speeds, clearances and the zone a machine is judged at, in words."""
    said = []
    if np.isfinite(given.highest):
        ends = dict.fromkeys(f"{rpm(speed):.6g}" for speed in (given.lowest, given.highest))
        said.append(f"{' to '.join(ends)} rpm, trip at {rpm(given.trip):.6g} rpm")
    for place, value in given.clearance.items():
        said.append(f"clearance {value * 1e6:.4g} um{f' at {place}' if place else ''}")
    return "; ".join([*said, f"zone {given.zone} or better"])


def cells(one: Criterion) -> tuple[str, ...]:
    """Return the cells of a criterion under `CRITERION_COLUMNS`."""
    verdict = one.verdict if one.required else f"({one.verdict})"
    what = f"{one.what}, measured" if one.source == "measured" else one.what
    return verdict, what, one.where, value_text(one), limit_text(one), one.said, one.clause


def value_text(one: Criterion) -> str:
    """Return the value with its interval and unit."""
    if np.isnan(one.value):
        return "-"
    unit = "" if one.unit == "1" else f" {one.unit}"
    if one.interval90 is None:
        return f"{one.value:.3g}{unit}"
    low, high = one.interval90
    return f"{one.value:.3g} ({low:.3g} to {high:.3g}){unit}"


def limit_text(one: Criterion) -> str:
    """Return the limit with its unit: at most, or at least."""
    if not np.isfinite(one.limit):
        return "-"
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"{'<=' if one.at_most else '>='} {one.limit:.3g}{unit}"


def acceptance_data(result: Acceptance) -> dict[str, Any]:
    """Return all criteria in the form of --json; clearances and speeds in SI."""
    given = result.conditions
    return {
        "name": result.name,
        "diagram": None if result.diagram is None else result.diagram.name,
        "recordings": list(result.recordings),
        "verdict": result.verdict,
        "conditions": {
            "operating": [json_number(given.lowest), json_number(given.highest)],
            "trip": json_number(given.trip),
            "probes": list(given.probes),
            "clearance": dict(given.clearance),
            "planes": list(given.planes),
            "zone": given.zone,
            "cross_coupling": dict(given.cross_coupling),
        },
        "parts": [
            {
                "title": part.title,
                "criteria": [_criterion_data(one) for one in part.criteria],
                "notes": list(part.notes),
            }
            for part in result.parts
        ],
        "notes": list(given.notes),
    }


def _criterion_data(one: Criterion) -> dict[str, Any]:
    return {
        "verdict": one.verdict,
        "required": one.required,
        "source": one.source,
        "clause": one.clause,
        "quantity": one.what,
        "where": one.where,
        "value": json_number(one.value),
        "interval90": None if one.interval90 is None else [json_number(end) for end in one.interval90],
        "limit": json_number(one.limit),
        "limit_is": "at most" if one.at_most else "at least",
        "unit": one.unit,
        "said": one.said,
    }
