"""``rotorsim import``: models of other programs as diagrams."""  # noqa: N999 - the verb

from __future__ import annotations

from pathlib import Path

import click

from rotorsim.cli.shared import Group, file_option, json_option, problem_data, show, show_help, show_problems


@click.group("import", cls=Group, invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Models of other programs as diagrams: rotors of ROSS.

    Each verb prints machine-readable JSON with --json.
    """
    show_help(context)


@command.command("ross")
@click.argument("file", metavar="MODEL.toml")
@file_option("-o", "--out", suffixes=(".json",), required=True, metavar="FILE.json", help="Write the diagram here.")
@json_option
def ross(file: str, out: str, as_json: bool) -> None:
    """Write a rotor that ROSS has saved, rotor.save("MODEL.toml"), as a diagram (.json of ROSS is read, too).

    Lateral motion only. What is not carried over is said, or refused where the lateral motion would change.

    \b
    rotorsim import ross MODEL.toml --out rotor.json
    rotorsim modes rotor.json --set "speed=3000 rpm"
    """
    from rotorsim.diagram.parse.fmt import format_document
    from rotorsim.files import write_atomically
    from rotorsim.ross.to_diagram import import_ross

    done = import_ross(file)
    write_atomically(Path(out).resolve(), format_document(done.document))
    show_problems(done.warnings)
    nodes = {name: node.block.type_name for name, node in done.diagram.nodes.items()}
    data = {
        "diagram": out,
        "ross": done.version,
        "blocks": nodes,
        "wires": len(done.document["wires"]),
        "warnings": [problem_data(problem) for problem in done.warnings],
    }
    version = f"ROSS {done.version}" if done.version else "ROSS"
    elements = done.document["blocks"]["rotor"]["parameters"]["elements"]
    show(as_json, lambda: data, lambda: f"{out}: {elements} elements, {len(nodes)} blocks, from {version}")
