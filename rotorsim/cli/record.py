"""``rotorsim record``."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common
from rotorsim.cli.spectrum import window_of
from rotorsim.errors import Place, Problem, RotorsimError, near_miss

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.measure.record import Noise
    from rotorsim.model.compiled import Model
    from rotorsim.recordings.writing import NewRun

__all__ = ["command", "parse_gains"]

MOST_RUNS = 10_000
LEAST = 4.0  # samples a turn
SHARE = 0.2  # of the run that is kept, at its end
_NEXT = re.compile(r",(?=\s*[A-Za-z_][\w/.]*\s*=)")  # a comma before NAME=, not one inside a list


@click.command("record")
@common.diagram_options
@click.option(
    "--out", required=True, metavar="FOLDER", help="Folder of the recording: recording.json and a file a run."
)
@click.option("--speeds", metavar="SPEEDS", help="start:step:stop, a list, or one (default: the diagram's speed).")
@click.option(
    "--gains",
    "gains",
    multiple=True,
    metavar="NAME=VALUE,...",
    help="Values that are known and stay with the runs, as 'controller.KP=9000, controller.KD=4.5'; one "
    "run a speed for each --gains.",
)
@click.option("--hold-out", metavar="SPEEDS", help="Speeds whose runs are not fitted, only predicted.")
@click.option(
    "--signal",
    "signals",
    multiple=True,
    metavar="SIGNAL",
    help="What is measured (default: the diagram's recorded two-axis signals); repeatable.",
)
@click.option("--window", metavar="START:STOP", help="Part that is kept, as '4 s:5 s' (default: the last fifth).")
@click.option("--settle", is_flag=True, help="Begin in the settled motion: no transient.")
@click.option("--rate", metavar="RATE", help="Samples, as '5000 Hz' (default: as the diagram records).")
@click.option("--noise", metavar="LEVEL", help="Noise on every channel, as '5 %' of its rms about its mean.")
@click.option(
    "--noise-kind",
    type=click.Choice(common.NOISE_KINDS),
    default="white",
    show_default=True,
    help="white: additive; thesis: eq. (2.67) with normal R; uniform: with R from 0 to 1.",
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of the noise.")
@click.option(
    "--format", "form", type=click.Choice(("npz", "csv")), default="npz", show_default=True, help="Of the data files."
)
@click.option("--overwrite", is_flag=True, help="Replace a recording that is in the folder.")
@common.progress_option
@common.json_option
def command(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    out: str,
    speeds: str | None,
    gains: tuple[str, ...],
    hold_out: str | None,
    signals: tuple[str, ...],
    window: str | None,
    settle: bool,
    rate: str | None,
    noise: str | None,
    noise_kind: str,
    seed: int,
    form: str,
    overwrite: bool,
    progress: bool | None,
    as_json: bool,
) -> None:
    """Measure a diagram instead of a machine: simulate runs and save them as a recording.

    A recording is a folder that 'rotorsim identify', 'spectrum' and 'check' read. --gains are written into it, since
    they are known; what --set changes is not, and is for 'identify' to find. Tacho pulses mark shaft angle zero.

    \b
    rotorsim record jeffcott --speeds "1140 rpm:60 rpm:1620 rpm" --settle --noise "1 %" --out measured
    """
    _check_folder(out, overwrite)
    span = window_of(window) if window else None
    if span and span[0] < 0:
        raise RotorsimError(Problem(f"--window {window}: begins before the run", hint="runs begin at t = 0"))
    hertz = _hertz(rate) if rate else None
    level = _level(noise) if noise else 0.0
    chosen, held = _speeds(speeds, hold_out)
    known = [parse_gains(text) for text in gains] or [{}]
    _limit(len(chosen) * len(known))
    diagrams = _diagrams(diagram, settings, without, trust_blocks, known)
    measured = list(signals) or _two_axis(diagrams[0])
    from rotorsim.measure.record import Noise

    disturbance = Noise(level, noise_kind, seed) if level else None
    runs = _simulate(diagrams, known, chosen, held, measured, span, settle, hertz, disturbance, progress)
    source = _source(settings, without, settle, disturbance)
    from rotorsim.recordings.writing import save_recording

    _warn(runs)
    path = save_recording(
        out, runs, name=diagrams[0].name, source=source, signals=measured, suffix=f".{form}", overwrite=overwrite
    )
    common.note(f"written: {path} and {len(runs)} data file{'s' if len(runs) > 1 else ''}")
    _show(runs, out, measured, as_json)


def _simulate(
    diagrams: Sequence[Diagram],
    known: Sequence[dict[str, Any]],
    speeds: Sequence[float | None],
    held: set[float],
    signals: Sequence[str],
    span: tuple[float, float] | None,
    settle: bool,
    rate: float | None,
    noise: Noise | None,
    progress: bool | None,
) -> list[NewRun]:
    """Return one run per set of gains and speed, in this order."""
    from rotorsim.linear.eigenmodes import require_speed
    from rotorsim.linear.linearisation import speed_of
    from rotorsim.measure.record import measure, noisy
    from rotorsim.model.compiled import compile_diagram
    from rotorsim.recordings.writing import NewRun

    clock = common.clock_of(diagrams[0])
    rising = clock is not None and diagrams[0].nodes[clock].block.option.profile != "constant"
    if rising and (speeds != [None] or settle):
        option = "--settle" if settle else "--speeds"
        hint = f"{option} needs a diagram with the clock profile 'constant'"
        raise RotorsimError(Problem(f"{option}: the speed of this diagram changes", diagrams[0].name, hint=hint))
    stop = diagrams[0].solver.stop
    window = span or (0.0 if rising else (1 - SHARE) * stop, stop)
    total = len(diagrams) * len(speeds)
    width = max(len(str(total)), 2)
    runs: list[NewRun] = []
    with common.progress_bar(diagrams[0].name, progress) as show:
        for loaded, gains in zip(diagrams, known, strict=True):
            model = compile_diagram(loaded)
            if speeds != [None]:
                require_speed(model, "--speeds")
            for speed in speeds:
                done = len(runs)

                def forward(fraction: float, done: int = done) -> None:
                    if show:
                        show((done + fraction) / total)

                result = measure(
                    model,
                    signals,
                    f"{clock}.theta" if clock else None,
                    window=window,
                    rate=rate,
                    speed=speed,
                    settle=settle,
                    progress=forward,
                )
                if noise:
                    result = noisy(result, noise, done)
                nominal = speed if speed is not None or rising else speed_of(model, model.p0)
                use = "hold_out" if speed in held else "identify"
                runs.append(NewRun(f"run{done + 1:0{width}}", result, nominal, gains, use))
    return runs


def _diagrams(
    diagram: str, settings: Sequence[str], without: Sequence[str], trust_blocks: bool, known: Sequence[dict[str, Any]]
) -> list[Diagram]:
    """Return the diagram with each set of gains."""
    from rotorsim.cli.app import show_problems
    from rotorsim.model.load import load

    given = common.parse_settings(settings)
    loaded = load(diagram, set=given, without=without, trust_blocks=trust_blocks)
    show_problems(loaded.warnings)
    parameters = {*loaded.parameters, *(f"{n}.{key}" for n, node in loaded.nodes.items() for key in node.values)}
    problems = []
    for name in dict.fromkeys(name for gains in known for name in gains):
        if name == "speed":
            problems.append(Problem("--gains speed: the speeds are given by --speeds"))
        elif name not in parameters:
            hint = near_miss(name, parameters, list_all=False) or "'rotorsim blocks TYPE' lists the parameters"
            problems.append(Problem(f"--gains {name}: no such parameter in {loaded.name}", hint=hint))
        elif name in given:
            problems.append(Problem(f"--gains {name}: is given by --set as well", hint="give it once"))
    if problems:
        raise RotorsimError(*problems)
    found = []
    for gains in known:
        try:
            both = {**given, **gains}
            found.append(load(diagram, set=both, without=without, trust_blocks=trust_blocks) if gains else loaded)
        except RotorsimError as error:
            problems += [replace(p, place=Place("--gains")) if p.place.file == "--set" else p for p in error.problems]
    if problems:
        raise RotorsimError(*problems)
    return found


def parse_gains(text: str) -> dict[str, Any]:
    """Return ``"controller.KP=9000, controller.KD=4.5"`` as a mapping; values as in `common.parse_settings`."""
    values: dict[str, Any] = {}
    hint = "for example --gains 'controller.KP=9000, controller.KD=4.5'"
    for part in _NEXT.split(text):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not name or not value:
            raise RotorsimError(Problem(f"--gains {text}: '{part.strip()}' is not NAME=VALUE", hint=hint))
        if name in values:
            raise RotorsimError(Problem(f"--gains {text}: {name} is there twice", hint="a --gains for each value"))
        try:
            values[name] = json.loads(value, parse_constant=lambda constant: constant)
        except (ValueError, RecursionError):
            values[name] = value
    return values


def _limit(runs: int) -> None:
    if runs > MOST_RUNS:
        raise RotorsimError(Problem(f"{runs} runs, at most {MOST_RUNS}", hint="fewer speeds"))


def _speeds(speeds: str | None, hold_out: str | None) -> tuple[list[float | None], set[float]]:
    """Return the speeds of the runs [rad/s] (None: the diagram's own), and those held out."""
    chosen = [float(speed) for speed in common.speeds_of(speeds)] if speeds else []
    _limit(len(chosen))
    if any(after - before < 1e-9 for before, after in itertools.pairwise(sorted(chosen))):
        hint = "runs at one speed need different --gains"
        raise RotorsimError(Problem(f"--speeds {speeds}: the same speed twice", hint=hint))
    if hold_out is None:
        return list(chosen) or [None], set()
    if not speeds:
        hint = "for example --speeds '1200 rpm, 1320 rpm' --hold-out '1260 rpm'"
        raise RotorsimError(Problem("--hold-out needs --speeds", hint=hint))
    held: set[float] = set()
    for speed in map(float, common.speeds_of(hold_out, "--hold-out")):
        same = [other for other in chosen if abs(other - speed) < 1e-9]
        if not same:
            chosen.append(speed)
        held.add(same[0] if same else speed)
    if len(held) == len(chosen):
        raise RotorsimError(Problem("--hold-out leaves no run to identify from", hint="more --speeds"))
    return list(chosen), held


def _two_axis(diagram: Diagram) -> list[str]:
    """Return the two-axis signals that a diagram records; of those with nodes, the nodes that can move."""
    from rotorsim.model.compiled import compile_diagram

    model = compile_diagram(diagram)
    found: list[str] = []
    for name in map(str, diagram.record):
        shape = model.shape_of(name)
        if len(shape) == 2 and shape[1] == 2:
            found += [f"{name}[{k + 1}]" for k in range(shape[0]) if _moves(model, f"{name}[{k + 1}]")]
        elif shape == (2,):
            found.append(name)
    if not found:
        hint = "--signal rotor.displacement, for example"
        raise RotorsimError(Problem("the diagram records no two-axis signal", diagram.name, hint=hint))
    return found


def _moves(model: Model, name: str) -> bool:
    """Return whether a signal is anything but zero at all times."""
    expression = model.expression(name)
    return not (expression.is_constant() and expression.is_zero())


def _check_folder(out: str, overwrite: bool) -> None:
    common.check_folder("--out", out)
    if (Path(out) / "recording.json").exists() and not overwrite:
        hint = "choose another folder, or --overwrite"
        raise RotorsimError(Problem("there is a recording already", place=Place(out), hint=hint))


def _hertz(text: str) -> float:
    """Return a sample rate [Hz]: samples are counted in a second, never in a turn."""
    from rotorsim.units import UnitError, split_quantity

    try:
        rate, unit = split_quantity(text)
        known = unit in ("", "Hz", "kHz", "MHz")
    except UnitError:
        rate, known = 0.0, False
    rate *= {"kHz": 1e3, "MHz": 1e6}.get(unit, 1.0) if known else 1.0
    if not known or not 1e-6 <= rate <= 1e12:
        raise RotorsimError(Problem(f"--rate {text}: not a sample rate", hint="for example --rate '5000 Hz'"))
    return rate


def _level(text: str) -> float:
    level = common.quantity(text, "1", "--noise")
    if level > 1:
        raise RotorsimError(Problem(f"--noise {text}: is {100 * level:g} %", hint="for example --noise '5 %'"))
    if not 0 <= level <= 10:
        raise RotorsimError(Problem(f"--noise {text}: not a share of the rms", hint="for example --noise '5 %'"))
    return level


def _source(settings: Sequence[str], without: Sequence[str], settle: bool, noise: Noise | None) -> str:
    """Return what the recording says about where it is from."""
    from rotorsim import __version__

    parts = [f"simulated by rotorsim {__version__}" + (", settled" if settle else "")]
    if settings:
        parts.append("set " + ", ".join(settings))
    if without:
        parts.append("without " + ", ".join(without))
    if noise:
        parts.append(f"{noise.kind} noise of {100 * noise.level:g} %, seed {noise.seed}")
    return "; ".join(parts)


def _warn(runs: Sequence[NewRun]) -> None:
    """Say where samples are too far apart for the second harmonic, and where the step was too large."""
    from rotorsim.cli.app import show_problems

    problems = []
    for run in runs:
        if run.result.message:
            hint = "a smaller step: --set solver.step=..."
            problems.append(Problem(run.result.message, run.id, hint=hint, severity="warning"))
        time = run.result.time
        turns = abs(run.speed or 0.0) * float(time[-1] - time[0]) / (2 * math.pi) if len(time) > 1 else 0.0
        if turns and (len(time) - 1) / turns < LEAST:
            what = f"{(len(time) - 1) / turns:.3g} samples a turn: harmonics are mistaken for each other"
            problems.append(Problem(what, run.id, hint="a higher --rate", severity="warning"))
    show_problems(problems)


def _show(runs: Sequence[NewRun], out: str, signals: Sequence[str], as_json: bool) -> None:
    """Print the runs."""
    rows = []
    for run in runs:
        speed = f"{common.rpm(run.speed):.6g}" if run.speed is not None else "-"
        gains = ", ".join(f"{name} = {value}" for name, value in run.settings.items()) or "-"
        rows.append((run.id, speed, str(len(run.result.time)), run.use, gains))
    if not as_json:
        click.echo(common.table(("run", "speed [rpm]", "samples", "use", "set"), rows))
        return
    data = [
        {"id": run.id, "speed": run.speed, "samples": len(run.result.time), "use": run.use, "set": dict(run.settings)}
        for run in runs
    ]
    common.echo_json({"folder": out, "signals": list(signals), "runs": data})
