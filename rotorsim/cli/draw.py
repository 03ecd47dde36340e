"""``rotorsim draw``."""

from __future__ import annotations

import click

from rotorsim.cli.shared import Chosen, diagram_options, file_option, json_option, note, show


@click.command("draw")
@diagram_options
@file_option("-o", "--out", suffixes=(".svg",), metavar="FILE.svg", help="Write the drawing here (default: to stdout).")
@json_option
def command(chosen: Chosen, out: str | None, as_json: bool) -> None:
    """Draw a diagram as SVG: blocks where its layout puts them, with ports and wires.

    \b
    rotorsim draw jeffcott -o jeffcott.svg
    """
    loaded = chosen.open()
    from rotorsim.diagram.draw import draw_svg
    from rotorsim.files import write_atomically

    text = draw_svg(loaded)
    if out:
        write_atomically(out, text)
        note(f"written: {out}")
    rest = None if out else text
    show(as_json, lambda: {"diagram": loaded.name, "file": out, "svg": rest}, lambda: rest or "")
