"""Small diagrams as text, and the problems found in them as short lines."""

import json
from pathlib import Path
from typing import Any

from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.load import load


def diagram(blocks: dict[str, Any], *wires: tuple[str, str], **more: Any) -> dict[str, Any]:
    """Return a document of blocks (a type, or a whole block) and wires."""
    made = {name: {"type": block} if isinstance(block, str) else block for name, block in blocks.items()}
    return {"blocks": made, "wires": [list(wire) for wire in wires], **more}


def block(type_name: str, **parameters: Any) -> dict[str, Any]:
    """Return a block with parameters."""
    return {"type": type_name, "parameters": parameters}


def line(problem: Problem) -> str:
    """Return a problem as one short line: place, subject, what | hint."""
    place = str(problem.place).removeprefix("d.json:")
    mark = "warning: " if problem.severity == "warning" else ""
    return f"{place}: {mark}{problem.subject}: {problem.what} | {problem.hint}"


def mistakes(source: Any, **named: Any) -> list[str]:
    """Return the problems (of a text as if it were the file d.json) as lines; of a good one, its warnings."""
    named.setdefault("folder", Path())
    try:
        if isinstance(source, str):
            Path("d.json").write_text(source)
            named.pop("folder")
            source = Path("d.json")
        return [line(problem) for problem in load(source, **named).warnings]
    except RotorsimError as error:
        return [line(problem) for problem in error.problems]


def written(document: dict[str, Any]) -> str:
    """Return a document as text, one entry a line."""
    parts = ",\n".join(f'"{key}": {json.dumps(value)}' for key, value in document.items())
    return "{" + parts + "}"
