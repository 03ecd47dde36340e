"""What is said of a coupling: what it does to stability, and what its FMUs said. made: its provenance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rotorsim.errors import Problem, visible
from rotorsim.report.text.table import counted

TOLD = 100  # characters of a text variable


def stability_lines(made: Mapping[str, Any]) -> list[str]:
    """Return what is said of the stability of the coupling."""
    if "stability_not_analysed" in made:
        return [f"stability of the coupling: not analysed ({made['stability_not_analysed']})"]
    if "largest_stable_step" not in made:
        return []
    limit, kept = made["largest_stable_step"], made["damping_kept"]
    if limit == 0:
        return ["the linearised loop is unstable as a whole, with any step"]
    said = f"largest stable step: {limit:.3g} s" if limit < float("inf") else "stable with all steps tried"
    shown = "not told (no mode oscillates)" if kept is None else f"{kept:.1%}"
    return [f"damping kept by the coupling: {shown}; {said}"]


def fmu_lines(made: Mapping[str, Any]) -> list[str]:
    """Return what is said of the FMUs of a co-simulation: parts of steps, texts at the end."""
    lines = []
    for name, about in made.get("fmus", {}).items():
        if about["most_parts"] > 1:
            parts = f"taken in up to {about['most_parts']} parts, {about['do_steps']} calls of doStep"
            lines.append(f"{name}: its inputs move within a step: {parts}")
        lines += [
            f"{name}: {text} is '{visible(' '.join(said.split())[:TOLD])}' at the end"
            for text, said in about["texts"].items()
        ]
    return lines


def said_by_fmus(made: Mapping[str, Any], hint: str) -> list[Problem]:
    """Return what FMUs have warned of. hint: where all is kept that they say."""
    problems = []
    for name, about in made.get("fmus", {}).items():
        odd = sum(count for status, count in about["messages"].items() if status != "OK")
        calls = f"{counted(about['warnings'], 'call')} returned a warning" if about["warnings"] else ""
        messages = f"{counted(odd, 'message')} of warnings or errors" if odd else ""
        if calls or messages:
            what = "; ".join(filter(None, (calls, messages)))
            said = "".join(f"\n  it said: {line[:300]}" for line in about["said"])
            problems.append(Problem(what + said, name, hint=hint, severity="warning"))
    return problems
