"""What a diagnosis leaves behind: diagnosis.json, the repaired diagram, the report."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.conclude.result import Diagnosis, Effect, estimates, interval
from rotorsim.diagnosis.conclude.shares import Explained
from rotorsim.diagnosis.evidence.evidence import Score
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.errors import RotorsimError
from rotorsim.files import write_atomically
from rotorsim.simulation.stable_step import with_stable_step

DIAGRAM = "diagram.json"
DIAGNOSIS_FILE = "diagnosis.json"
SIGNAL_POINTS = 200  # of a missing signal


def diagnosis_schema() -> dict[str, Any]:
    """Return the JSON schema of diagnosis.json, which says what each key means."""
    schema: dict[str, Any] = json.loads(Path(__file__).with_name("diagnosis.schema.json").read_text(encoding="utf-8"))
    return schema


def diagnosis_data(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as plain data, in the form of diagnosis.json."""
    return {
        "verdict": diagnosis.verdict,
        "where": [
            _place(spot, one.probability, number) | _inside(spot, diagnosis)
            for number, one in enumerate(diagnosis.places, start=1)
            for spot in one.places
        ],
        "missing": _missing(diagnosis),
        "rejected": [{"physics": name, "why": why} for name, why in diagnosis.rejected],
        "open": [{"physics": name, "why": why} for name, why in diagnosis.open],
        "parameters": {"before": _parameters(diagnosis.before), "after": _parameters(diagnosis.after)},
        "fit": {
            "before": _score(diagnosis.score_before, diagnosis.before, diagnosis),
            "after": _score(diagnosis.score_after, diagnosis.after, diagnosis),
            "noise_floor": diagnosis.score_after.noise
            if diagnosis.score_after.noise is not None
            else diagnosis.score_before.noise,
            "held_out": "hold_out" if diagnosis.held_out else "left_out",
        },
        "nearest": _nearest(diagnosis),
        "next_experiment": diagnosis.next_experiment,
        "statement": diagnosis.statement,
        "diagram": DIAGRAM,
        "proof": None
        if diagnosis.proof is None
        else {"status": diagnosis.proof.status, "reason": diagnosis.proof.reason},
        "residual": None if diagnosis.residual is None else dict(diagnosis.residual),
        "detectable": {name: dict(values) for name, values in diagnosis.detectable.items()},
        "outside": _unknown(diagnosis),
        "signals": [_signal(signal) for signal in diagnosis.signals],
        "warnings": [f"{problem.subject}: {problem.what}" for problem in diagnosis.warnings],
        "counts": dict(diagnosis.selection.counts),
    }


