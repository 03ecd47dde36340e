"""How much of what is to be explained right rows explain, and imitators: where the thresholds of a diagnosis lie."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.concealed.scores.compact import read_diagnoses

__all__ = ["shares", "text"]


def shares(folder: Path, diagnoses: Path) -> list[dict[str, Any]]:
    """Return of each diagnosed case what its nearest rows explain.

    right: whether these are those of the truth or of its classes; None where nothing is missing. before, left: times
    the variance of the noise that the diagram as given leaves, and with the rows; share: of what was to be explained.
    """
    found = []
    for case, data in read_diagnoses(diagnoses).items():
        if data is None:
            continue
        truth_file = folder / "truth" / f"{case}.json"
        if not truth_file.exists():
            truth_file = folder / case / "truth.json"
        truth = json.loads(truth_file.read_text())
        nearest = data.get("nearest") or {"physics": [], "share": None, "excess_variance": None}
        classes = [truth.get("class", {}).get(name, [name]) for name in truth["missing"]]
        right = all(any(name in some for name in nearest["physics"]) for some in classes) if classes else None
        found.append(
            {
                "case": case,
                "truth": truth.get("law") or ", ".join(truth["missing"]) or "-",
                "right": right,
                "verdict": data["verdict"],
                "nearest": ", ".join(nearest["physics"]) or "-",
                "share": nearest["share"],
                "before": data["fit"]["before"]["excess_variance"],
                "left": nearest["excess_variance"],
            }
        )
    return found


def text(found: list[dict[str, Any]]) -> str:
    """Return a table of the shares, and what separates right from wrong."""
    lines = [f"{'case':8} {'truth':34} {'nearest':34} {'before':>9} {'left':>9} {'share':>8}  verdict"]
    for item in sorted(found, key=lambda item: (str(item["right"]), -(item["share"] or 0.0))):
        share, left = (f"{item[key]:.4g}" if item[key] is not None else "-" for key in ("share", "left"))
        lines.append(
            f"{item['case']:8} {item['truth']:34} {item['nearest']:34} {item['before']:9.4g} {left:>9} {share:>8}  "
            f"{item['verdict']}"
        )
    told = {
        flag: [i["share"] for i in found if i["right"] is flag and i["share"] is not None] for flag in (True, False)
    }
    healthy = [item["before"] for item in found if item["right"] is None]
    if told[True]:
        lines.append(f"right rows explain at least {min(told[True]):.4f}")
    if told[False]:
        lines.append(f"wrong ones explain at most {max(told[False]):.4f}")
    if healthy:
        lines.append(f"where nothing is missing, at most {max(healthy):.3f} times the variance of the noise is left")
    return "\n".join(lines)
