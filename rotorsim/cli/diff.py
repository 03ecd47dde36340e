"""``rotorsim diff``."""

from __future__ import annotations

import click

from rotorsim.cli import common

__all__ = ["command"]


@click.command("diff")
@click.argument("old", metavar="OLD")
@click.argument("new", metavar="NEW")
@click.option("--layout", is_flag=True, help="Compare layout and descriptions too.")
@common.json_option
def command(old: str, new: str, layout: bool, as_json: bool) -> None:
    """Say what differs between two diagrams by meaning; exit code 1 if anything does.

    '24 um' and 2.4e-5 are equal; the order of blocks and wires has no meaning.
    """
    from rotorsim.diagram.diff import diff

    changes = diff(common.read_data(old)[0], common.read_data(new)[0], layout=layout)
    if as_json:
        rows = [{"kind": c.kind, "where": c.where, "old": c.old, "new": c.new} for c in changes]
        common.echo_json({"changes": rows})
    else:
        for change in changes:
            click.echo(str(change))
    if changes:
        raise click.exceptions.Exit(1)
