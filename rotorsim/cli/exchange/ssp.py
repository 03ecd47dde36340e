"""``rotorsim ssp``: diagrams as systems of FMUs, and systems of FMUs as diagrams."""

from __future__ import annotations

import click

from rotorsim.cli.shared import (
    Chosen,
    Group,
    check_folder,
    diagram_options,
    file_option,
    fmi_option,
    json_option,
    listed,
    named_values,
    platform_option,
    show,
    show_help,
    show_problems,
)
from rotorsim.errors import Problem
from rotorsim.report.text.table import table

SOURCE = "source"


@click.group("ssp", cls=Group, invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Systems of FMUs in one file (SSP 1.0 and 2.0): export a diagram cut into FMUs, import a system as a diagram.

    Each verb prints machine-readable JSON with --json.
    """
    show_help(context)


@command.command("export")
@diagram_options
@click.option(
    "--part",
    "parts",
    multiple=True,
    metavar="NAME=BLOCK,...",
    help="Blocks that become an FMU of this name; repeatable. The other blocks are 'rest'.",
)
@fmi_option
@platform_option
@file_option("-o", "--out", suffixes=(".ssp",), required=True, metavar="FILE.ssp", help="Write the system here.")
@json_option
def export(
    chosen: Chosen, parts: tuple[str, ...], version: str, platforms: tuple[str, ...], out: str, as_json: bool
) -> None:
    """Write DIAGRAM as a system of FMUs with connections, units and values of parameters.

    Blocks of type fmu go as they are.

    \b
    rotorsim ssp export jeffcott --part controller=controller -o jeffcott.ssp
    """
    cut = _parts(parts)
    loaded = chosen.open()
    from rotorsim.ssp.from_diagram import export_ssp

    wanted = [name for name in platforms if name != SOURCE] if platforms else None
    done = export_ssp(loaded, out, cut, version=version, platforms=wanted)
    show_problems(done.warnings)
    system, made = done.structure.system, done.structure.version
    data = {
        "file": out,
        "ssp": made,
        "connections": len(system.connections),
        "components": {name: list(blocks) for name, blocks in done.blocks.items()},
    }
    lines = [
        (
            c.name,
            *(str(sum(x.kind == kind for x in c.connectors)) for kind in ("input", "output")),
            str(len(c.settings)),
            ", ".join(done.blocks[c.name]),
        )
        for c in system.components
    ]
    components = table(("component", "inputs", "outputs", "parameters", "blocks"), lines)
    show(as_json, lambda: data, lambda: f"{out}: SSP {made}, {len(system.connections)} connections\n{components}")


def _parts(parts: tuple[str, ...]) -> dict[str, list[str]]:
    """Return name -> blocks of ``NAME=BLOCK,...`` texts."""
    hint = "for example --part controller=controller,reference"
    cut = named_values(
        parts,
        lambda text: Problem(f"--part {text}: not NAME=BLOCK,...", hint=hint),
        lambda name: Problem(f"--part {name}: there are two parts of this name"),
    )
    return {name: list(listed(blocks)) for name, blocks in cut.items()}


@command.command("import")
@click.argument("file", metavar="FILE.ssp")
@click.option("-o", "--out", required=True, metavar="FOLDER", help="Make this folder: diagram.json and the FMUs.")
@json_option
def import_(file: str, out: str, as_json: bool) -> None:
    """Write a system of FMUs as a diagram: a block for each FMU, wires, values of parameters.

    Nested systems are flattened; factors and offsets of connections become blocks. What is not supported is refused
    by name.

    \b
    rotorsim ssp import system.ssp -o system
    rotorsim cosim system/diagram.json --trust-blocks --step "1 ms"
    """
    check_folder("--out", out)
    from rotorsim.ssp.to_diagram import import_ssp

    done = import_ssp(file, out)
    show_problems(done.warnings)
    nodes, wires, version = done.diagram.nodes, len(done.diagram.wires), done.structure.version
    data = {
        "diagram": str(done.file),
        "ssp": version,
        "fmus": list(done.fmus),
        "blocks": {name: node.block.type_name for name, node in nodes.items()},
        "wires": wires,
    }
    show(as_json, lambda: data, lambda: f"{done.file}: {len(nodes)} blocks, {wires} wires, from SSP {version}")
