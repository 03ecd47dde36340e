"""What is missing, in the report of a diagnosis: the effects with their equivalence classes, or an unknown force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rotorsim.diagnosis.conclude.result import Diagnosis, Effect
from rotorsim.errors import escape
from rotorsim.report.diagnosis.words import estimate, flat, own_parameters, percent, place_words, plain_words, quantity
from rotorsim.report.page import paragraph, table
from rotorsim.report.text.table import rpm

CONSISTENT = "No fault candidate of the catalogue explains more than noise would"


def what_is_missing(diagnosis: Diagnosis, data: Mapping[str, Any], speeds: Sequence[float]) -> str:
    """Return the section; data: of diagnosis.json; speeds: of the fitted runs [rad/s]."""
    parts = ["<h2>What</h2>"]
    if diagnosis.verdict == "consistent":
        parts.append(paragraph(CONSISTENT + ("." if diagnosis.residual is None else " in hold-out runs.")))
        parts += [_residual(diagnosis.residual), _detectable(diagnosis.detectable)]
        return "\n".join(parts)
    if diagnosis.verdict == "outside_catalogue":
        parts += _unknown_force(diagnosis, speeds)
    parts += [_effect(diagnosis, data, effect, number) for number, effect in enumerate(diagnosis.effects)]
    if diagnosis.residual is not None:
        parts.append(f"<h3>Residual</h3>{_residual(diagnosis.residual)}")
    if diagnosis.open:
        parts.append("<h3>Tried, but not fitted to the end: not rejected</h3>")
        parts.append(table(["effect", ""], [[plain_words(name), why] for name, why in diagnosis.open]))
    return "\n".join(parts)


def _detectable(sizes: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the smallest size of each fault that would have been detected."""
    rows = [
        [plain_words(name), plain_words(item["parameter"]), quantity(item["value"], item["unit"])]
        for name, item in sorted(sizes.items())
    ]
    header = ["effect", "its", "smallest size detected"]
    return f"<h3>What would have been detected</h3>\n{table(header, rows)}" if rows else ""


def _unknown_force(diagnosis: Diagnosis, speeds: Sequence[float]) -> list[str]:
    unknown = diagnosis.unknown
    rows = flat({} if unknown is None else unknown.data, speeds=[rpm(speed) for speed in speeds])
    nearest = "The nearest fault candidates, which do not explain it:" if diagnosis.effects else ""
    described = "" if unknown is None else unknown.description
    return [paragraph(described), table(["of the unknown force", ""], rows) if rows else "", paragraph(nearest)]


def _effect(diagnosis: Diagnosis, data: Mapping[str, Any], effect: Effect, number: int) -> str:
    insertion, fault = effect.candidate.insertion, effect.candidate.insertion.fault
    place = f" at {effect.spot_of(effect.physics)}"
    parts = [f"<h3>{escape(plain_words(effect.physics))}{escape(place)}</h3>"]
    values = data["parameters"]["after"]
    rows = [[name.rpartition(".")[2], *estimate(values[name])] for name in insertion.free if name in values]
    if rows:
        parts.append(table(["parameter", "value", "90 % interval"], rows))
    facts = {
        "law": fault.law,
        "depends on": insertion.depends_on,
        "block": f"{insertion.name} ({insertion.kind.type_name})",
        "source": fault.source,
        "explains": _share(data["missing"], number),
    }
    parts.append(table(["", ""], [item for item in facts.items() if item[1]], head=False))
    if len(effect.members) > 1:
        parts.append(paragraph("These explain the data as well:"))
        own = {name: (item, item.fit) for name, item in effect.rivals.items()}
        own[effect.physics] = effect.candidate, diagnosis.after
        rows = [
            [
                plain_words(name),
                f"{probability:.2f}",
                place_words(own[name][0].insertion) if name in own else "",
                own_parameters(*own[name]) if name in own else "",
            ]
            for name, probability in effect.members.items()
        ]
        parts.append(table(["effect", "probability", "at", "with"], rows))
        parts.append(paragraph(f"Isolated by: {fault.told_apart_by}." if fault.told_apart_by else ""))
    return "\n".join(parts)


def _share(missing: Sequence[Mapping[str, Any]], number: int) -> str:
    """Return the share that an effect explains with its interval, as diagnosis.json has it."""
    item = missing[number].get("explained") if number < len(missing) else None
    if item is None:
        return ""
    ends = item["interval90"]
    between = "" if ends is None else f" ({percent(ends[0])} to {percent(ends[1])})"
    return f"{percent(item['share'])}{between} of what could be explained there, in hold-out runs"


def _residual(residual: Mapping[str, Any] | None) -> str:
    """Return a table of the residual beyond noise."""
    if residual is None:
        return ""
    rows = [
        ["share of what was to be explained", percent(residual["share"])],
        ["residual variance / noise", f"{residual['excess_variance']:.3g}"],
    ]
    place, size = residual["place"], residual["size"]
    if place is not None:
        node = "" if place["node"] is None else f"[{place['node']}]"
        orders = ", ".join(f"{k}X {quantity(value, size['unit'], 2)}" for k, value in size["orders"].items())
        rows += [
            ["acts most likely at", f"{place['block']}.{place['port']}{node}"],
            ["its size there, rms", quantity(size["value"], size["unit"], 2)],
            ["of orders, rms", orders],
        ]
    return table(["", ""], rows, head=False)
