"""``rotorsim fmt``."""

from __future__ import annotations

from pathlib import Path

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

__all__ = ["command"]


@click.command("fmt")
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option("--check", is_flag=True, help="Write nothing; exit code 1 if a file is not in canonical form.")
@common.json_option
def command(files: tuple[str, ...], check: bool, as_json: bool) -> int:
    """Write diagrams in canonical form, in place: one block and one wire a line, so that differences are small.

    Values and the order of blocks and wires stay as they are.
    """
    from rotorsim.diagram.parse.fmt import format_document
    from rotorsim.diagram.parse.source import read_document
    from rotorsim.files import write_atomically

    texts: dict[str, str] = {}
    problems: list[Problem] = []
    for name in files:
        try:
            source = read_document(name)
            if isinstance(source.data, dict):
                texts[name] = format_document(source.data)
            else:
                problems.append(Problem("a diagram is a JSON object {...}", place=source.locate()))
        except RotorsimError as error:
            problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    changed = [name for name, text in texts.items() if Path(name).read_bytes() != text.encode()]
    if not check:
        for name in changed:
            write_atomically(Path(name).resolve(), texts[name])
    if as_json:
        common.echo_json({"changed": changed, "written": not check, "files": len(files)})
    else:
        for name in changed:
            click.echo(name)
        verb = "would change" if check else "changed"
        common.note(f"{len(changed)} of {len(files)} file{'s' if len(files) > 1 else ''} {verb}")
    return 1 if check and changed else 0
