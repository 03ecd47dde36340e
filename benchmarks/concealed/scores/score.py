"""Judge diagnoses of a set of cases against the truth."""

from __future__ import annotations

import json
from math import log, remainder
from pathlib import Path
from typing import Any

from benchmarks.concealed.scores.compact import read_diagnoses
from benchmarks.concealed.scores.meaning import FREE, compare

OUTSIDE = "outside_catalogue"
DECADES = ((0.0, 100.0), (100.0, 1000.0), (1000.0, float("inf")))


def read_truths(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the truths: `truth/CASE.json` of a set made here, or `CASE/truth.json` of a shared one.

    Raises:
        FileNotFoundError: neither is there
    """
    files = sorted((folder / "truth").glob("*.json")) or sorted(folder.glob("*/truth.json"))
    if not files:
        raise FileNotFoundError(f"{folder}: no truth/CASE.json and no CASE/truth.json")
    truths = {}
    for file in files:
        truth = json.loads(file.read_text())
        missing = truth["missing"]
        if "diagram" in truth:
            _complete_generic(truth)
        truth.setdefault(
            "kind",
            "nothing" if not missing else "outside" if OUTSIDE in missing else "one" if len(missing) == 1 else "two",
        )
        if (
            not (folder / "truth").is_dir() and "diagram" not in truth
        ):  # the shared sets count beta from the front of the crack
            numbers = truth["parameters"]
            truth["parameters"] = numbers | {"beta": numbers["beta"] + numbers["crack_phase"]}
        truth.setdefault("class", {physics: [physics] for physics in missing})
        truth.setdefault("machine", "fe_rigid" if "node" in truth else "jeffcott")
        truth.setdefault("nodes", {physics: truth.get("node") for physics in missing})
        truths[truth["case"]] = truth
    return truths


def _complete_generic(truth: dict[str, Any]) -> None:
    """Give the truth of a generic diagram the keys of those of rotors: kind, synonyms as class, places, floor.

    The shared sets say of a law outside the catalogue that it may be called so.
    """
    effects, scores = truth.get("effects", []), truth["scores"]
    outside = any(OUTSIDE in effect["also_called"] for effect in effects)
    truth.setdefault("kind", "outside" if outside else ("nothing", "one", "two")[min(len(effects), 2)])
    truth.setdefault("class", {effect["physics"]: [effect["physics"], *effect["also_called"]] for effect in effects})
    truth.setdefault("accepted", {effect["physics"]: effect["accepted_locations"] for effect in effects})
    truth.setdefault("noise_floor", scores["true_model"]["held_out_total"])
    truth.setdefault("detectability", scores["base_refitted"]["chi"])
    if truth["kind"] == "outside":
        truth["law"] = truth.get("law") or truth["missing"][0]
    if effects and truth.get("predictable", True) and scores.get("true_refitted"):
        ends = (scores["base_refitted"], scores["true_refitted"])
        truth["held_out"] = [end["held_out_total"] if end else None for end in ends]
    truth |= {"machine": truth["diagram"], "effect": {}, "nodes": {}}


def _number(value: Any) -> float | None:
    """Return a number, or the mean of a table of numbers; None for anything else."""
    if isinstance(value, dict):
        parts = [part for part in map(_number, value.values()) if part is not None]
        return sum(parts) / len(parts) if parts else None
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def _estimate(found: dict[str, Any], true: float, period: float) -> dict[str, Any]:
    """Return error, in shares of the truth (of a radian for angles), and whether the 90 % interval holds the truth."""
    value = float(found["value"])
    off = remainder(value - true, period) if period else value - true
    out: dict[str, Any] = {"error": abs(off) if period else abs(off) / abs(true) if true else None, "covered": None}
    interval = found.get("interval90")
    if interval and None not in interval:
        low, high = (float(end) for end in interval)
        out["covered"] = low <= value - off <= high
    return out


def judge(truth: dict[str, Any], diagnosis: dict[str, Any] | None) -> dict[str, Any]:
    """Return what a diagnosis got right."""
    kind, machine = truth["kind"], truth["machine"]
    result: dict[str, Any] = {
        "case": truth["case"],
        "kind": kind,
        "machine": machine,
        "missing": truth["missing"],
        "law": truth.get("law"),
        "detectability": truth.get("detectability"),
        "verdict": diagnosis["verdict"] if diagnosis else None,
        "named": {},
        "exact": {},
        "located": {},
        "listed": {},
        "parameters": [],
        "free": [],
        "false_names": [],
        "class_sizes": [],
        "credit": {},
        "place_classes": None,
        "places": None,
        "cpu_s": diagnosis.get("cpu_s") if diagnosis else None,
    }
    if diagnosis is None:
        return result
    reported = diagnosis.get("missing", [])
    answers = [(item["physics"], {item["physics"], *item.get("class", [])}, item) for item in reported]
    right: set[str] = set()
    for physics in truth["missing"]:
        right |= set(truth["class"].get(physics, [physics]))
    if kind != "outside":
        for physics in truth["missing"]:
            accepted = set(truth["class"].get(physics, [physics]))
            result["named"][physics] = any(accepted & names for _, names, _ in answers)
            result["exact"][physics] = any(first == physics for first, _, _ in answers)
            classes = _classes(diagnosis.get("where", []))
            result["located"][physics] = _located(truth, physics, classes[: len(truth["missing"])])
            result["listed"][physics] = _located(truth, physics, classes)
            sizes = [len(names) for _, names, _ in answers if accepted & names]
            result["credit"][physics] = 1 / min(sizes) if sizes else 0.0
        for first, _, item in answers:
            if first in truth["missing"] and kind in ("one", "two"):
                effect = _effect(truth, first)
                for name, found in item.get("parameters", {}).items():
                    known = compare(first, name, machine, effect)
                    if known and isinstance(found, dict) and _number(found.get("value")) is not None:
                        result["parameters"].append({"physics": first, "name": name, **_estimate(found, *known)})
    result["false_names"] = [first for first, names, _ in answers if not names & right and first != OUTSIDE]
    result["class_sizes"] = [len(names) for _, names, _ in answers]
    result["place_classes"] = len(_classes(diagnosis.get("where", []))) or None
    result["places"] = len(diagnosis.get("where", [])) or None
    result["right"] = _verdict_right(kind, diagnosis["verdict"], result)
    if kind == "outside" and "accepted" in truth:  # who names a law that others call outside is right as well
        result["right"] |= bool(answers) and all(names & right for _, names, _ in answers)
    if kind == "nothing" or (kind in ("one", "two") and all(result["exact"].values())):
        for name, found in (diagnosis.get("parameters", {}).get("after") or {}).items():
            key = name if name in truth["parameters"] else FREE.get(name, name)
            if key in truth["parameters"] and isinstance(found, dict) and _number(found.get("value")) is not None:
                period = 6.283185307179586 if "phase" in name else 0.0
                result["free"].append({"name": name, **_estimate(found, truth["parameters"][key], period)})
    result |= _held_out(diagnosis.get("fit", {}), truth.get("noise_floor"), truth.get("held_out"))
    return result


def _effect(truth: dict[str, Any], physics: str) -> dict[str, float]:
    """Return the numbers of one effect: two are kept apart by a prefix."""
    head = f"{physics}."
    own = {key[len(head) :]: value for key, value in truth["effect"].items() if key.startswith(head)}
    return own or truth["effect"]


def _located(truth: dict[str, Any], physics: str, classes: list[list[dict[str, Any]]]) -> bool | None:
    """Return whether a place of these classes is right: its block and, on a beam, the node.

    None if the truth has no place.
    """
    best = [place for one in classes for place in one]
    if physics in truth.get("accepted", {}):
        ports = truth["accepted"][physics]
        return any(f"{place.get('block')}.{place.get('port')}" in ports for place in best)
    blocks, node = truth.get("blocks", {}).get(physics), truth["nodes"].get(physics)
    if not blocks and node is None:
        return None
    return any(
        (not blocks or place.get("block") in blocks or place.get("block") == physics)
        and (node is None or place.get("node") == node)
        for place in best
    )


def _classes(where: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Return the places that a diagnosis lists by their classes, which its data do not tell apart, likeliest first."""
    of_class: dict[Any, list[dict[str, Any]]] = {}
    for number, place in enumerate(sorted(where, key=lambda place: -float(place.get("probability") or 0))):
        of_class.setdefault(place.get("class", f"alone {number}"), []).append(place)
    return [*of_class.values()]


def _verdict_right(kind: str, verdict: str, result: dict[str, Any]) -> bool:
    """Return whether the verdict suits the kind; `not_identifiable` is right of what is named within its class."""
    if kind == "nothing":
        return verdict == "consistent"
    if kind == "outside":
        return verdict == OUTSIDE
    if kind == "alias":
        return verdict == "not_identifiable" or (verdict == "missing_physics" and any(result["named"].values()))
    return verdict == "missing_physics" or (verdict == "not_identifiable" and all(result["named"].values()))


def _held_out(
    fit: dict[str, Any], floor: float | None, ends: list[float | None] | None = None
) -> dict[str, float | None]:
    """Return the share of the way, in logarithms, from the misfit before to the noise floor, claimed and true.

    ends: misfits of the diagram and of the true structure, both refitted by the maker of the set: `achieved` is the
    share of the way between them.
    """
    before = _number((fit.get("before") or {}).get("hold_out"))
    after = _number((fit.get("after") or {}).get("hold_out"))
    claimed = _number(fit.get("noise_floor"))
    gain = achieved = None
    if before and after and claimed and before > 1.2 * claimed:
        gain = log(before / after) / log(before / claimed)
    if after and ends and ends[0] and ends[1] and ends[0] > 1.2 * ends[1]:
        achieved = log(ends[0] / after) / log(ends[0] / ends[1])
    told = {"before": before, "after": after, "floor": claimed, "true_floor": floor}
    return told | {"gain": gain, "achieved": achieved}


def judge_all(folder: Path, diagnoses: Path) -> list[dict[str, Any]]:
    """Return the judgement of every case."""
    truths = read_truths(folder)
    found = read_diagnoses(diagnoses)
    return [judge(truth, found.get(case)) for case, truth in truths.items()]
