"""``rotorsim spectrum``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    RECORDING,
    RESULTS,
    Chosen,
    amplitude_option,
    clock_of,
    given_options,
    is_recording,
    json_option,
    known_names,
    note,
    plot_option,
    refuse_all,
    refuse_if,
    save_plot,
    show,
    show_problems,
    warn,
    window_of,
)
from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.report.text.table import rpm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorsim.recordings.recording import Recording, Run
    from rotorsim.signals.shaft_angle import ShaftAngle
    from rotorsim.simulation.result import Result

LARGEST_MOTION = 1e100  # beyond what a machine can do; a CSV of another program has no status
SPECTRUM_METHODS = ("least-squares", "fft", "regression")  # those of rotorsim.signals.two_axis
Window = tuple[float, float]


@dataclass(frozen=True)
class Wanted:
    """What is asked of the signals."""

    signals: tuple[str, ...]
    window: Window | None
    method: str | None
    threshold: float
    plot: str | None
    as_json: bool


@click.command("spectrum")
@click.argument("diagram", metavar="RECORDING|RESULT|DIAGRAM")
@given_options
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
    type=click.Choice(SPECTRUM_METHODS),
    help="Print harmonics of the shaft angle by this method (default for a recording: least-squares).",
)
@click.option(
    "--threshold",
    type=click.FloatRange(0.0, 1.0),
    default=1e-3,
    show_default=True,
    help="Smallest line shown, as a share of the largest.",
)
@plot_option("the full spectrum of the first signal")
@amplitude_option
@json_option
def command(
    chosen: Chosen,
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
    least-squares: with 90 % intervals and the asynchronous lines; any window, drifting speed.
    fft: lines of the FFT over whole turns; regression: the thesis' least squares, both of its nine orders.
    --json gives the whole spectrum and all harmonics.

    \b
    rotorsim spectrum jeffcott --window "4 s:5 s" --plot spectrum.png
    rotorsim spectrum jeffcott --window "4 s:5 s" --harmonics fft
    """
    wanted = Wanted(signals, window_of(window) if window else None, method, threshold, plot, as_json)
    if is_recording(chosen.name, RESULTS):
        chosen.refuse_changes("a recording")
        _show_recording(chosen.name, runs, wanted)
        return
    refuse_if(runs, "--run needs a recording", chosen.name)
    _show_result(chosen, wanted)


def _draw(result: Result, name: str, window: Window | None, plot: str | None) -> None:
    def draw() -> Figure:
        from rotorsim.report.figures.run import spectrum_figure

        return spectrum_figure(result, name, window=window)

    save_plot(draw, plot)


def _need_angle(angle: object, wanted: Wanted, hint: str) -> None:
    """Refuse what nobody can say of a shaft whose angle is not known."""
    if angle is None and (wanted.method or wanted.plot):
        option = "--harmonics" if wanted.method else "--plot"
        raise RotorsimError(Problem(f"{option} needs the shaft angle", hint=hint))


def _of_signal(
    result: Result, name: str, wanted: Wanted, angle: str | None, span: Window | None, even: bool = True, **known: Any
) -> tuple[dict[str, Any], str]:
    """Return spectrum and harmonics of a signal, as data and as text; even: its samples are equally spaced.

    known: of the shaft: its frequency [Hz] (running), or how harmonics are fitted about a measured angle.
    """
    from rotorsim.report.text import spectrum as text
    from rotorsim.signals.spectrum import full_spectrum, harmonics

    data: dict[str, Any] = {"unit": result.unit(name)}
    running, said = known.pop("running", None), ""
    if even:
        spectrum = full_spectrum(result, name, window=span, angle=angle)
        data |= text.spectrum_data(spectrum)
        said = text.spectrum_text(spectrum, running, wanted.threshold)
    if angle and wanted.method:
        from rotorsim.signals.two_axis import two_axis_harmonics

        fit = two_axis_harmonics(result, name, wanted.method, angle=angle, **{"window": span, **known})
        data["harmonics"], said = text.two_axis_data(fit), text.harmonics_text(fit, wanted.threshold)
    elif angle and wanted.as_json:
        data["harmonics"] = text.harmonics_data(harmonics(result, name, angle=angle, window=span))
    return data, said


# -- of a saved result, or of a diagram that is run --------------------------------------------------------------------


