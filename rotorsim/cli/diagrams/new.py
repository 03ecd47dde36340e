"""``rotorsim new``."""

from __future__ import annotations

from pathlib import Path

import click

from rotorsim.cli.shared import echo_json, json_option, note, refuse_all
from rotorsim.errors import Place, Problem, near_miss

SCHEMA = "diagram.schema.json"


@click.command("new")
@click.argument("name", metavar="NAME")
@click.option("--from", "source", metavar="DIAGRAM", default="jeffcott", help="Which one to copy [jeffcott].")
@json_option
def command(name: str, source: str, as_json: bool) -> None:
    """Copy a diagram that comes with rotorsim to NAME.json, to be edited.

    Beside it goes the schema by which editors complete names and check values, unless it is there.

    \b
    rotorsim new mine
    rotorsim new models/beam --from fe_flexible
    """
    from rotorsim.diagram.parse.fmt import format_document
    from rotorsim.diagram.parse.source import read_document
    from rotorsim.diagram.resolve.resolution import shipped_diagrams
    from rotorsim.files import write_atomically

    shipped = shipped_diagrams()
    problems = []
    if source not in shipped:
        problems.append(Problem(f"--from {source}: no diagram of this name", hint=near_miss(source, shipped)))
    path = Path(name if name.endswith(".json") else f"{name}.json")
    if path.exists():
        hint = "choose another name, or delete the file"
        problems.append(Problem("is there already", place=Place(str(path)), hint=hint))
    refuse_all(problems)
    document = {**read_document(shipped[source]).data, "name": path.stem}
    write_atomically(path, format_document(document))
    schema = path.with_name(SCHEMA)
    if not schema.exists():
        write_atomically(schema, shipped[source].with_name(SCHEMA).read_bytes())
    if as_json:
        echo_json({"file": str(path), "from": source})
    note(f"written: {path}")
