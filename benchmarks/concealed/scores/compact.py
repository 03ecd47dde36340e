"""Diagnoses of a folder, as `rotorsim diagnose` wrote them or compacted to a line each."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

__all__ = ["LINES", "STOPPED", "TIMES", "compact", "read_diagnoses", "write_lines"]

LINES = "diagnoses.jsonl"
STOPPED = "stopped"  # the verdict of a case without one
TIMES = "times.jsonl"  # a line for each run of the program
DIGITS = 9  # significant; comparison.RELATIVE is a thousand times coarser


def read_diagnoses(folder: Path) -> dict[str, dict[str, Any] | None]:
    """Return the diagnosis of each case: of FOLDER/CASE/diagnosis.json or of a line of FOLDER/diagnoses.jsonl.

    None where a file cannot be read or holds no diagnosis. `cpu_s`: the CPU seconds that it took, where they are known.
    The verdict is STOPPED where the program was killed, as it is when the time for a case is over.

    Raises:
        FileNotFoundError: there is no such folder
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder")
    found: dict[str, dict[str, Any] | None] = {}
    if (folder / LINES).is_file():
        lines = map(json.loads, (folder / LINES).read_text(encoding="utf-8").splitlines())
        found = {line["case"]: line for line in lines}
    for file in sorted(folder.glob("*/diagnosis.json")):
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, json.JSONDecodeError):
            data = None
        # the mistakes of a refused recording are JSON too
        found[file.parent.name] = data if isinstance(data, dict) and "verdict" in data else None
    times = (folder / TIMES).read_text(encoding="utf-8").splitlines() if (folder / TIMES).is_file() else []
    for line in map(json.loads, times):
        if line["exit"] < 0 and not found.get(line["case"]):
            found[line["case"]] = {"verdict": STOPPED}
        if data := found.get(line["case"]):
            data["cpu_s"] = line["cpu_s"]
    return dict(sorted(found.items()))


def write_lines(folder: Path, file: Path) -> int:
    """Write the compacted diagnoses of a folder, a line each; return how many."""
    lines = [{"case": case, **compact(data)} for case, data in read_diagnoses(folder).items() if data]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines), encoding="utf-8")
    return len(lines)


def compact(data: dict[str, Any]) -> dict[str, Any]:
    """Return the verdict, names, places, parameters and scores of a diagnosis under the keys that they had.

    Prose, warnings and counts are left out, and of rejected candidates the reasons. Numbers have 9 significant digits.
    """
    kept = {key: data[key] for key in ("verdict", "where", "fit", "nearest", "residual", "cpu_s") if key in data}
    kept["missing"] = [
        {key: value for key, value in item.items() if key != "parameters"}
        | {"parameters": _estimates(item.get("parameters"))}
        for item in data.get("missing", [])
    ]
    kept["rejected"] = [item if isinstance(item, str) else item["physics"] for item in data.get("rejected", [])]
    kept["parameters"] = {when: _estimates(data.get("parameters", {}).get(when)) for when in ("before", "after")}
    kept["outside"] = {key: value for key, value in data.get("outside", {}).items() if key != "description"}
    kept["detectable"] = data.get("detectable", {})
    rounded: dict[str, Any] = _rounded(kept)
    return rounded


def _estimates(parameters: dict[str, Any] | None) -> dict[str, Any]:
    """Return value, standard deviation and interval of each parameter."""
    return {
        name: {key: item[key] for key in ("value", "std", "interval90") if key in item}
        if isinstance(item, dict)
        else item
        for name, item in (parameters or {}).items()
    }


def _rounded(value: Any) -> Any:
    """Return data with every number rounded to the digits kept."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) and math.isfinite(value) else value
