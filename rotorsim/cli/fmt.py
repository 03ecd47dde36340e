"""``rotorsim fmt``."""

from __future__ import annotations

from pathlib import Path

import click

from rotorsim.cli import common

__all__ = ["command"]


@click.command("fmt")
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option("--check", is_flag=True, help="Write nothing; exit code 1 if a file is not in canonical form.")
@common.json_option
def command(files: tuple[str, ...], check: bool, as_json: bool) -> None:
    """Write diagrams in canonical form, so that differences are small; meaning and order stay."""
    from rotorsim.diagram.fmt import format_document

    changed = []
    texts = {}
    for name in files:
        data, path = common.read_data(name)
        text = format_document(data)
        if path.read_text(encoding="utf-8-sig") != text:
            changed.append(str(path))
            texts[path] = text
    if not check:
        for path, text in texts.items():
            common.write_text(Path(path), text)
    if as_json:
        common.echo_json({"changed": changed, "written": not check})
    else:
        for name in changed:
            click.echo(f"{'not canonical' if check else 'formatted'}: {name}")
    if check and changed:
        raise click.exceptions.Exit(1)