def _show_result(chosen: Chosen, wanted: Wanted) -> None:
    result, angle = _saved(chosen) if Path(chosen.name).suffix.lower() in RESULTS else _simulated(chosen, wanted)
    import numpy as np

    from rotorsim.report.text.run import two_axis_signals
    from rotorsim.signals.spectrum import few_samples, last_turns

    names = list(wanted.signals) or two_axis_signals(result)
    refuse_if(
        not names,
        "no two-axis signal was recorded",
        chosen.name,
        hint="record a signal [x, y], such as rotor.displacement",
    )
    refuse_if(len(result.time) < 8, f"only {len(result.time)} samples", chosen.name, exit_code=1)
    _need_angle(angle, wanted, "record clock.theta")
    span, running = _inside(result, wanted.window, angle) if wanted.window else None, None
    if angle is not None:
        from rotorsim.signals.shaft_angle import refuse_run_up

        span = span or last_turns(result, angle)
        part = slice(*np.searchsorted(result.time, span))
        refuse_run_up(chosen.name, Place(), result.time[part], result[angle][part])
        running = _running(result, angle, span)
        count = few_samples(result, angle)
        if count is not None:
            what = f"{count:.3g} samples a turn: orders beyond {count / 2:.3g} appear as lower ones"
            warn(what, chosen.name, "record more often: --set solver.record_every=..., or a smaller step")
    refuse_if(wanted.plot and running is None, "--plot needs a shaft that turns", chosen.name)
    _draw(result, names[0], span, wanted.plot)
    every = {name: _of_signal(result, name, wanted, angle, span, running=running) for name in names}
    signals = {name: data for name, (data, _) in every.items()}
    data = {"window": span, "running_hz": running, "signals": signals}
    show(wanted.as_json, lambda: data, lambda: "\n\n".join(text for _, text in every.values()))


def _saved(chosen: Chosen) -> tuple[Result, str | None]:
    """Return a saved result and the name of the shaft angle in it."""
    import numpy as np

    from rotorsim.simulation.files import load_result

    chosen.refuse_changes("a saved result")
    try:
        result = load_result(chosen.name)
    except RotorsimError as error:
        folder = Path(chosen.name).parent
        if not (folder / RECORDING).exists():
            raise
        hint = f"it is in a recording: give the folder {folder}, and the run by --run"
        raise RotorsimError(*(replace(problem, hint=hint) for problem in error.problems)) from None
    bad = result.status in ("unstable", "diverged")
    refuse_if(
        bad or any((np.abs(values) > LARGEST_MOTION).any() for values in result.signals.values()),
        result.message if bad else "this run diverged: its values are beyond 1e100",
        place=Place(chosen.name),
        hint="what was computed until then has no spectrum; 'rotorsim modes' shows which modes grow",
        exit_code=1,
    )
    angles = [name for name in result.signals if name.endswith(".theta")]
    return result, "clock.theta" if "clock.theta" in angles else angles[0] if len(angles) == 1 else None


def _simulated(chosen: Chosen, wanted: Wanted) -> tuple[Result, str | None]:
    """Return the result of a diagram and the name of the shaft angle in it."""
    loaded = chosen.open()
    from rotorsim.simulation.run import simulate

    clock = clock_of(loaded)
    angle = f"{clock}.theta" if clock else None
    recorded = list(map(str, loaded.record))
    more = [name for name in wanted.signals if name.partition("[")[0] not in recorded]
    result = simulate(loaded, record=tuple(dict.fromkeys([*recorded, *more, *([angle] if angle else [])])))
    refuse_if(result.status != "finished", result.message, loaded.name, exit_code=1)
    if result.message:
        warn(result.message, loaded.name, "a smaller step: --set solver.step=...")
    return result, angle


def _running(result: Result, angle: str, span: Window) -> float | None:
    """Return the running frequency [Hz] in the window, if the shaft turns."""
    import numpy as np

    turns = float(np.diff(np.interp(span, result.time, result[angle]))[0]) / (2 * np.pi)
    return turns / (span[1] - span[0]) if turns > 0 and span[1] > span[0] else None


def _inside(result: Result, span: Window, angle: str | None) -> Window:
    """Return the window cut to whole turns (what it lacks of them leaks); refuse one that the run does not cover."""
    from rotorsim.signals.two_axis import whole_turns

    first, last = float(result.time[0]), float(result.time[-1])
    step = (last - first) / (len(result.time) - 1)
    refuse_if(
        span[0] < first - step or span[1] > last + 1.5 * step,
        f"--window {span[0]:g} s:{span[1]:g} s: the run covers {first:g} to {last:g} s",
        hint="a window inside it, or a longer run: --set solver.stop=...",
    )
    cut = span if angle is None else whole_turns(result, span, angle)
    if abs(cut[0] - span[0]) <= 1.5 * step and abs(cut[1] - span[1]) <= 1.5 * step:
        return span
    note(f"window cut to whole turns: {cut[0]:g} to {cut[1]:g} s")
    return cut


# -- of the runs of a recording ----------------------------------------------------------------------------------------


