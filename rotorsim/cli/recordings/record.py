"""``rotorsim record``."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    Chosen,
    band_of,
    check_folder,
    clock_of,
    diagram_options,
    gains_of,
    hertz,
    json_option,
    noise_kind_option,
    note,
    parse_settings,
    progress_bar,
    progress_option,
    quantity,
    refuse_all,
    refuse_if,
    show,
    speeds_of,
    warn,
    window_of,
)
from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.report.text.table import counted, rpm, table

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.measure.record import Noise
    from rotorsim.model.compiled import Model
    from rotorsim.recordings.writing import NewRun
    from rotorsim.simulation.result import Result

MOST_RECORDED_RUNS = 10_000
SAMPLES_PER_TURN = 4.0  # samples a turn
KEPT_SHARE = 0.2  # of the run that is kept, at its end
LEAST_PER_PERIOD = 0.45  # of the sample rate: the highest frequency that is told
SWEEP = "5 Hz:2000 Hz"
START_SHARE = 0.1  # of a run, before a test signal is injected


@dataclass(frozen=True)
class Plan:
    """How each run is measured: part that is kept [s], settled from the start, sample rate [Hz], noise."""

    window: tuple[float, float] | None
    settle: bool
    rate: float | None
    noise: Noise | None


@click.command("record")
@diagram_options
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
@noise_kind_option(
    "noise_kind",
    "white: additive; thesis: eq. (2.67) with normal R; uniform: with R from 0 to 1.",
    default="white",
    show_default=True,
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of the noise.")
@click.option(
    "--inject",
    "ports",
    multiple=True,
    metavar="PORT",
    help="Add a sine sweep to what arrives here (or leaves), one axis a run, for 'rotorsim margins'; repeatable.",
)
@click.option("--sweep", metavar="FROM:TO", help=f"Frequencies of --inject (default: {SWEEP}).")
@click.option("--amplitude", metavar="SIZE", help="Of --inject, 0-peak, as '1 um'.")
@click.option(
    "--format", "form", type=click.Choice(("npz", "csv")), default="npz", show_default=True, help="Of the data files."
)
@click.option("--overwrite", is_flag=True, help="Replace a recording that is in the folder.")
@progress_option
@json_option
def command(
    chosen: Chosen,
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
    ports: tuple[str, ...],
    sweep: str | None,
    amplitude: str | None,
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
    rotorsim record jeffcott --inject controller.displacement --amplitude "1 um" --out swept
    """
    check_folder("--out", out)
    refuse_if(
        (Path(out) / "recording.json").exists() and not overwrite,
        "there is a recording already",
        place=Place(out),
        hint="choose another folder, or --overwrite",
    )
    span = window_of(window) if window else None
    refuse_if(span and span[0] < 0, f"--window {window}: begins before the run", hint="runs begin at t = 0")
    samples, level = hertz(rate, "--rate", "sample rate", "5000 Hz") if rate else None, _level(noise) if noise else 0.0
    at, held = _speeds(speeds, hold_out)
    known = [gains_of(text) for text in gains] or [{}]
    _limit(len(at) * len(known))
    diagrams = _diagrams(chosen, known)
    injected: dict[str, tuple[str, str, str]] = {}
    axes: list[tuple[str, dict[str, Any]]] = [("", {})]
    refuse_if(
        not ports and (amplitude or sweep),
        "--sweep and --amplitude need --inject",
        hint="for example --inject controller.displacement",
    )
    if ports:
        refuse_if(signals or settle or hold_out, "--inject records its loops alone: no --signal, --settle, --hold-out")
        span = span or (START_SHARE * diagrams[0].solver.stop, diagrams[0].solver.stop)
        diagrams, injected, axes = _with_sweeps(diagrams, chosen, ports, sweep or SWEEP, amplitude, span, samples)
        _limit(len(at) * len(known) * len(axes))
    measured = list(injected) or list(signals) or _two_axis(diagrams[0])
    from rotorsim.measure.record import Noise
    from rotorsim.model.compiled import model_for_runs
    from rotorsim.recordings.writing import NewRun, save_recording

    plan = Plan(span, settle, samples, Noise(level, noise_kind, seed) if level else None)
    cases = list(itertools.product(zip(map(model_for_runs, diagrams), known, strict=True), at, axes))
    width = max(len(str(len(cases))), 2)
    runs: list[NewRun] = []
    with progress_bar(diagrams[0].name, progress) as bar:
        for k, ((model, settings), speed, (_, parameters)) in enumerate(cases):

            def forward(fraction: float, k: int = k) -> None:
                if bar:
                    bar((k + fraction) / len(cases))

            run = NewRun(
                f"run{k + 1:0{width}}", *_measured(model, measured, speed, plan, k, forward, parameters), settings
            )
            runs.append(replace(run, use="hold_out" if speed in held else "identify"))
    for run in runs:
        _warn(run)
    source = _source(chosen, plan)
    path = save_recording(
        out,
        runs,
        name=diagrams[0].name,
        source=source,
        signals=measured,
        suffix=f".{form}",
        overwrite=overwrite,
        injected=injected,
    )
    note(f"written: {path} and {counted(len(runs), 'data file')}")
    data = [
        {"id": run.id, "speed": run.speed, "samples": len(run.result.time), "use": run.use, "set": dict(run.settings)}
        for run in runs
    ]
    rows = [
        (
            run.id,
            "-" if run.speed is None else f"{rpm(run.speed):.6g}",
            str(len(run.result.time)),
            run.use,
            ", ".join(f"{name} = {value}" for name, value in run.settings.items()) or "-",
        )
        for run in runs
    ]
    header = ("run", "speed [rpm]", "samples", "use", "set")
    show(as_json, lambda: {"folder": out, "signals": measured, "runs": data}, lambda: table(header, rows))


