"""``rotorsim spectrum``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common, recorded
from rotorsim.cli.app import show_problems
from rotorsim.errors import Place, Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.signals.spectrum import FullSpectrum
    from rotorsim.signals.two_axis import TwoAxis
    from rotorsim.simulation.result import Result

__all__ = ["command", "spectrum_text", "window_of"]

HUGE = 1e100
RESULTS = (".csv", ".h5", ".npz")
METHODS = ("least-squares", "fft", "regression")  # those of rotorsim.signals.two_axis


@click.command("spectrum")
@click.argument("source", metavar="RECORDING|RESULT|DIAGRAM")
@common.set_option
@common.without_option
@common.trust_option
@click.option("--signal", "signals", multiple=True, metavar="SIGNAL", help="Two-axis signal (default: all).")
@click.option("--run", "runs", multiple=True, metavar="ID", help="Run of the recording (default: all); repeatable.")
@click.option(
    "--window",
    metavar="START:STOP",
    help="Part of the run, as '4 s:5 s' (default: a recording's whole run, else the last whole turns).",
)
@click.option(
    "--harmonics",
    "method",
    type=click.Choice(METHODS),
    help="Print harmonics of the shaft angle by this method (default for a recording: least-squares).",
)
@click.option(
    "--threshold",
    type=click.FloatRange(0.0, 1.0),
    default=1e-3,
    show_default=True,
    help="Smallest line shown, as a share of the largest.",
)
@click.option("--plot", metavar="FILE", help="Draw the full spectrum of the first signal: .png, .svg or .pdf.")
@common.json_option
def command(
    source: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    signals: tuple[str, ...],
    runs: tuple[str, ...],
    window: str | None,
    method: str | None,
    threshold: float,
    plot: str | None,
    as_json: bool,
) -> None:
    """Full spectrum and harmonics of two-axis signals: of a recording, a saved result, or a diagram that is run.

    RECORDING is a folder with recording.json, RESULT a file (.csv, .h5, .npz) of 'rotorsim run'. Positive
    frequencies and orders turn forward, negative ones backward; phases count from shaft angle zero.
    least-squares: with 90 % intervals and the lines that do not follow the shaft; any window, drifting speed.
    fft: lines of the FFT over whole turns; regression: the thesis' least squares, both of its nine orders.
    --json gives the whole spectrum and all harmonics.

    \b
    rotorsim spectrum jeffcott --window "4 s:5 s" --plot spectrum.png
    rotorsim spectrum jeffcott --window "4 s:5 s" --harmonics fft
    """
    common.check_target("--plot", plot, common.FIGURES)
    span = window_of(window) if window else None
    if recorded.is_recording(source):
        if settings or without:
            raise RotorsimError(Problem(what="--set and --without need a diagram, not a recording", subject=source))
        recorded.recording_spectrum(source, runs, signals, span, method, threshold, plot, as_json)
        return
    if runs:
        raise RotorsimError(Problem(what="--run needs a recording", subject=source))
    result, angle = _result(source, settings, without, trust_blocks, signals)
    import numpy as np

    from rotorsim.cli.summary import two_axis
    from rotorsim.signals.spectrum import few_samples, full_spectrum, harmonics, last_turns

    names = list(signals) or two_axis(result)
    if not names:
        hint = "record a signal [x, y], such as rotor.displacement"
        raise RotorsimError(Problem(what="no two-axis signal was recorded", subject=source, hint=hint))
    if len(result.time) < 8:
        raise RotorsimError(Problem(what=f"only {len(result.time)} samples", subject=source), exit_code=1)
    if span is not None:
        span = _inside(result, span, angle, window or "")
    span = span or (last_turns(result, angle) if angle else None)
    if angle is not None and span is not None:
        from rotorsim.signals.shaft_angle import refuse_run_up

        part = slice(*np.searchsorted(result.time, span))
        refuse_run_up(source, Place(), result.time[part], result[angle][part])
    count = few_samples(result, angle) if angle else None
    if count is not None:
        what = f"{count:.3g} samples a turn: orders beyond {count / 2:.3g} appear as lower ones"
        hint = "record more often: --set solver.record_every=..., or a smaller step"
        show_problems([Problem(what, source, hint=hint, severity="warning")])
    found = [full_spectrum(result, name, window=span, angle=angle) for name in names]
    running = _running(result, angle, span)
    fits = _fits(result, names, method, span, angle) if method else None
    if plot:
        if running is None:
            raise RotorsimError(Problem(what="--plot needs the shaft angle", hint="record clock.theta"))
        from rotorsim.report.figures.run import save_figure, spectrum_figure

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
            if fits:
                data[item.signal]["harmonics"] = recorded.harmonics_data(fits[item.signal])
            elif angle:
                fit = harmonics(result, item.signal, angle=angle, window=span)
                data[item.signal]["harmonics"] = {
                    "orders": fit.orders,
                    "real": fit.values.real,
                    "imag": fit.values.imag,
                    "residual": fit.residual,
                }
        common.echo_json({"window": span, "running_hz": running, "signals": data})
    elif fits:
        click.echo("\n\n".join(recorded.harmonics_text(item, threshold) for item in fits.values()))
    else:
        click.echo("\n\n".join(spectrum_text(item, running, threshold) for item in found))


def _fits(
    result: Result, names: list[str], method: str, span: tuple[float, float] | None, angle: str | None
) -> dict[str, TwoAxis]:
    """Return the harmonics of the signals by method."""
    from rotorsim.signals.two_axis import two_axis_harmonics

    if angle is None:
        raise RotorsimError(Problem(what="--harmonics needs the shaft angle", hint="record clock.theta"))
    return {name: two_axis_harmonics(result, name, method, window=span, angle=angle) for name in names}


def spectrum_text(found: FullSpectrum, running: float | None, threshold: float) -> str:
    """Return the lines of a spectrum: what exceeds both neighbours and the threshold."""
    import numpy as np

    size = np.abs(found.amplitude)
    padded = np.concatenate(([0.0], size, [0.0]))
    peaks = np.flatnonzero((size > padded[:-2]) & (size >= padded[2:]) & (size >= threshold * size.max()))
    unit, scale = common.display_unit(found.unit)
    rows = [
        (
            f"{found.frequency[k]:.4f}",
            f"{found.frequency[k] / running:.4g}" if running else "-",
            f"{size[k] * scale:.6g}",
            f"{common.degrees(found.amplitude[k]):.2f}",
        )
        for k in peaks
    ]
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


def _inside(result: Result, span: tuple[float, float], angle: str | None, text: str) -> tuple[float, float]:
    """Return the window cut to whole turns (what it lacks of them leaks); refuse one that the run does not cover."""
    from rotorsim.signals.two_axis import whole_turns

    first, last = float(result.time[0]), float(result.time[-1])
    step = (last - first) / (len(result.time) - 1)
    if span[0] < first - step or span[1] > last + 1.5 * step:
        hint = "a window inside it, or a longer run: --set solver.stop=..."
        raise RotorsimError(Problem(f"--window {text}: the run covers {first:g} to {last:g} s", hint=hint))
    if angle is None:
        return span
    cut = whole_turns(result, span, angle)
    if abs(cut[0] - span[0]) > 1.5 * step or abs(cut[1] - span[1]) > 1.5 * step:
        common.note(f"window cut to whole turns: {cut[0]:g} to {cut[1]:g} s")
        return cut
    return span


def window_of(window: str) -> tuple[float, float]:
    """Return the ends [s] of a text such as ``"4 s:5 s"``."""
    parts = [common.quantity(part.strip(), "s", "--window") for part in window.split(":")]
    if len(parts) != 2 or parts[1] <= parts[0]:
        raise RotorsimError(Problem(what=f"--window {window}: not START:STOP", hint="for example --window '4 s:5 s'"))
    return parts[0], parts[1]


def _is_huge(result: Result) -> bool:
    """Return whether values are beyond what a machine can do; a CSV of another program has no status."""
    import numpy as np

    return any(bool((np.abs(values) > HUGE).any()) for values in result.signals.values())


def _result(
    source: str, settings: tuple[str, ...], without: tuple[str, ...], trust_blocks: bool, signals: tuple[str, ...]
) -> tuple[Result, str | None]:
    """Return the saved or the computed result and the name of the shaft angle in it."""
    if Path(source).suffix.lower() in RESULTS:
        from rotorsim.simulation.files import load_result

        if settings or without:
            raise RotorsimError(Problem(what="--set and --without need a diagram, not a saved result", subject=source))
        result = load_result(source)
        bad = result.status in ("unstable", "diverged")
        if bad or _is_huge(result):
            hint = "what was computed until then has no spectrum; 'rotorsim modes' shows which modes grow"
            what = result.message if bad else "this run diverged: its values are beyond 1e100"
            raise RotorsimError(Problem(what, place=Place(source), hint=hint), exit_code=1)
        angles = [name for name in result.signals if name.endswith(".theta")]
        return result, "clock.theta" if "clock.theta" in angles else angles[0] if len(angles) == 1 else None
    loaded = common.open_diagram(source, settings, without, trust_blocks)
    from rotorsim.simulation.run import simulate

    clock = common.clock_of(loaded)
    angle = f"{clock}.theta" if clock else None
    bases = list(map(str, loaded.record))
    wanted = [*bases, *(name for name in signals if name.partition("[")[0] not in bases), *([angle] if angle else [])]
    result = simulate(loaded, record=tuple(dict.fromkeys(wanted)))
    if result.status != "finished":
        raise RotorsimError(Problem(what=result.message, subject=loaded.name), exit_code=1)
    if result.message:
        hint = "a smaller step: --set solver.step=..."
        show_problems([Problem(result.message, loaded.name, hint=hint, severity="warning")])
    return result, angle
