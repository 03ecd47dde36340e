"""The product as tests and benchmarks use it: shipped diagrams, variants of them, and runs of one model."""

from __future__ import annotations

import copy
import json
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate

ROOT = Path(__file__).resolve().parent.parent.parent
DIAGRAMS = ROOT / "diagrams"


def document(name: str) -> dict[str, Any]:
    """Return the JSON of a shipped diagram."""
    found: dict[str, Any] = json.loads((DIAGRAMS / f"{name}.json").read_text(encoding="utf-8"))
    return found


def load_document(content: Mapping[str, Any], **options: Any) -> Any:
    """Load a diagram that is not a file of the repository."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{content.get('name', 'diagram')}.json"
        path.write_text(json.dumps(content), encoding="utf-8")
        return load(path, **options)


def variant(name: str, blocks: Mapping[str, Any] = {}, wires: tuple[tuple[str, str], ...] = (), **top: Any) -> Any:
    """Load a shipped diagram with some blocks replaced or added, wires added, and top-level keys replaced."""
    content = copy.deepcopy(document(name))
    content["blocks"].update(blocks)
    content["wires"] += [list(wire) for wire in wires]
    content.update(top)
    return load_document(content)


@cache
def shipped(name: str, without: tuple[str, ...] = ()) -> Any:
    """Return the compiled model of a shipped diagram."""
    path = DIAGRAMS / f"{name}.json"
    return compile_diagram(load(path, without=list(without)) if without else load(path))


def block_count(name: str) -> int:
    """Return the number of blocks of a shipped diagram."""
    return len(shipped(name).diagram.nodes)


def runner(model: Any, steps: int, **options: Any) -> Callable[[], Any]:
    """Return a function that simulates so many steps; the model (or shipped diagram by name) is compiled before."""
    compiled = shipped(model) if isinstance(model, str) else model
    step = options.pop("step", compiled.diagram.solver.step)

    def action() -> Any:
        return simulate(compiled, stop=steps * step, step=step, **options)

    action()
    return action
