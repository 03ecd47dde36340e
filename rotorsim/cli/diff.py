"""``rotorsim diff``."""

from __future__ import annotations

from dataclasses import asdict

import click

from rotorsim.cli import common

__all__ = ["command"]


@click.command("diff")
@click.argument("old", metavar="OLD")
@click.argument("new", metavar="NEW")
@click.option("--layout", is_flag=True, help="Compare layout and descriptions too.")
@common.json_option
def command(old: str, new: str, layout: bool, as_json: bool) -> int:
    """Say what differs between two diagrams by meaning; exit code 1 if anything does.

    '24 um' and 2.4e-5 are equal; the order of blocks and wires has no meaning.
    """
    from rotorsim.diagram.diff import diff

    changes = diff(common.document_of(old)[1], common.document_of(new)[1], layout=layout)
    if as_json:
        common.echo_json({"equal": not changes, "changes": [asdict(change) for change in changes]})
    else:
        for change in changes:
            click.echo(str(change))
    return 1 if changes else 0