def _measured(
    model: Model,
    signals: Sequence[str],
    speed: float | None,
    plan: Plan,
    number: int,
    progress: Callable[[float], None],
    parameters: Mapping[str, Any],
) -> tuple[Result, float | None]:
    """Return the result of one run, and its nominal speed [rad/s]."""
    from rotorsim.linear.linearisation import speed_of
    from rotorsim.linear.modes.eigenmodes import require_speed
    from rotorsim.measure.record import measure, noisy

    diagram = model.diagram
    clock, stop = clock_of(diagram), diagram.solver.stop
    rising = clock is not None and diagram.nodes[clock].block.option.profile != "constant"
    if rising and (speed is not None or plan.settle):
        option = "--settle" if plan.settle else "--speeds"
        hint = f"{option} needs a diagram with the clock profile 'constant'"
        raise RotorsimError(Problem(f"{option}: the speed of this diagram changes", diagram.name, hint=hint))
    if speed is not None:
        require_speed(model, "--speeds")
    result = measure(
        model,
        signals,
        f"{clock}.theta" if clock else None,
        window=plan.window or (0.0 if rising else (1 - KEPT_SHARE) * stop, stop),
        rate=plan.rate,
        speed=speed,
        parameters=parameters,
        settle=plan.settle,
        progress=progress,
    )
    nominal = speed if speed is not None or rising else speed_of(model, model.p0)
    return noisy(result, plan.noise, number) if plan.noise else result, nominal


def _diagrams(chosen: Chosen, known: Sequence[Mapping[str, Any]]) -> list[Diagram]:
    """Return the diagram with each set of gains."""
    from rotorsim.model.load import load

    given, loaded = parse_settings(chosen.settings), chosen.open()
    parameters = {*loaded.parameters, *(f"{n}.{key}" for n, node in loaded.nodes.items() for key in node.values)}
    problems = []
    for name in dict.fromkeys(name for gains in known for name in gains):
        if name == "speed":
            problems.append(Problem("--gains speed: the speeds are given by --speeds"))
        elif name.partition("[")[0] not in parameters:
            hint = near_miss(name, parameters, list_all=False) or "'rotorsim blocks TYPE' lists the parameters"
            problems.append(Problem(f"--gains {name}: no such parameter in {loaded.name}", hint=hint))
        elif name in given:
            problems.append(Problem(f"--gains {name}: is given by --set as well", hint="give it once"))
    refuse_all(problems)
    diagrams = []
    for gains in known:
        try:
            both, trust = {**given, **gains}, chosen.trust_blocks
            diagrams.append(
                load(chosen.name, set=both, without=chosen.without, trust_blocks=trust) if gains else loaded
            )
        except RotorsimError as error:
            problems += [replace(p, place=Place("--gains")) if p.place.file == "--set" else p for p in error.problems]
    refuse_all(problems)
    return diagrams


def _with_sweeps(
    diagrams: Sequence[Diagram],
    chosen: Chosen,
    ports: Sequence[str],
    sweep: str,
    amplitude: str | None,
    window: tuple[float, float],
    rate: float | None,
) -> tuple[list[Diagram], dict[str, tuple[str, str, str]], list[tuple[str, dict[str, Any]]]]:
    """Return diagrams with sweeps in them, what their signals are of the loops, and the parameters of each axis."""
    from rotorsim.linear.loop import injections
    from rotorsim.measure.injection import Sweep, with_sweeps
    from rotorsim.model.load import load

    units = {one.port: one.unit for one in injections(diagrams[0], ports) if one.rate_of is None}
    refuse_if(amplitude is None, "--inject needs --amplitude", hint="for example --amplitude '1 um'")
    first, last = band_of(sweep, "--sweep")
    from rotorsim.measure.record import steps_of
    from rotorsim.model.compiled import model_for_runs

    step, every = steps_of(model_for_runs(diagrams[0]), rate)
    highest = LEAST_PER_PERIOD / (step * every)
    hint = f"--sweep '{first:g} Hz:{highest:.4g} Hz', or a higher --rate"
    refuse_if(last > highest, f"--sweep {sweep}: samples of {1 / (step * every):g} Hz do not show it", hint=hint)
    size = {port: quantity(amplitude or "", unit, "--amplitude") for port, unit in units.items()}
    refuse_if(min(size.values()) <= 0, f"--amplitude {amplitude}: not above zero")
    plan = Sweep(first, last, size)
    made = [with_sweeps(diagram, ports, plan, window) for diagram in diagrams]
    folder = Path(diagrams[0].file).parent if diagrams[0].file else None
    trust, cut = chosen.trust_blocks, chosen.without
    opened = [load(one.document, without=cut, trust_blocks=trust, folder=folder) for one in made]
    return opened, made[0].signals, made[0].cases(plan)


