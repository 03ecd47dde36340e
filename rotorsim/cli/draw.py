"""``rotorsim draw``."""

from __future__ import annotations

import click

from rotorsim.cli import common

__all__ = ["command"]


@click.command("draw")
@common.diagram_options
@click.option("-o", "--out", metavar="FILE.svg", help="Write the drawing here (default: print it).")
@common.json_option
def command(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    out: str | None,
    as_json: bool,
) -> None:
    """Draw a diagram as SVG."""
    common.check_target("--out", out, (".svg",))
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    from rotorsim.diagram.draw import draw_svg

    text = draw_svg(loaded)
    if out:
        common.write_text(out, text)
        common.note(f"wrote {out}")
    if as_json:
        common.echo_json({"file": out, "svg": text})
    elif not out:
        click.echo(text)
