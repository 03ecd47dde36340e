"""``rotorsim draw``."""

from __future__ import annotations

import click

from rotorsim.cli import common

__all__ = ["command"]


@click.command("draw")
@common.diagram_options
@click.option("-o", "--out", metavar="FILE.svg", help="Write the drawing here (default: to stdout).")
@common.json_option
def command(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    out: str | None,
    as_json: bool,
) -> None:
    """Draw a diagram as SVG: blocks where its layout puts them, with ports and wires.

    \b
    rotorsim draw jeffcott -o jeffcott.svg
    """
    common.check_target("--out", out, (".svg",))
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    from rotorsim.diagram.draw import draw_svg
    from rotorsim.files import write_atomically

    text = draw_svg(loaded)
    if out:
        write_atomically(out, text)
        common.note(f"written: {out}")
    if as_json:
        common.echo_json({"diagram": loaded.name, "file": out, "svg": None if out else text})
    elif not out:
        click.echo(text)
