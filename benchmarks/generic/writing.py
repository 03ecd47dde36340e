"""Measure a case and write it as the shared sets are: CASE/, hold_out/CASE/, truth/CASE.json."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.generic import measuring
from benchmarks.generic.generator import IDENTIFY, Case, refit, score
from benchmarks.generic.native import Array

FORMATS = ("npz", "csv", "mat")
MEANING = (
    "nrmse: rms of measured - model over the standard deviation of the channel; total: rms over channels; chi: rms "
    "over channels of residual / noise floor (1: noise alone); held_out_*: on the held-out runs; base_refitted: our "
    "own least squares of the diagram as given; true_refitted: of the true structure, which is achievable"
)


def write_case(case: Case, folder: Path, seed: Sequence[int]) -> dict[str, Any]:
    """Measure a case and write it; return its truth. It depends on the case and the seed."""
    rng = np.random.default_rng([*seed, 1])
    measured = [
        np.column_stack(
            [measuring.read(y[:, k], recorder, case.plant.rate, rng) for k, recorder in enumerate(case.recorders)]
        )
        for y in case.clean
    ]
    suffix = FORMATS[int(rng.integers(len(FORMATS)))]
    for use, runs in (("identify", range(IDENTIFY)), ("hold_out", range(IDENTIFY, len(case.runs)))):
        place = folder / case.name if use == "identify" else folder / "hold_out" / case.name
        place.mkdir(parents=True, exist_ok=True)
        listed = []
        for k in runs:
            name = f"run{k + 1}_{case.excitations[k]}"
            _write_data(place / f"{name}.{suffix}", _columns(case, k, measured[k]))
            rate = f"{case.plant.rate:g} Hz"
            listed.append({"id": name, "file": f"{name}.{suffix}", "sample_rate": rate, "use": use})
        recording = {
            "name": case.name,
            "source": "simulated by a program that shares nothing with rotorsim; noise, pick-up and converter steps of "
            "the recorder are in the data; every run begins at rest",
            "description": f"compare with the diagram {case.plant.name}.json",
            "channels": {name: {"signal": signal, "unit": unit} for name, signal, unit in _channels(case)},
            "runs": listed,
        }
        (place / "recording.json").write_text(json.dumps(recording, indent=1) + "\n")
    truth = tell(case, measured)
    (folder / "truth").mkdir(exist_ok=True)
    (folder / "truth" / f"{case.name}.json").write_text(json.dumps(truth, indent=1) + "\n")
    return truth


def tell(case: Case, measured: Sequence[Array]) -> dict[str, Any]:
    """Return the truth, with what least squares reach without and with what is missing."""
    scores: dict[str, Any] = {"meaning": MEANING, "true_model": _scores(case, case.clean, measured)}
    first = measured[:IDENTIFY]
    theta, _, model = refit(case, (), first, fresh=True)
    everything = model(theta, slice(None))
    scores["base_refitted"] = _scores(case, everything, measured)
    scores["base_parameters"] = _parameters(case, theta)
    known = [effect for effect in case.effects if not effect.law.unpredictable]
    if case.effects:
        theta, _, model = refit(case, known, first)
        scores["true_refitted"] = _scores(case, model(theta, slice(None)), measured)
        scores["true_refitted_parameters"] = _parameters(case, theta)
    effects = [effect.truth() for effect in case.effects]
    for told, effect in zip(effects, case.effects, strict=True):
        others = [other for other in known if other is not effect]
        told["chi_without"] = refit(case, others, first)[1] if len(case.effects) > 1 else scores["base_refitted"]["chi"]
    missing = [effect.law.physics for effect in case.effects]
    return {
        "case": case.name,
        "diagram": case.plant.name,
        "kind": case.kind,
        "missing": missing,
        "class": {effect.law.physics: [effect.law.physics, *effect.law.also] for effect in case.effects},
        "law": case.effects[0].law.key if case.kind == "outside" else None,
        "predictable": len(known) == len(case.effects),
        "detectability": scores["base_refitted"]["chi"],
        "nuisances": "white and coloured noise, 50 Hz pick-up, converter steps: no missing physics",
        "parameters": {name: case.parameters[case.plant.parameters.index(name)] for name in case.plant.free},
        "effects": effects,
        "noise": {
            name: {
                key: getattr(recorder, key) for key in ("white", "coloured", "corner", "mains", "step", "floor")
            }
            for (name, _, _), recorder in zip(case.plant.channels, case.recorders, strict=True)
        },
        "noise_floor": scores["true_model"]["held_out_total"],
        "integration_error": case.error,
        "attempts": case.attempts,
        "scores": scores,
    }  # fmt: skip


def _scores(case: Case, simulated: Sequence[Array] | None, measured: Sequence[Array]) -> dict[str, Any] | None:
    """Return the scores of a model on both kinds of runs; None if it diverges."""
    if simulated is None:
        return None
    out: dict[str, Any] = {}
    for head, runs in (("", slice(0, IDENTIFY)), ("held_out_", slice(IDENTIFY, None))):
        misfit, each, total = score(case, simulated[runs], measured[runs])
        out |= {f"{head}chi": misfit, f"{head}nrmse": each, f"{head}total": total}
    return out


def _parameters(case: Case, theta: Array) -> dict[str, float]:
    """Return the fitted free parameters, by their names in the diagram."""
    names = case.plant.free
    return {name: case.plant.written(name) * float(np.exp(t)) for name, t in zip(names, theta, strict=False)}


def _channels(case: Case) -> list[tuple[str, str, str]]:
    return [*((item.name, item.signal, item.unit) for item in case.plant.inputs), *case.plant.channels]


def _columns(case: Case, run: int, measured: Array) -> dict[str, Array]:
    values = np.hstack([case.runs[run], measured])
    return {name: values[:, k] for k, (name, _, _) in enumerate(_channels(case))}


def _write_data(path: Path, columns: dict[str, Array]) -> None:
    if path.suffix == ".csv":
        table = np.column_stack(list(columns.values()))
        np.savetxt(path, table, fmt="%.12g", delimiter=",", header=",".join(columns), comments="")
    elif path.suffix == ".npz":
        with open(path, "wb") as file:
            np.savez(file, **columns)  # type: ignore[arg-type]
    else:
        from scipy.io import savemat

        savemat(path, columns)
