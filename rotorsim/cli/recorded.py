"""What `rotorsim check` and `rotorsim spectrum` say about recordings."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError, near_miss

if TYPE_CHECKING:
    from rotorsim.recordings.recording import Recording, Run
    from rotorsim.signals.shaft_angle import ShaftAngle
    from rotorsim.signals.two_axis import TwoAxis
    from rotorsim.simulation.result import Result

__all__ = ["contents", "harmonics_data", "harmonics_text", "is_recording", "recording_spectrum"]

FILE = "recording.json"


def is_recording(source: str) -> bool:
    """Return whether a name on the command line is a recording: its folder, or its recording.json.

    A folder without that file does not stand before a shipped diagram of its name.
    """
    path = Path(source)
    try:
        if path.name == FILE or (path / FILE).exists():
            return True
        if path.is_dir():
            from rotorsim.diagram.resolve.resolution import shipped_diagrams

            return source not in shipped_diagrams()
        if path.suffix != ".json" or not path.is_file():
            return False
        data = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(data, dict) and "runs" in data and "channels" in data and "blocks" not in data


def contents(recording: Recording) -> dict[str, Any]:
    """Return what is in a recording: channels, runs, those held out, speeds [rad/s], settings that differ."""
    speeds = [run.speed for run in recording.runs if run.speed is not None]
    settings: list[Mapping[str, Any]] = []
    for run in recording.runs:
        if run.settings not in settings:
            settings.append(run.settings)
    names = list(dict.fromkeys(name for values in settings for name in values))
    return {
        "channels": len(recording.channels),
        "runs": len(recording.runs),
        "hold_out": len(recording.select("hold_out")),
        "speed_low": min(speeds, default=None),
        "speed_high": max(speeds, default=None),
        "settings": len(settings) if names else 0,
        "set": names,
    }


def contents_line(recording: Recording) -> str:
    """Return `contents` as words: ``4 channels, 9 runs (1 held out), 1140 to 1620 rpm, 2 sets of controller.KP``."""
    found = contents(recording)
    held = f" ({found['hold_out']} held out)" if found["hold_out"] else ""
    parts = [_count(found["channels"], "channel"), _count(found["runs"], "run") + held]
    if found["speed_low"] is not None:
        low, high = (f"{common.rpm(found[key]):.6g}" for key in ("speed_low", "speed_high"))
        parts.append(f"{low} rpm" if low == high else f"{low} to {high} rpm")
    if found["settings"]:
        names = found["set"]
        shown = " and ".join(names) if len(names) < 3 else f"{len(names)} parameters"
        parts.append(f"{_count(found['settings'], 'set')} of {shown}")
    return ", ".join(parts)


def _count(n: int, word: str) -> str:
    return f"{n} {word}{'' if n == 1 else 's'}"


def recording_spectrum(
    source: str,
    wanted: Sequence[str],
    signals: Sequence[str],
    window: tuple[float, float] | None,
    method: str | None,
    threshold: float,
    plot: str | None,
    as_json: bool,
) -> None:
    """Print the spectra of the runs of a recording; draw that of one."""
    from rotorsim.cli.app import show_problems
    from rotorsim.recordings.loading import load_recording

    recording = load_recording(source)
    show_problems(recording.warnings)
    runs = _chosen(recording, wanted)
    if plot and len(runs) > 1:
        hint = f"--run {runs[0].id}, for example"
        raise RotorsimError(Problem(f"--plot draws one run, {source} has {len(runs)}", hint=hint))
    data: dict[str, Any] = {}
    texts: list[str] = []
    problems: list[Problem] = []
    code = 0
    for run in runs:
        try:
            entry, text = _run_spectrum(recording, run, signals, window, method, threshold, plot)
        except RotorsimError as error:
            problems += [_of_run(problem, run) for problem in error.problems]
            code = max(code, error.exit_code)
            continue
        data[run.id] = entry
        texts.append(text)
    if as_json and not problems:
        common.echo_json({"recording": recording.name, "runs": data})
    elif texts and not as_json:
        click.echo("\n\n".join(texts))
    if problems:
        raise RotorsimError(*problems, exit_code=code)


def _of_run(problem: Problem, run: Run) -> Problem:
    from dataclasses import replace

    head, _, rest = problem.subject.partition(": ")
    if head in (f"run {run.id}", run.id):
        return replace(problem, subject=": ".join(part for part in (run.id, rest) if part))
    return replace(problem, subject=": ".join(part for part in (run.id, problem.subject) if part))


def _chosen(recording: Recording, wanted: Sequence[str]) -> list[Run]:
    ids = {run.id: run for run in recording.runs}
    unknown = [name for name in wanted if name not in ids]
    if unknown:
        raise RotorsimError(
            *(Problem(f"--run {name}: no such run in {recording.name}", hint=near_miss(name, ids)) for name in unknown)
        )
    return [ids[name] for name in dict.fromkeys(wanted)] or list(recording.runs)


def _run_spectrum(
    recording: Recording,
    run: Run,
    signals: Sequence[str],
    window: tuple[float, float] | None,
    method: str | None,
    threshold: float,
    plot: str | None,
) -> tuple[dict[str, Any], str]:
    """Return what is printed of one run, as data and as text."""
    from dataclasses import replace

    import numpy as np

    from rotorsim.measure.as_result import as_result, has_angle
    from rotorsim.recordings.recording import ANGLE
    from rotorsim.signals.shaft_angle import refuse_run_up, shaft_angle
    from rotorsim.signals.spectrum import full_spectrum
    from rotorsim.signals.two_axis import METHODS, two_axis_harmonics, two_axis_names, whole_turns

    angle = shaft_angle(recording, run) if has_angle(recording, run) else None
    if angle is None and method is not None:
        hint = 'a "tacho", a channel of clock.theta, or a "speed" other than zero'
        raise RotorsimError(Problem("--harmonics needs the shaft angle", hint=hint))
    result = as_result(recording, run, angle)
    names = _measured(result, signals, two_axis_names(result))
    even = _is_even(result)
    span = window
    if angle is not None:
        part = slice(None) if window is None else slice(*np.searchsorted(result.time, window))
        time, theta = run.time[part], angle.theta[part]
        refuse_run_up(run.id, run.place, time, theta)
        if len(time) > 1:
            angle = replace(angle, speed=float((theta[-1] - theta[0]) / (time[-1] - time[0])))
        span = whole_turns(result, window)
    data: dict[str, Any] = {"speed": angle.speed if angle else run.speed, "samples": len(run.time)}
    data |= {"angle": angle.source if angle else None, "phase_known": bool(angle and angle.phase_known), "signals": {}}
    texts = [_head(run, angle, result, window)]
    for name in names:
        entry: dict[str, Any] = {"unit": result.unit(name)}
        if even:
            found = full_spectrum(result, name, window=span, angle=ANGLE if angle else None)
            entry |= {"window": span, "frequency_hz": found.frequency}
            entry |= {"real": found.amplitude.real, "imag": found.amplitude.imag}
        if angle is not None:
            harmonics = two_axis_harmonics(
                result,
                name,
                method or METHODS[0],
                window=window,
                angle_std=angle.std,
                use_mean=_use_mean(recording, name),
            )
            entry["harmonics"] = harmonics_data(harmonics)
            texts.append(harmonics_text(harmonics, threshold))
        elif even:
            from rotorsim.cli.spectrum import spectrum_text

            texts.append(spectrum_text(found, None, threshold))
        else:
            raise RotorsimError(Problem("neither a shaft angle nor evenly spaced samples", name))
        data["signals"][name] = entry
    if not even:
        common.note(f"{run.id}: the samples are not equally spaced: harmonics, but no full spectrum")
    if plot:
        if angle is None:
            raise RotorsimError(Problem("--plot needs the shaft angle", hint='a "tacho", or a channel of clock.theta'))
        from rotorsim.report.figures.run import save_figure, spectrum_figure

        save_figure(spectrum_figure(result, names[0], window=span), plot)
        common.note(f"written: {plot}")
    return data, "\n\n".join(texts)


def _measured(result: Result, signals: Sequence[str], known: Sequence[str]) -> list[str]:
    """Return the two-axis signals to show."""
    if not known:
        hint = "spectra of both whirls need channels of axis x and of axis y"
        raise RotorsimError(Problem("no two-axis signal was measured", hint=hint))
    unknown = [name for name in signals if name not in known]
    if unknown:
        raise RotorsimError(
            *(Problem("not a two-axis signal that was measured", name, hint=near_miss(name, known)) for name in unknown)
        )
    return list(dict.fromkeys(signals)) or list(known)


def _is_even(result: Result) -> bool:
    import numpy as np

    steps = np.diff(result.time)
    return bool(np.ptp(steps) <= 1e-6 * abs(steps[0]))


def _use_mean(recording: Recording, name: str) -> bool:
    """Return whether the mean of both axes of a signal means something."""
    axes = [f"{name[:-1]},{k}]" if name.endswith("]") else f"{name}[{k}]" for k in (1, 2)]
    return all(c.coupling == "dc" for c in recording.channels.values() if c.name in axes)


def _head(run: Run, angle: ShaftAngle | None, result: Result, window: tuple[float, float] | None) -> str:
    first, last = window or (float(result.time[0]), float(result.time[-1]))
    text = f"{run.id}: {first:g}..{last:g} s"
    if angle is None:
        return text + ", no shaft angle"
    source = {"channel": "measured angle", "tacho": "tacho", "speed": "stated speed"}[angle.source]
    known = "" if angle.phase_known else "; phases count from the start of the run"
    return f"{text}, {common.rpm(angle.speed):.6g} rpm by the {source}{known}"


def harmonics_text(found: TwoAxis, threshold: float) -> str:
    """Return harmonics as text: those above the threshold and above what noise makes."""
    import numpy as np

    item = found.harmonics
    unit, scale = common.display_unit(item.unit)
    size = np.abs(item.values)
    shown = size >= threshold * size.max(initial=0.0)
    if found.significant is not None:
        shown &= found.significant
    rows = []
    for k in np.flatnonzero(shown):
        row = [f"{item.orders[k]:g}", f"{size[k] * scale:.6g}", f"{common.degrees(item.values[k]):.2f}"]
        if found.amplitude90 is not None and found.phase90 is not None:
            row.insert(2, f"{found.amplitude90[k] * scale:.2g}")
            row.append(f"{np.degrees(found.phase90[k]):.2g}")
        rows.append(row)
    header = ["order", f"amplitude [{unit}, 0-peak]", "phase [deg]"]
    if found.amplitude90 is not None:
        header = [*header[:2], "+- 90 %", header[2], "+- 90 %"]
    first, last = found.window
    method = {"fft": "FFT", "regression": "regression"}.get(found.method, "least squares")
    lines = [f"{item.signal}, {method} over {found.turns:.4g} turns, {first:.4g}..{last:.4g} s"]
    lines.append(common.table(header, rows) if rows else "nothing but noise")
    for line in found.lines:
        lines.append(
            f"not of the shaft: {line.frequency:.6g} Hz, order {line.order:.4f}, "
            f"forward {line.forward * scale:.4g} {unit}, backward {line.backward * scale:.4g} {unit}"
        )
    x, y = (f"{100 * share:.3g} %" for share in found.error)
    lines.append(f"reconstruction error: x {x}, y {y} of the rms")
    return "\n".join(lines)


def harmonics_data(found: TwoAxis) -> dict[str, Any]:
    """Return harmonics as data."""
    item = found.harmonics
    return {
        "method": found.method,
        "window": found.window,
        "turns": found.turns,
        "orders": item.orders,
        "real": item.values.real,
        "imag": item.values.imag,
        "amplitude_90": found.amplitude90,
        "phase_90": found.phase90,
        "residual": item.residual,
        "reconstruction_error": found.error,
        "lines": [
            {"frequency_hz": line.frequency, "order": line.order, "forward": line.forward, "backward": line.backward}
            for line in found.lines
        ],
    }
