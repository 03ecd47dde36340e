"""``rotorsim swap``."""

from __future__ import annotations

from typing import Any

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

__all__ = ["command"]

DESIGNED = "state_feedback"


@click.command("swap")
@click.argument("diagram", metavar="DIAGRAM")
@click.argument("block", metavar="BLOCK")
@click.argument("new_type", metavar="TYPE")
@common.set_option
@click.option("-o", "--out", metavar="FILE", help="Write the new diagram here (default: print it).")
@click.option("--in-place", is_flag=True, help="Write the new diagram over the old one.")
@common.json_option
def command(
    diagram: str, block: str, new_type: str, settings: tuple[str, ...], out: str | None, in_place: bool, as_json: bool
) -> None:
    """Replace a block by another type with the same ports; its wires and parameters of equal name stay.

    state_feedback is designed from the linearised plant; --set gives its weights (current_weight, noise_weight,
    integral, states) or, for other types, parameters of the new block.

    \b
    rotorsim swap diagrams/jeffcott.json controller state_feedback -o sf.json
    """
    from rotorsim.diagram.diff import diff
    from rotorsim.diagram.edit import swap
    from rotorsim.diagram.fmt import format_document
    from rotorsim.diagram.load import load

    if out and in_place:
        raise RotorsimError(Problem(what="--out and --in-place exclude each other", hint="give one of them"))
    data, path = common.read_data(diagram)
    target = str(path) if in_place else out
    common.check_target("--out", out, (".json",))
    given = {name.removeprefix(f"{block}."): value for name, value in common.parse_settings(settings).items()}
    parameters = given
    if new_type == DESIGNED and not {"A", "B", "C"} & set(given):
        parameters = _designed(diagram, block, given)
    new = swap(data, block, new_type, parameters)
    load(new, folder=path.parent)  # a swap that does not check is not written
    if as_json:
        changes = diff(data, new)
        rows = [{"kind": c.kind, "where": c.where, "old": c.old, "new": c.new} for c in changes]
        common.echo_json({"file": target, "changes": rows, "diagram": new})
    elif target is None:
        click.echo(format_document(new), nl=False)
    if target is not None:
        common.write_text(target, format_document(new))
        common.note(f"wrote {target}")


def _designed(diagram: str, block: str, given: dict[str, Any]) -> dict[str, Any]:
    """Design the controller from the linearised rest of the diagram; return its matrices as lists."""
    from rotorsim.diagram.load import load
    from rotorsim.errors import near_miss
    from rotorsim.simulate.design import design_state_feedback

    weights = {"current_weight": float, "noise_weight": float, "integral": bool, "states": int}
    unknown = [name for name in given if name not in weights]
    if unknown:
        raise RotorsimError(
            *[
                Problem(what=f"no weight '{name}' of the design", subject=name, hint=near_miss(name, weights))
                for name in unknown
            ]
        )
    try:
        chosen = {name: weights[name](value) for name, value in given.items()}
    except (TypeError, ValueError):
        raise RotorsimError(
            Problem(what="the weights of the design are numbers", hint="--set current_weight=2")
        ) from None
    loaded = load(diagram)
    if block not in loaded.nodes:
        raise RotorsimError(Problem(what=f"no block '{block}'", subject=block, hint=near_miss(block, loaded.nodes)))
    matrices = design_state_feedback(loaded, block, **chosen)
    return {name: [[float(f"{v:.12g}") for v in row] for row in matrix.tolist()] for name, matrix in matrices.items()}
