"""``rotorsim fmt``."""

from __future__ import annotations

from pathlib import Path

import click

from rotorsim.cli.shared import json_option, note, object_of, refuse_all, show
from rotorsim.errors import Problem, RotorsimError
from rotorsim.report.text.table import counted


@click.command("fmt")
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option("--check", is_flag=True, help="Write nothing; exit code 1 if a file is not in canonical form.")
@json_option
def command(files: tuple[str, ...], check: bool, as_json: bool) -> int:
    """Write diagrams in canonical form, in place: one block and one wire a line, so that differences are small.

    Values and the order of blocks and wires stay as they are.
    """
    from rotorsim.diagram.parse.fmt import format_document
    from rotorsim.files import write_atomically

    texts: dict[str, str] = {}
    problems: list[Problem] = []
    for name in files:
        try:
            texts[name] = format_document(object_of(name))
        except RotorsimError as error:
            problems += error.problems
    refuse_all(problems)
    changed = [name for name, text in texts.items() if Path(name).read_bytes() != text.encode()]
    if not check:
        for name in changed:
            write_atomically(Path(name).resolve(), texts[name])
    data = {"changed": changed, "written": not check, "files": len(files)}
    show(as_json, lambda: data, lambda: "\n".join(changed))
    if not as_json:
        note(f"{len(changed)} of {counted(len(files), 'file')} {'would change' if check else 'changed'}")
    return 1 if check and changed else 0
