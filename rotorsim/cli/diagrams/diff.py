"""``rotorsim diff``."""

from __future__ import annotations

from dataclasses import asdict

import click

from rotorsim.cli.shared import document_of, json_option, show


@click.command("diff")
@click.argument("old", metavar="OLD")
@click.argument("new", metavar="NEW")
@click.option("--layout", is_flag=True, help="Compare layout and descriptions too.")
@json_option
def command(old: str, new: str, layout: bool, as_json: bool) -> int:
    """Say what differs between two diagrams by meaning; exit code 1 if anything does.

    '24 um' and 2.4e-5 are equal; the order of blocks and wires has no meaning.
    """
    from rotorsim.diagram.diff import diff

    changes = diff(document_of(old)[1], document_of(new)[1], layout=layout)
    rows = [asdict(change) for change in changes]
    show(as_json, lambda: {"equal": not rows, "changes": rows}, lambda: "\n".join(map(str, changes)))
    return 1 if changes else 0