def _missing(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    if diagnosis.verdict == "outside_catalogue":
        return [{"physics": "outside_catalogue", "class": ["outside_catalogue"], "probability": 1.0, "parameters": {}}]
    return [
        {
            "physics": effect.physics,
            "class": list(effect.members),
            "probability": effect.members[effect.physics],
            "block": effect.candidate.insertion.name,
            "place": str(effect.spot_of(effect.physics)),
            "depends_on": effect.depends_on(effect.physics) or None,
            "parameters": {**_effect_parameters(effect, diagnosis.after), **_measured(effect, diagnosis)},
            "explained": _explained(diagnosis.explained[number]) if number < len(diagnosis.explained) else None,
        }
        for number, effect in enumerate(diagnosis.effects)
    ]


def _nearest(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Return which candidates explain most in the fitted runs, and the share of the misfit."""
    selection = diagnosis.selection
    if not selection.chosen:
        return None
    physics = [item.insertion.physics for item in selection.chosen]
    return {"physics": physics, "share": selection.share, "excess_variance": _finite(selection.fit.excess_variance)}


def _unknown(diagnosis: Diagnosis) -> dict[str, Any]:
    return {} if diagnosis.unknown is None else {**diagnosis.unknown.data, "description": diagnosis.unknown.description}


def _explained(item: Explained) -> dict[str, Any] | None:
    if item.share is None:
        return None
    ends = None if item.share.interval is None else [_finite(end) for end in item.share.interval]
    return {"share": _finite(item.share.value), "interval90": ends, "explainable": item.explainable}


def _signal(signal: MissingSignal) -> dict[str, Any]:
    """Return a missing signal in the run where it is largest, SIGNAL_POINTS of it, and the places where it may act."""
    run = signal.loudest
    at = np.unique(np.linspace(0, len(run.time) - 1, SIGNAL_POINTS).round().astype(int))
    columns = {"time": run.time, "signal": run.added, "std": run.std, "over_values": run.over, "law": run.law}
    return {
        "place": _port(signal.place),
        "unit": signal.unit,
        "physics": signal.physics or None,
        "over": {"signal": signal.over, "unit": signal.over_unit, "share": signal.share},
        "run": run.run,
        "rms": signal.rms,
        "excess_variance": {"without": signal.without, "with": signal.left},
        "predicted": signal.predicted,
        "repeated": signal.repeated,
        "follows": dict(zip(("exponent", "std"), map(_finite, signal.follows), strict=True)),
        "kurtosis": dict(zip(("excess", "std"), map(_finite, signal.kurtosis), strict=True)),
        "line": signal.line,
        **{name: None if values is None else values[at].tolist() for name, values in columns.items()},
        "classes": [
            {"places": [_port(spot) for spot in one.places], "probability": one.probability} for one in signal.classes
        ],
    }


def _port(spot: Spot) -> dict[str, str]:
    return {"block": spot.block, "port": spot.port, "side": spot.side}


def _place(spot: Spot, probability: float, number: int) -> dict[str, Any]:
    node = spot.beside if spot.node is None else spot.node
    side = {"side": spot.side} if spot.side else {}  # of a signal in time
    place = {"block": spot.block, "port": spot.port, "node": node, "axis": None, "probability": probability}
    return {**place, "class": number, **side}


def _inside(spot: Spot, diagnosis: Diagnosis) -> dict[str, Any]:
    names = diagnosis.inside(spot)
    return {"inside": [*names]} if names else {}


def _effect_parameters(effect: Effect, fit: Fit) -> dict[str, Any]:
    every = _parameters(fit)
    return {name.rpartition(".")[2]: every[name] for name in effect.candidate.insertion.free if name in every}


def _measured(effect: Effect, diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the parameters that asynchronous lines, or quantisation steps of the readings, gave."""
    out = {}
    for key, (value, std, unit) in diagnosis.measured(effect).items():
        ends = [_finite(end) for end in interval(value, std)]
        out[key] = {"value": value, "std": std, "interval90": ends, "unit": unit, "at_bound": False}
    return out


def _parameters(fit: Fit) -> dict[str, Any]:
    return {
        name: {
            "value": item.value,
            "std": _finite(item.std),
            "interval90": [_finite(end) for end in item.interval],
            "unit": item.unit,
            "at_bound": item.at_bound,
        }
        for name, item in estimates(fit).items()
    }


def _score(scored: Score, fit: Fit, diagnosis: Diagnosis) -> dict[str, Any]:
    return {
        "hold_out": scored.total,
        "ports": {k: _finite(v) for k, v in scored.ports.items() if k},
        "excess_variance": _finite(fit.excess_variance),
        "goodness": fit.goodness if diagnosis.evidence.independent else None,
        "adequate": is_adequate(fit),
        "reason": scored.reason or None,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def repaired_document(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the repaired diagram: the values of the fit with their units, the new blocks beside the old ones.

    Where these, or finer meshes, are too fast for its step, with one that RK4 is stable with, or with radau.
    """
    document = copy.deepcopy(dict(diagnosis.document))
    units = {item.name: item.unit for item in diagnosis.after.free}
    for effect in diagnosis.effects:
        taken = diagnosis.measured(effect).items()
        units |= {f"{effect.candidate.insertion.name}.{key}": unit for key, (_, _, unit) in taken}
    for name, unit in units.items():
        block, _, key = name.rpartition(".")
        holder = document["blocks"].get(block, {}).get("parameters", {}) if block else document.get("parameters", {})
        value = holder.get(key)
        if isinstance(value, float) and unit not in ("", "1"):
            holder[key] = f"{value!r} {unit}"
    layout = document.get("layout")
    if isinstance(layout, dict) and layout:
        for effect in diagnosis.effects:
            insertion = effect.candidate.insertion
            if insertion.name not in layout and insertion.spot.block in layout:
                x, y = layout[insertion.spot.block]
                layout[insertion.name] = [x, y + 1.5]
    description = str(document.get("description", "")).rstrip()
    description += "." if description and not description.endswith(".") else ""
    if diagnosis.effects and diagnosis.verdict == "missing_physics":
        names = ", ".join(effect.physics for effect in diagnosis.effects)
        document["description"] = f"{description} Repaired by diagnosis: {names}.".strip()
    try:
        repaired = diagnosis.evidence.load(document)
    except RotorsimError:  # as a part that is not trusted
        return document
    return with_stable_step(document, repaired)


def save_diagnosis(diagnosis: Diagnosis, folder: str | Path) -> list[Path]:
    """Write diagnosis.json and diagram.json into a folder (made if need be); return the files."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / DIAGNOSIS_FILE, folder / DIAGRAM]
    text = json.dumps(diagnosis_data(diagnosis), indent=2, allow_nan=False, default=_plain)
    write_atomically(files[0], text + "\n")
    write_atomically(files[1], format_document(repaired_document(diagnosis)))
    return files


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} in a diagnosis")
