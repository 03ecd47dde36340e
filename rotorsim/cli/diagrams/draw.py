"""``rotorsim draw``."""

from __future__ import annotations

import click

from rotorsim.cli.shared import Chosen, diagram_options, file_option, json_option, note, show
from rotorsim.errors import Problem, RotorsimError


@click.command("draw")
@diagram_options
@file_option(
    "-o",
    "--out",
    suffixes=(".svg", ".png", ".pdf"),
    help="Write the drawing here: .svg (default: to stdout); of a shaft .png, .svg or .pdf.",
)
@click.option("--shaft", is_flag=True, help="Draw the rotor from the side, to scale, with what is wired to it.")
@click.option("--rotor", metavar="BLOCK", default="", help="Which rotor --shaft draws (default: the first).")
@json_option
def command(chosen: Chosen, out: str | None, shaft: bool, rotor: str, as_json: bool) -> None:
    """Draw a diagram as SVG: blocks where its layout puts them, with ports and wires. Or its shaft.

    \b
    rotorsim draw jeffcott -o jeffcott.svg
    rotorsim draw drawn_rotor --shaft -o shaft.png
    """
    if shaft and not out:
        raise RotorsimError(Problem("a shaft is drawn into a file", "--shaft", hint="add --out shaft.png"))
    if not shaft and (rotor or (out and not out.endswith(".svg"))):
        what = "--rotor is for --shaft" if rotor else f"{out}: a diagram is drawn as .svg"
        raise RotorsimError(Problem(what, "draw", hint="add --shaft, or write FILE.svg"))
    loaded = chosen.open()
    if shaft and out:
        from rotorsim.report.figures.run import save_figure
        from rotorsim.report.figures.shaft import shaft_figure

        save_figure(shaft_figure(loaded, block=rotor), out)
        note(f"written: {out}")
        show(as_json, lambda: {"diagram": loaded.name, "file": out}, lambda: "")
        return
    from rotorsim.diagram.draw import draw_svg
    from rotorsim.files import write_atomically

    text = draw_svg(loaded)
    if out:
        write_atomically(out, text)
        note(f"written: {out}")
    rest = None if out else text
    show(as_json, lambda: {"diagram": loaded.name, "file": out, "svg": rest}, lambda: rest or "")