def _show_recording(source: str, wanted_runs: Sequence[str], wanted: Wanted) -> None:
    """Print the spectra of the runs of a recording; draw that of one."""
    from rotorsim.recordings.loading import load_recording

    recording = load_recording(source)
    show_problems(recording.warnings)
    every = {run.id: run for run in recording.runs}
    ids = known_names(wanted_runs, every, lambda name: f"--run {name}: no such run in {recording.name}") or list(every)
    if wanted.plot and len(ids) > 1:
        hint = f"--run {ids[0]}, for example"
        raise RotorsimError(Problem(f"--plot draws one run, {source} has {len(ids)}", hint=hint))
    data: dict[str, Any] = {}
    texts: list[str] = []
    problems: list[Problem] = []
    code = 0
    for name in ids:
        try:
            data[name], text = _of_run(recording, every[name], wanted)
            texts.append(text)
        except RotorsimError as error:
            problems += [replace(problem, subject=_subject(problem.subject, name)) for problem in error.problems]
            code = max(code, error.exit_code)
    if not (wanted.as_json and problems):
        show(wanted.as_json, lambda: {"recording": recording.name, "runs": data}, lambda: "\n\n".join(texts))
    refuse_all(problems, exit_code=code)


def _subject(subject: str, run: str) -> str:
    """Return what a problem is about, the run first."""
    head, _, rest = subject.partition(": ")
    about = rest if head in (run, f"run {run}") else subject
    return f"{run}: {about}" if about else run


def _of_run(recording: Recording, run: Run, wanted: Wanted) -> tuple[dict[str, Any], str]:
    """Return what is printed of one run, as data and as text."""
    import numpy as np

    from rotorsim.measure.as_result import as_result, has_angle
    from rotorsim.recordings.recording import ANGLE
    from rotorsim.signals.shaft_angle import refuse_run_up, shaft_angle
    from rotorsim.signals.two_axis import two_axis_names, whole_turns

    angle = shaft_angle(recording, run) if has_angle(recording, run) else None
    _need_angle(angle, wanted, 'a "tacho", a channel of clock.theta, or a "speed" other than zero')
    result = as_result(recording, run, angle)
    known = two_axis_names(result)
    refuse_if(
        not known,
        "no two-axis signal was measured",
        hint="spectra of both whirls need channels of axis x and of axis y",
    )
    names = known_names(wanted.signals, known, lambda name: f"{name}: not a two-axis signal that was measured") or known
    steps = np.diff(result.time)
    even = bool(np.ptp(steps) <= 1e-6 * abs(steps[0]))
    span = wanted.window
    if angle is not None:
        part = slice(None) if span is None else slice(*np.searchsorted(result.time, span))
        time, theta = run.time[part], angle.theta[part]
        refuse_run_up(run.id, run.place, time, theta)
        if len(time) > 1:
            angle = replace(angle, speed=float((theta[-1] - theta[0]) / (time[-1] - time[0])))
        span = whole_turns(result, span)
    if not even:
        note(f"{run.id}: the samples are not equally spaced: harmonics, but no full spectrum")
        refuse_if(angle is None, "neither a shaft angle nor evenly spaced samples", names[0])
    data: dict[str, Any] = {"speed": angle.speed if angle else run.speed, "samples": len(run.time)}
    data |= {"angle": angle.source if angle else None, "phase_known": bool(angle and angle.phase_known), "signals": {}}
    texts = [_head(run, angle, result, wanted.window)]
    fitted = replace(wanted, method=wanted.method or SPECTRUM_METHODS[0])
    for name in names:
        about: dict[str, Any] = {"window": wanted.window, "use_mean": _use_mean(recording, name)}
        about |= {"angle_std": angle.std} if angle else {}
        entry, text = _of_signal(result, name, fitted, ANGLE if angle else None, span, even, **about)
        data["signals"][name] = entry | ({"window": span} if even else {})
        texts.append(text)
    _draw(result, names[0], span, wanted.plot)
    return data, "\n\n".join(texts)


def _use_mean(recording: Recording, name: str) -> bool:
    """Return whether the mean of both axes of a signal means something."""
    from rotorsim.simulation.result import flat_name

    axes = [flat_name(name, (k,)) for k in (0, 1)]
    return all(c.coupling == "dc" for c in recording.channels.values() if c.name in axes)


def _head(run: Run, angle: ShaftAngle | None, result: Result, window: Window | None) -> str:
    first, last = window or (float(result.time[0]), float(result.time[-1]))
    text = f"{run.id}: {first:g}..{last:g} s"
    if angle is None:
        return f"{text}, no shaft angle"
    source = {"channel": "measured angle", "tacho": "tacho", "speed": "stated speed"}[angle.source]
    known = "" if angle.phase_known else "; phases count from the start of the run"
    return f"{text}, {rpm(angle.speed):.6g} rpm by the {source}{known}"
