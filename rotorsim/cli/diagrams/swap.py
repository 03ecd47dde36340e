"""``rotorsim swap``."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from rotorsim.cli.shared import (
    diagram_argument,
    document_of,
    echo_json,
    file_option,
    json_option,
    known_names,
    note,
    parse_settings,
    refuse_if,
    trust_option,
)
from rotorsim.errors import Problem, RotorsimError, near_miss

DESIGNED = "state_feedback"
DESIGN_WEIGHTS = {"current_weight": float, "noise_weight": float, "integral": bool, "states": int}


@click.command("swap")
@diagram_argument
@click.argument("block", metavar="BLOCK")
@click.argument("new_type", metavar="TYPE")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter of the new block, or weight of the design; repeatable.",
)
@file_option("-o", "--out", suffixes=(".json",), help="Write the new diagram here (default: to stdout).")
@click.option("--in-place", is_flag=True, help="Write the new diagram over the old one.")
@trust_option
@json_option
def command(
    diagram: str,
    block: str,
    new_type: str,
    settings: tuple[str, ...],
    out: str | None,
    in_place: bool,
    trust_blocks: bool,
    as_json: bool,
) -> None:
    """Replace a block by another type with the same ports; its wires and parameters of equal name stay.

    For type fmu, --set file=FILE names the FMU, from where you stand; it is written relative to the new diagram.
    A state_feedback controller is designed for the diagram (LQG, from the linearised plant) unless its matrices are
    given; --set then takes current_weight, noise_weight, integral and states.

    \b
    rotorsim swap jeffcott controller state_feedback -o mine.json
    rotorsim swap mine.json controller pd --in-place --set KP=12200
    """
    from rotorsim.diagram.diff import diff
    from rotorsim.diagram.edit import swap
    from rotorsim.diagram.parse.fmt import format_document
    from rotorsim.diagram.resolve.registry import Registry
    from rotorsim.diagram.resolve.resolution import shipped_diagrams
    from rotorsim.files import write_atomically
    from rotorsim.model.load import load

    refuse_if(out and in_place, "--out and --in-place exclude each other", hint="give one of them")
    path, old = document_of(diagram)
    refuse_if(
        in_place and path in shipped_diagrams().values(),
        f"{diagram} comes with rotorsim and stays as it is",
        hint="use -o FILE",
    )
    given = {name.removeprefix(f"{block}."): value for name, value in parse_settings(settings).items()}
    load(diagram, trust_blocks=trust_blocks)  # mistakes of the diagram itself, with their places
    folders = old.get("block_folders", []) if trust_blocks else []
    registry = Registry([path.parent / folder for folder in folders])
    designed = new_type == DESIGNED and not {"A", "B", "C", "D"} & set(given)
    name = str(path) if in_place else out
    target = Path(name) if name else None
    kept = _parts({name: entry for name, entry in old["blocks"].items() if name != block}, old)
    folder = target.parent if target else path.parent if kept else Path()
    if new_type == "fmu":
        new = _with_fmu(old, block, given, folder)
    else:
        parameters = _designed(diagram, block, given, trust_blocks) if designed else given
        entries = {name: value for name, value in parameters.items() if "[" in name}
        new = swap(old, block, new_type, {k: v for k, v in parameters.items() if k not in entries}, registry)
        if entries:
            set_there = {f"{block}.{name}": value for name, value in entries.items()}
            new = dict(load(new, set=set_there, trust_blocks=trust_blocks, folder=folder).document)
    if kept and target is not None and target.resolve().parent != path.resolve().parent:
        what = f"--out {target}: the diagram names {kept[0]}, which is not there"
        raise RotorsimError(Problem(what=what, hint=f"write it to the folder {path.parent}"))
    load(new, trust_blocks=trust_blocks, folder=folder)  # a swap that does not check is not written

    if target is not None:
        write_atomically(target.resolve(), format_document(new))
    elif not as_json:
        click.echo(format_document(new), nl=False)
    if as_json:
        rows = [asdict(change) for change in diff(old, new)]
        echo_json({"file": name, "designed": designed, "changes": rows, "diagram": new})
    words = (
        f"{block}: {old['blocks'][block]['type']} -> {new_type}",
        "designed from the linearised plant" if designed else "",
        f"written: {name}" if name else "",
        f"its file is relative to {folder.resolve()}" if new_type == "fmu" and not name else "",
    )
    note("; ".join(filter(None, words)))


def _with_fmu(old: dict[str, Any], block: str, given: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the document with an FMU in the place of a block; loading it says whether its ports fit the wires.

    folder: of the new diagram, to which its file is relative; the one given is relative to the current folder.
    """
    from rotorsim.fmi.block import block_class

    refuse_if(block not in old["blocks"], f"no block '{block}'", block, hint=near_miss(block, old["blocks"]))
    is_text = isinstance(given.get("file"), str)
    refuse_if(not is_text, "an FMU needs its file", block, hint="add --set file=controller.fmu")
    file, hint = str(given["file"]), f"it is taken from where you stand, {Path.cwd()}"
    refuse_if(os.path.isdir(file), f"--set file={file}: is a folder", hint=hint)
    refuse_if(not os.path.isfile(file), f"--set file={file}: there is no such file", hint=hint)
    declared = block_class(file, given)
    known = declared.parameters.keys() | declared.options.keys()
    before = old["blocks"][block].get("parameters", {})
    rest = {name: value for name, value in before.items() if name in known} | given
    rest.pop("file")
    entry = {"type": "fmu", "file": _from(folder, file), **({"parameters": rest} if rest else {})}
    return {**old, "blocks": {**old["blocks"], block: entry}}


def _from(folder: Path, file: str) -> str:
    """Return the path of a file as seen from a folder, with slashes; absolute where there is none (another drive)."""
    inside = Path(os.path.abspath(file))
    if inside.is_relative_to(os.path.abspath(folder)):
        return inside.relative_to(os.path.abspath(folder)).as_posix()
    try:  # ".." leads up from where links point to
        return Path(os.path.relpath(os.path.realpath(file), os.path.realpath(folder))).as_posix()
    except ValueError:
        return inside.as_posix()


def _designed(diagram: str, block: str, given: dict[str, Any], trust_blocks: bool) -> dict[str, Any]:
    """Design the controller from the linearised rest of the diagram; return its matrices as lists."""
    from rotorsim.linear.control.design import design_state_feedback
    from rotorsim.model.load import load

    known_names(given, DESIGN_WEIGHTS, lambda name: f"the design has no weight '{name}'", block)
    try:
        chosen = {name: DESIGN_WEIGHTS[name](value) for name, value in given.items()}
    except (TypeError, ValueError):
        what = "the weights of the design are numbers"
        raise RotorsimError(Problem(what=what, subject=block, hint="for example --set current_weight=2")) from None
    matrices = design_state_feedback(load(diagram, trust_blocks=trust_blocks), block, **chosen)
    return {
        name: [[float(f"{v:.12g}") + 0.0 for v in row] for row in matrix.tolist()] for name, matrix in matrices.items()
    }


def _parts(blocks: dict[str, Any], document: dict[str, Any]) -> list[str]:
    """Return what blocks and block folders of a diagram name relative to its own folder."""
    files = [entry["file"] for entry in blocks.values() if isinstance(entry.get("file"), str)]
    return files + list(document.get("block_folders", []))
