"""``rotorsim spectrum``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.simulate.result import Result

__all__ = ["command"]


@click.command("spectrum")
@click.argument("source", metavar="RESULT|DIAGRAM")
@common.set_option
@common.without_option
@click.option("--signal", metavar="SIGNAL", help="Two-axis signal (default: the first recorded one).")
@click.option("--window", metavar="START:STOP", help="Part of the run, as '4 s:5 s' (default: last turns).")
@click.option("--plot", metavar="FILE", help="Draw the full spectrum: .png, .svg or .pdf.")
@common.json_option
def command(
    source: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    signal: str | None,
    window: str | None,
    plot: str | None,
    as_json: bool,
) -> None:
    """Full spectrum of a two-axis signal of a saved result (.csv, .h5, .npz) or of a diagram that is run.

    \b
    rotorsim spectrum jeffcott --window "4 s:5 s" --plot spectrum.png
    """
    common.check_target("--plot", plot, (".png", ".svg", ".pdf"))
    span = _span(window)
    result = _result(source, settings, without)
    from rotorsim.simulate.spectrum import DEFAULT_ORDERS, full_spectrum, harmonics, last_turns
    from rotorsim.simulate.summary import two_axes

    known = two_axes(result)
    if not known:
        hint = "record a signal [x, y], such as rotor.displacement"
        raise RotorsimError(Problem(what="no two-axis signal was recorded", subject=source, hint=hint))
    name = signal or known[0]
    span = span or last_turns(result)
    if plot:
        from rotorsim.report.figures import save_figure, spectrum_figure

        save_figure(spectrum_figure(result, name, window=span), plot)
        common.note(f"wrote {plot}")
    table = harmonics(result, name, DEFAULT_ORDERS, window=span)
    if as_json:
        found = full_spectrum(result, name, window=span)
        common.echo_json(
            {
                "signal": name,
                "unit": found.unit,
                "window": span,
                "frequency_hz": found.frequency,
                "amplitude": found.amplitude,
                "harmonics": {str(k): v for k, v in zip(table.orders, table.values, strict=True)},
            }
        )
    else:
        click.echo(table.table())
        click.echo(f"rms left over: {100 * table.residual:.3g} % of the signal")


def _span(window: str | None) -> tuple[float, float] | None:
    if window is None:
        return None
    parts = [common.quantity(part.strip(), "s", "--window") for part in window.split(":")]
    if len(parts) != 2 or parts[1] <= parts[0]:
        raise RotorsimError(Problem(what=f"--window {window}: not START:STOP", hint="for example --window '4 s:5 s'"))
    return parts[0], parts[1]


def _result(source: str, settings: tuple[str, ...], without: tuple[str, ...]) -> Result:
    if Path(source).suffix in (".csv", ".h5", ".npz"):
        from rotorsim.simulate.files import load_result

        if settings or without:
            raise RotorsimError(Problem(what="--set and --without need a diagram, not a saved result", subject=source))
        return load_result(source)
    loaded = common.open_diagram(source, settings, without, False)
    from rotorsim.simulate.run import simulate

    return simulate(loaded)