def _limit(runs: int) -> None:
    refuse_if(runs > MOST_RECORDED_RUNS, f"{runs} runs, at most {MOST_RECORDED_RUNS}", hint="fewer speeds")


def _speeds(speeds: str | None, hold_out: str | None) -> tuple[list[float | None], set[float]]:
    """Return the speeds of the runs [rad/s] (None: the diagram's own), and those held out."""
    at: list[float] = speeds_of(speeds).tolist() if speeds else []
    _limit(len(at))
    refuse_if(
        any(after - before < 1e-9 for before, after in itertools.pairwise(sorted(at))),
        f"--speeds {speeds}: the same speed twice",
        hint="runs at one speed need different --gains",
    )
    if hold_out is None:
        return list(at) or [None], set()
    refuse_if(
        not speeds, "--hold-out needs --speeds", hint="for example --speeds '1200 rpm, 1320 rpm' --hold-out '1260 rpm'"
    )
    held: set[float] = set()
    for speed in speeds_of(hold_out, "--hold-out").tolist():
        same = [other for other in at if abs(other - speed) < 1e-9]
        at += [] if same else [speed]
        held.add(same[0] if same else speed)
    refuse_if(len(held) == len(at), "--hold-out leaves no run to identify from", hint="more --speeds")
    return list(at), held


def _two_axis(diagram: Diagram) -> list[str]:
    """Return the two-axis signals that a diagram records; of those with nodes, the nodes that can move."""
    from rotorsim.model.compiled import model_for_runs

    model = model_for_runs(diagram)
    shapes = {str(name): model.shape_of(str(name)) for name in diagram.record}
    nodes = {name: [f"{name}[{k + 1}]" for k in range(shape[0])] for name, shape in shapes.items() if len(shape) == 2}
    signals = [
        signal
        for name, shape in shapes.items()
        if shape[1:] == (2,) or shape == (2,)
        for signal in ([node for node in nodes[name] if _moves(model, node)] if name in nodes else [name])
    ]
    hint = "--signal rotor.displacement, for example"
    refuse_if(not signals, "the diagram records no two-axis signal", diagram.name, hint=hint)
    return signals


def _moves(model: Model, name: str) -> bool:
    """Return whether a signal is anything but zero at all times."""
    if name.partition(".")[0] in model.hidden:
        return True
    expression = model.expression(name)
    return not (expression.is_constant() and expression.is_zero())


def _level(text: str) -> float:
    level = quantity(text, "1", "--noise")
    hint = "for example --noise '5 %'"
    refuse_if(level > 1, f"--noise {text}: is {100 * level:g} %", hint=hint)
    refuse_if(not level >= 0, f"--noise {text}: not a share of the rms", hint=hint)
    return level


def _source(chosen: Chosen, plan: Plan) -> str:
    """Return what the recording says about where it is from."""
    from rotorsim import __version__

    parts = (
        f"simulated by rotorsim {__version__}" + (", settled" if plan.settle else ""),
        f"set {', '.join(chosen.settings)}" if chosen.settings else "",
        f"without {', '.join(chosen.without)}" if chosen.without else "",
        f"{plan.noise.kind} noise of {100 * plan.noise.level:g} %, seed {plan.noise.seed}" if plan.noise else "",
    )
    return "; ".join(filter(None, parts))


def _warn(run: NewRun) -> None:
    """Say where samples are too far apart for the second harmonic, and where the step was too large."""
    if run.result.message:
        warn(run.result.message, run.id, "a smaller step: --set solver.step=...")
    time = run.result.time
    turns = abs(run.speed or 0.0) * float(time[-1] - time[0]) / (2 * math.pi) if len(time) > 1 else 0.0
    if turns and (len(time) - 1) / turns < SAMPLES_PER_TURN:
        what = f"{(len(time) - 1) / turns:.3g} samples a turn: harmonics are mistaken for each other"
        warn(what, run.id, "a higher --rate")
