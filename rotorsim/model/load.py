"""Load a diagram: a document resolved, its equations traced, its algebraic loops found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.resolution import raise_errors, resolve
from rotorsim.diagram.standalone import Standalone, standalone
from rotorsim.errors import RotorsimError
from rotorsim.model.trace.order import block_traces, evaluation_order


def load(
    source: str | Path | Mapping[str, Any],
    *,
    set: Mapping[str, Any] | None = None,
    without: Iterable[str] = (),
    trust_blocks: bool = False,
    folder: str | Path | None = None,
) -> Diagram:
    """Load a diagram from a file, the name of a shipped diagram, or a document in memory.

    set: "speed", "block.param" or "solver.step" -> number or text with a unit. without: blocks removed
    with their wires; inputs cut that way read zero. trust_blocks: run the code that comes with it: the
    block files of ``block_folders`` here, its FMUs when it runs. folder: of the files that a
    document in memory names.
    Raises RotorsimError with every mistake found; warnings are in ``diagram.warnings``.
    """
    diagram = resolve(source, set=set, without=without, trust_blocks=trust_blocks, folder=folder)
    try:
        block_traces(diagram)
    except RotorsimError as error:
        raise_errors([*diagram.warnings, *error.problems])
    opaque = ((name, port) for name, node in diagram.nodes.items() if node.block.opaque for port in node.outputs)
    evaluation_order(diagram, opaque)  # loops through these are solved by some masters of a co-simulation
    return diagram


def load_standalone(diagram: Diagram) -> tuple[Diagram, Standalone]:
    """Return a diagram whose document can be changed as it stands: without sub-diagrams, removed blocks, settings.

    Itself where there are none. Raises RotorsimError where what is left does not load, as a wire is missing.
    """
    alone = standalone(diagram)
    if not alone.changed:
        return diagram, alone
    try:
        found = load(alone.document, folder=diagram.folder, trust_blocks=diagram.trusted)
    except RotorsimError as error:
        if not diagram.removed:
            raise
        hint = f"left out was {', '.join(sorted(diagram.removed))}: put a constant in the place of what feeds it"
        raise RotorsimError(*(replace(problem, hint=hint) for problem in error.problems)) from None
    return replace(found, name=diagram.name, file=diagram.file, warnings=diagram.warnings), alone
