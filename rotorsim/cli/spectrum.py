"""``rotorsim spectrum``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.simulate.result import Result
    from rotorsim.simulate.spectrum import FullSpectrum

__all__ = ["command"]

RESULTS = (".csv", ".h5", ".npz")


@click.command("spectrum")
@click.argument("source", metavar="RESULT|DIAGRAM")
@common.set_option
@common.without_option
@common.trust_option
@click.option("--signal", "signals", multiple=True, metavar="SIGNAL", help="Two-axis signal (default: all).")
@click.option("--window", metavar="START:STOP", help="Part of the run, as '4 s:5 s' (default: the last whole turns).")
@click.option("--threshold", type=click.FloatRange(0.0, 1.0), default=1e-3, show_default=True,
              help="Smallest line shown, as a share of the largest.")  # fmt: skip
@click.option("--plot", metavar="FILE", help="Draw the full spectrum of the first signal: .png, .svg or .pdf.")
@common.json_option
def command(
    source: str, settings: tuple[str, ...], without: tuple[str, ...], trust_blocks: bool, signals: tuple[str, ...],
    window: str | None, threshold: float, plot: str | None, as_json: bool,
) -> None:  # fmt: skip
    """Full spectrum of two-axis signals of a saved result (.csv, .h5, .npz) or of a diagram that is run.

    Positive frequencies turn forward, negative ones backward; phases count from shaft angle zero.
    --json gives the whole spectrum and the harmonics fitted to the shaft angle.

    \b
    rotorsim spectrum jeffcott --window "4 s:5 s" --plot spectrum.png
    """
    common.check_target("--plot", plot, common.FIGURES)
    span = _span(window)
    result, angle = _result(source, settings, without, trust_blocks, signals)
    from rotorsim.cli.summary import two_axis
    from rotorsim.simulate.spectrum import full_spectrum, harmonics, last_turns

    names = list(signals) or two_axis(result)
    if not names:
        hint = "record a signal [x, y], such as rotor.displacement"
        raise RotorsimError(Problem(what="no two-axis signal was recorded", subject=source, hint=hint))
    if len(result.time) < 8:
        raise RotorsimError(Problem(what=f"only {len(result.time)} samples", subject=source), exit_code=1)
    span = span or (last_turns(result, angle) if angle else None)
    found = [full_spectrum(result, name, window=span, angle=angle) for name in names]
    running = _running(result, angle, span)
    if plot:
        if running is None:
            raise RotorsimError(Problem(what="--plot needs the shaft angle", hint="record clock.theta"))
        from rotorsim.report.figures import save_figure, spectrum_figure

        save_figure(spectrum_figure(result, names[0], window=span), plot)
        common.note(f"written: {plot}")
    if as_json:
        data: dict[str, Any] = {}
        for item in found:
            data[item.signal] = {
                "unit": item.unit,
                "frequency_hz": item.frequency,
                "real": item.amplitude.real,
                "imag": item.amplitude.imag,
            }
            if angle:
                fit = harmonics(result, item.signal, angle=angle, window=span)
                data[item.signal]["harmonics"] = {
                    "orders": fit.orders, "real": fit.values.real, "imag": fit.values.imag, "residual": fit.residual
                }  # fmt: skip
        common.echo_json({"window": span, "running_hz": running, "signals": data})
    else:
        click.echo("\n\n".join(_lines(item, running, threshold) for item in found))


def _lines(found: FullSpectrum, running: float | None, threshold: float) -> str:
    """Return the lines of a spectrum: what exceeds both neighbours and the threshold."""
    import numpy as np

    size = np.abs(found.amplitude)
    padded = np.concatenate(([0.0], size, [0.0]))
    peaks = np.flatnonzero((size > padded[:-2]) & (size >= padded[2:]) & (size >= threshold * size.max()))
    unit, scale = common.display_unit(found.unit)
    rows = [
        (f"{found.frequency[k]:.4f}", f"{found.frequency[k] / running:.4g}" if running else "-",
         f"{size[k] * scale:.6g}", f"{common.degrees(found.amplitude[k]):.2f}")
        for k in peaks
    ]  # fmt: skip
    header = ("frequency [Hz]", "order", f"amplitude [{unit}, 0-peak]", "phase [deg]")
    return found.signal + "\n" + common.table(header, rows)


def _running(result: Result, angle: str | None, span: tuple[float, float] | None) -> float | None:
    """Return the running frequency [Hz] in the window, if the shaft angle is known."""
    if angle is None:
        return None
    import numpy as np

    start, stop = span or (result.time[0], result.time[-1])
    theta = np.interp((start, stop), result.time, result[angle])
    turns = float(theta[1] - theta[0]) / (2 * np.pi)
    return turns / (stop - start) if turns > 0 and stop > start else None


def _span(window: str | None) -> tuple[float, float] | None:
    if window is None:
        return None
    parts = [common.quantity(part.strip(), "s", "--window") for part in window.split(":")]
    if len(parts) != 2 or parts[1] <= parts[0]:
        raise RotorsimError(Problem(what=f"--window {window}: not START:STOP", hint="for example --window '4 s:5 s'"))
    return parts[0], parts[1]


def _result(
    source: str, settings: tuple[str, ...], without: tuple[str, ...], trust_blocks: bool, signals: tuple[str, ...]
) -> tuple[Result, str | None]:
    """Return the saved or the computed result and the name of the shaft angle in it."""
    if Path(source).suffix.lower() in RESULTS:
        from rotorsim.simulate.files import load_result

        if settings or without:
            raise RotorsimError(Problem(what="--set and --without need a diagram, not a saved result", subject=source))
        result = load_result(source)
        angles = [name for name in result.signals if name.endswith(".theta")]
        return result, "clock.theta" if "clock.theta" in angles else angles[0] if len(angles) == 1 else None
    loaded = common.open_diagram(source, settings, without, trust_blocks)
    from rotorsim.simulate.run import simulate

    clock = common.clock_of(loaded)
    angle = f"{clock}.theta" if clock else None
    bases = list(map(str, loaded.record))
    wanted = [*bases, *(name for name in signals if name.partition("[")[0] not in bases), *([angle] if angle else [])]
    result = simulate(loaded, record=tuple(dict.fromkeys(wanted)))
    if result.status != "finished":
        raise RotorsimError(Problem(what=result.message, subject=loaded.name), exit_code=1)
    return result, angle
