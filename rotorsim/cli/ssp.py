"""``rotorsim ssp``: diagrams as systems of FMUs, and systems of FMUs as diagrams."""

from __future__ import annotations

import click

from rotorsim.cli import common
from rotorsim.cli.app import show_problems
from rotorsim.errors import Problem, RotorsimError

__all__ = ["command"]


@click.group("ssp", cls=common.Group, invoke_without_command=True)
@click.pass_context
def command(ctx: click.Context) -> None:
    """Systems of FMUs in one file (SSP 1.0 and 2.0): export a diagram cut into FMUs, import a system as a diagram.

    Each verb prints machine-readable JSON with --json.
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


@command.command("export")
@common.diagram_options
@click.option(
    "--part",
    "parts",
    multiple=True,
    metavar="NAME=BLOCK,...",
    help="Blocks that become an FMU of this name; repeatable. The blocks left over are 'rest'.",
)
@click.option(
    "--fmi",
    "version",
    type=click.Choice(["2.0", "3.0"]),
    default="2.0",
    help="Version of FMI [2.0]; 3.0 makes it SSP 2.0.",
)
@click.option(
    "--platform",
    "platforms",
    multiple=True,
    metavar="NAME",
    help="As for fmu export; repeatable. Default: this machine's.",
)
@click.option("-o", "--out", required=True, metavar="FILE.ssp", help="Write the system here.")
@common.json_option
def export(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    parts: tuple[str, ...],
    version: str,
    platforms: tuple[str, ...],
    out: str,
    as_json: bool,
) -> None:
    """Write DIAGRAM as a system of FMUs with connections, units and values of parameters.

    Blocks of type fmu go as they are.

    \b
    rotorsim ssp export jeffcott --part controller=controller -o jeffcott.ssp
    """
    common.check_target("--out", out, (".ssp",))
    cut = _parts(parts)
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    from rotorsim.ssp.from_diagram import export_ssp

    wanted = [name for name in platforms if name != "source"] if platforms else None
    done = export_ssp(loaded, out, cut, version=version, platforms=wanted)
    show_problems(done.warnings)
    system = done.structure.system
    if as_json:
        common.echo_json(
            {
                "file": out,
                "ssp": done.structure.version,
                "connections": len(system.connections),
                "components": {name: list(blocks) for name, blocks in done.blocks.items()},
            }
        )
        return
    click.echo(f"{out}: SSP {done.structure.version}, {len(system.connections)} connections")
    lines = [
        [
            c.name,
            *(str(sum(x.kind == kind for x in c.connectors)) for kind in ("input", "output")),
            str(len(c.settings)),
            ", ".join(done.blocks[c.name]),
        ]
        for c in system.components
    ]
    click.echo(common.table(["component", "inputs", "outputs", "parameters", "blocks"], lines))


def _parts(parts: tuple[str, ...]) -> dict[str, list[str]]:
    """Return name -> blocks of ``NAME=BLOCK,...`` texts."""
    found: dict[str, list[str]] = {}
    problems = []
    for text in parts:
        name, equals, blocks = (word.strip() for word in text.partition("="))
        if not equals or not name or not blocks:
            hint = "for example --part controller=controller,reference"
            problems.append(Problem(f"--part {text}: not NAME=BLOCK,...", hint=hint))
        elif name in found:
            problems.append(Problem(f"--part {text}: there are two parts of this name"))
        else:
            found[name] = [word.strip() for word in blocks.split(",") if word.strip()]
    if problems:
        raise RotorsimError(*problems)
    return found


@command.command("import")
@click.argument("file", metavar="FILE.ssp")
@click.option("-o", "--out", required=True, metavar="FOLDER", help="Make this folder: diagram.json and the FMUs.")
@common.json_option
def import_(file: str, out: str, as_json: bool) -> None:
    """Write a system of FMUs as a diagram: a block for each FMU, wires, values of parameters.

    Nested systems are flattened; units of connections are converted by gain blocks. What is not supported is refused
    by name.

    \b
    rotorsim ssp import system.ssp -o system
    rotorsim cosim system/diagram.json --trust-blocks --step "1 ms"
    """
    common.check_folder("--out", out)
    from rotorsim.ssp.to_diagram import import_ssp

    done = import_ssp(file, out)
    show_problems(done.warnings)
    diagram = done.diagram
    if as_json:
        types = {name: node.block.type_name for name, node in diagram.nodes.items()}
        common.echo_json(
            {
                "diagram": str(done.file),
                "ssp": done.structure.version,
                "fmus": list(done.fmus),
                "blocks": types,
                "wires": len(diagram.wires),
            }
        )
        return
    click.echo(
        f"{done.file}: {len(diagram.nodes)} blocks, {len(diagram.wires)} wires, from SSP {done.structure.version}"
    )
