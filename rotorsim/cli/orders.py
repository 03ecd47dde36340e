"""``rotorsim orders``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import click
import numpy as np

from rotorsim.cli.shared import (
    Chosen,
    amplitude_option,
    check_folder,
    given_options,
    hertz,
    is_recording,
    json_option,
    known_names,
    note,
    plot_option,
    refuse_all,
    refuse_if,
    save_plot,
    share_of,
    show,
    show_problems,
    span_of,
)
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorsim.diagram.diagram import Diagram
    from rotorsim.recordings.orders import OrderRecording, OrderRun
    from rotorsim.recordings.recording import Recording
    from rotorsim.signals.orders.critical_speeds import CriticalSpeeds
    from rotorsim.signals.orders.extraction import Positions
    from rotorsim.signals.orders.filtered import Passband

FIGURE_KINDS = ("bode", "polar", "cascade", "centreline")
PHASE_WORDS = ("lead", "lag")  # those of rotorsim.recordings.orders
WIDEST = 0.5  # of an order, as a passband
CASCADE_WINDOWS = 15.0  # of a run, one after the other: a window is as long


@dataclass(frozen=True, eq=False)
class Given:
    """Order vectors of some runs, and of sampled ones the samples and mean positions."""

    orders: OrderRecording
    sampled: Recording | None
    positions: Sequence[Positions]


@click.command("orders")
@click.argument("diagram", metavar="RECORDING|DIAGRAM")
@given_options
@click.option("--run", "runs", multiple=True, metavar="ID", help="Run-up or coast-down (default: all); repeatable.")
@click.option(
    "--order", "orders", multiple=True, type=click.IntRange(1, 100), help="Order (default: 1, 2); repeatable."
)
@click.option("--turns", type=click.IntRange(1, 1000), default=1, show_default=True, help="Turns of a row.")
@click.option("--filter", "bandwidth", metavar="WIDTH", help="Vold-Kalman filter, -3 dB wide: '10 %' of 1X, or '2 Hz'.")
@click.option("--line", "lines", multiple=True, metavar="FREQUENCY", help="With --filter: a steady line to separate.")
@click.option("--slow-roll", metavar="LOW:HIGH", help="Subtract the mean vector between these speeds.")
@click.option("--operating", metavar="LOW:HIGH", help="Operating speeds, for separation margins (API 684).")
@click.option("--beside", metavar="DIAGRAM", help="Simulate this diagram along each run, and show it beside.")
@click.option("--signal", "signals", multiple=True, metavar="SIGNAL", help="What is drawn and listed; repeatable.")
@click.option("--figure", type=click.Choice(FIGURE_KINDS), default="bode", show_default=True, help="What is drawn.")
@plot_option("the figure of one run and its first order")
@click.option("--out", metavar="FOLDER", help="Write the vectors: recording.json of kind 'orders' and a CSV a run.")
@click.option("--phase", type=click.Choice(PHASE_WORDS), default="lead", show_default=True, help="In --out.")
@click.option("--overwrite", is_flag=True, help="Replace files that are in the folder of --out.")
@amplitude_option
@json_option
def command(
    chosen: Chosen,
    runs: tuple[str, ...],
    orders: tuple[int, ...],
    turns: int,
    bandwidth: str | None,
    lines: tuple[str, ...],
    slow_roll: str | None,
    operating: str | None,
    beside: str | None,
    signals: tuple[str, ...],
    figure: str,
    plot: str | None,
    out: str | None,
    phase: str,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Orders of run-ups and coast-downs over the speed, critical speeds and their separation margins.

    RECORDING has samples, whose orders are tracked turn by turn against the pulses, or is a table of order vectors as
    monitoring systems export them. DIAGRAM, whose clock changes its speed, is run, and is treated alike. Critical
    speeds and amplification factors are those of the settled response of the modes that the run has passed, corrected
    for its sweep rate, with 90 % intervals.

    \b
    rotorsim orders runup --operating "3000 rpm:3600 rpm" --plot bode.png
    rotorsim orders runup --beside jeffcott --figure polar --plot polar.png
    rotorsim orders runup --out table --amplitude peak-peak --phase lag
    rotorsim orders jeffcott_runup --order 1
    """
    check_folder("--out", out)
    span = None if operating is None else span_of(operating, "--operating")
    slow = None if slow_roll is None else span_of(slow_roll, "--slow-roll")
    wanted = tuple(dict.fromkeys(orders))
    refuse_if(lines and bandwidth is None, "--line needs --filter", hint="for example --filter '10 %'")
    refuse_if(bandwidth and turns > 1, "--turns: the filter has its own width, and rows of one turn")
    width = None if bandwidth is None else _passband(bandwidth)
    steady_lines = [hertz(line, "--line") for line in lines]
    read = _checked(_read(chosen), runs)
    given = _given(read, runs, wanted, turns) if width is None else _filtered(read, runs, wanted, width, steady_lines)
    if slow is not None:
        from rotorsim.signals.orders.slow_roll import without_slow_roll

        less = without_slow_roll(given.orders, *slow)
        show_problems(less.warnings[len(given.orders.warnings) :])
        given = replace(given, orders=less)
    tracked = given.orders
    names = _channels(tracked, signals)
    from rotorsim.signals.orders.critical_speeds import CriticalSpeeds, critical_speeds

    kinds = list(wanted) or sorted({channel.order for channel in tracked.channels.values()})
    if width is None:
        single = _single_turns(given, kinds, turns, slow)
        found = [critical_speeds(run, single.channels, order) for run in single.runs for order in kinds]
    else:
        found = [CriticalSpeeds(run.id, order, run.speed, ()) for run in tracked.runs for order in kinds]
        note("critical speeds are told without --filter: a filter makes resonances broader, and their noise smooth")
    if beside is not None and not plot:
        note("--beside is drawn: --plot FILE")
    simulated = {} if beside is None or not plot else _simulated(beside, chosen.trust_blocks, given, kinds, turns)
    from rotorsim.report.text import orders as text

    def said() -> str:
        parts = []
        for run in tracked.runs:
            own = {name: tracked.channels[name] for name in names if tracked.channels[name].order in kinds}
            lines = [text.run_text(run), text.peaks_text(run, own)]
            lines += [text.critical_text(one, own, span) for one in found if one.run == run.id and width is None]
            parts.append("\n\n".join(lines))
        return "\n\n\n".join(parts)

    words = said()
    if plot:
        refuse_if(
            len(tracked.runs) > 1,
            f"--plot draws one run, {chosen.name} has {len(tracked.runs)}",
            hint=f"--run {tracked.runs[0].id}, for example",
        )
        save_plot(lambda: _figure(figure, given, found[0], names, simulated, beside or "", span), plot)
    if out:
        steady = tracked.runs[0].noise is not None
        hint = "`rotorsim spectrum --json` has the harmonics of each run"
        refuse_if(
            width, "--out: rows of a filter are not independent, as those of a table are", hint="leave --filter out"
        )
        refuse_if(steady, "--out: a table is of a run-up or coast-down, not of runs at constant speeds", hint=hint)
        from rotorsim.recordings.order_writing import save_orders
        from rotorsim.report.amplitudes import shown_amplitudes

        folder = save_orders(out, tracked, amplitude=shown_amplitudes(), phase=phase, overwrite=overwrite)
        note(f"written: {folder}")
    show(as_json, lambda: text.orders_data(tracked, found if width is None else [], span), lambda: words)
    untold = [f"{one.run}, {one.order}X" for one in found if not (one.found or one.explained)]
    hint = "lead taken for lag, a speed that turns back, a rub, a clipped probe? the figure shows what the modes leave"
    what = "the motion is not that of linear modes, and no critical speed is told"
    refuse_if(untold, what, "; ".join(untold), hint=hint, exit_code=1)


def _read(chosen: Chosen) -> Recording | OrderRecording:
    """Return a recording, or the run of a diagram as one."""
    if is_recording(chosen.name):
        from rotorsim.recordings.orders import load_any

        chosen.refuse_changes("a recording")
        read = load_any(chosen.name)
        show_problems(read.warnings)
        return read
    from rotorsim.recordings.recording import ANGLE
    from rotorsim.recordings.writing import as_recording
    from rotorsim.simulation.run import simulate

    loaded = chosen.open()
    signals = tuple(dict.fromkeys([*map(str, loaded.record), ANGLE]))
    result = simulate(loaded, record=signals, initial=_settled_at_first(loaded))
    refuse_if(result.status != "finished", result.message, loaded.name, exit_code=1)
    return as_recording(result, loaded.name)


def _settled_at_first(loaded: Diagram) -> np.ndarray | None:
    """Return the settled motion at the speed that a ramp begins with, if it turns: from rest it would ring there."""
    from rotorsim.settled.periodic import settled_start

    ramps = [
        name
        for name, node in loaded.nodes.items()
        if node.block.category == "clock" and getattr(node.block.option, "profile", "") == "ramp"
    ]
    if len(ramps) != 1 or not float(loaded.nodes[ramps[0]].values["speed"]):
        return None
    try:
        return settled_start(loaded, parameters={f"{ramps[0]}.acceleration": 0.0})
    except RotorsimError as error:
        note(f"the run begins from rest: {error.problems[0].what}")
        return None


def _given(read: Recording | OrderRecording, runs: Sequence[str], orders: Sequence[int], turns: int) -> Given:
    """Return the order vectors of the runs that are wanted."""
    from rotorsim.recordings.orders import OrderRecording

    ids = known_names(runs, [run.id for run in read.runs], lambda name: f"--run {name}: no such run in {read.name}")
    if isinstance(read, OrderRecording):
        refuse_if(turns > 1, "--turns: the rows of this table are as they were exported", read.name)
        missing = [order for order in orders if order not in {one.order for one in read.channels.values()}]
        there = ", ".join(f"{order}X" for order in sorted({one.order for one in read.channels.values()}))
        refuse_if(missing, f"no channel of order {', '.join(map(str, missing))}", read.name, hint=f"there: {there}")
        some = tuple(run for run in read.runs if not ids or run.id in ids)
        return Given(replace(read, runs=some), None, ())
    from rotorsim.signals.orders.extraction import tracked_recording
    from rotorsim.signals.orders.steady import steady_recording
    from rotorsim.signals.turning import is_run_up

    chosen = [run for run in read.runs if run.id in ids] if ids else None
    rising = [run for run in chosen or read.runs if is_run_up(read, run)]
    if not rising and len(chosen or read.runs) > 1:
        refuse_if(turns > 1, "--turns: runs at constant speeds are a row each", read.name)
        return Given(*_with_samples(steady_recording(read, orders or (1, 2), chosen), read))
    tracked, positions = tracked_recording(read, orders or (1, 2), turns, chosen)
    show_problems(tracked.warnings)
    left = [run.id for run in read.runs if run.id not in {own.id for own in tracked.runs}]
    if left and not ids:
        note(f"at one speed, and left out: {', '.join(left)}")
    return Given(tracked, read, positions)


def _single_turns(given: Given, kinds: Sequence[int], turns: int, slow: tuple[float, float] | None) -> OrderRecording:
    """Return rows of one turn, which modes are fitted to: within longer ones a vector may change by more than they say.

    Where samples are too few for these, the rows as they are.
    """
    from rotorsim.signals.orders.extraction import tracked_recording

    if turns == 1 or given.sampled is None:
        return given.orders
    own = {run.id for run in given.orders.runs}
    try:
        single = tracked_recording(given.sampled, kinds, 1, [run for run in given.sampled.runs if run.id in own])[0]
    except RotorsimError:
        note(f"critical speeds are told from rows of {turns} turns: samples are too few for rows of one")
        return given.orders
    note("critical speeds are told from rows of one turn")
    if slow is None:
        return single
    from rotorsim.signals.orders.slow_roll import without_slow_roll

    return without_slow_roll(single, *slow)


def _checked(read: Recording | OrderRecording, wanted: Sequence[str]) -> Recording | OrderRecording:
    """Return a recording without probes that show nothing, of the runs that are wanted; refuse what is unusable."""
    from rotorsim.measure.checks import AT_FAULT, UNUSABLE, check_signals
    from rotorsim.recordings.recording import ANGLE, TACHO, Recording

    if not isinstance(read, Recording):
        return read
    runs = [run for run in read.runs if run.id in wanted] or list(read.runs)
    wrong = check_signals(replace(read, runs=tuple(runs)))
    refuse_all([one for one in wrong if one.code in UNUSABLE and one.severity == "error"], exit_code=1)
    show_problems([one for one in wrong if one.code in AT_FAULT])
    still = {one.subject for one in wrong if one.code == "constant_signal"}
    probes = [column for column, one in read.channels.items() if one.signal not in (ANGLE, TACHO)]
    dead = {column for column in probes if all(f"{run.id}: column {column}" in still for run in runs)}
    refuse_if(len(dead) == len(probes), "no channel shows a motion", read.name, exit_code=1)
    return replace(read, channels={key: one for key, one in read.channels.items() if key not in dead})


def _passband(text: str) -> Passband:
    """Return the width of --filter."""
    from rotorsim.signals.orders.filtered import Passband

    if "%" in text:
        share = share_of("--filter", text, "for example --filter '10 %'")
        refuse_if(share > WIDEST, f"--filter {text}: orders are one apart", hint=f"at most {100 * WIDEST:g} %")
        return Passband(share=share)
    if not text.strip().endswith("Hz"):
        raise RotorsimError(Problem(f"--filter {text}: not a width", hint="for example --filter '10 %' or '2 Hz'"))
    return Passband(hertz=hertz(text, "--filter"))


def _filtered(
    read: Recording | OrderRecording,
    runs: Sequence[str],
    orders: Sequence[int],
    width: Passband,
    lines: Sequence[float],
) -> Given:
    """Return the order vectors of the runs that are wanted by the Vold-Kalman filter."""
    from rotorsim.recordings.orders import OrderRecording
    from rotorsim.signals.orders.filtered import filtered_recording

    if isinstance(read, OrderRecording):
        raise RotorsimError(Problem("--filter needs samples: these are order vectors", read.name))
    ids = known_names(runs, [run.id for run in read.runs], lambda name: f"--run {name}: no such run in {read.name}")
    chosen = [run for run in read.runs if run.id in ids] if ids else None
    found = filtered_recording(read, orders or (1, 2), width, lines, chosen)
    show_problems(found[0].warnings)
    return Given(*_with_samples(found, read))


def _with_samples(
    found: tuple[OrderRecording, list[Positions]], read: Recording
) -> tuple[OrderRecording, Recording, list[Positions]]:
    return found[0], read, found[1]


def _channels(recording: OrderRecording, signals: Sequence[str]) -> list[str]:
    """Return the channels of signals, or entries of them, that are wanted; else of the first signal."""
    every = recording.channels
    known = {name for one in every.values() for name in (one.signal, one.name)}
    wanted = known_names(signals, known, lambda name: f"--signal {name}: not measured in {recording.name}")
    wanted = wanted or [next(iter(every.values())).signal]
    return [name for name, one in every.items() if one.signal in wanted or one.name in wanted]


def _simulated(
    diagram: str, trust_blocks: bool, given: Given, orders: Sequence[int], turns: int
) -> dict[str, dict[str, np.ndarray]]:
    """Return the vectors of a diagram along each run, nothing of it fitted: run -> channel -> (n,)."""
    from rotorsim.model.load import load

    if given.orders.runs[0].noise is not None:
        return {run.id: _along_speeds(diagram, trust_blocks, given.orders, run) for run in given.orders.runs}
    loaded = load(diagram, trust_blocks=trust_blocks)
    along = _along_table if given.sampled is None else _along_samples
    return along(loaded, given, orders, turns)


def _along_speeds(diagram: str, trust_blocks: bool, recording: OrderRecording, run: OrderRun) -> dict[str, np.ndarray]:
    """Return the orders of the settled motion of a diagram at the speeds and settings of a table."""
    from rotorsim.model.load import load
    from rotorsim.settled.periodic import periodic

    loaded = load(diagram, set=run.settings, trust_blocks=trust_blocks)
    names = list(dict.fromkeys(loaded.as_measured(one.name) for one in recording.channels.values()))
    motion = periodic(loaded, speeds=run.speed, signals=names)
    refuse_if(run.sense < 0, "a shaft that turns the other way round has no settled motion beside it", run.id)
    return {
        column: 2 * motion.harmonic(loaded.as_measured(one.name), one.order)
        if one.order <= motion.orders[-1]
        else np.zeros(len(run.speed), complex)
        for column, one in recording.channels.items()
    }


def _along_samples(
    loaded: Diagram, given: Given, orders: Sequence[int], turns: int
) -> dict[str, dict[str, np.ndarray]]:
    """Return the orders of a diagram that turns as each run did, tracked as those of the run."""
    from rotorsim.identification.as_recorded import simulate_as_recorded
    from rotorsim.signals.orders.extraction import tracked_recording

    assert given.sampled is not None
    recording, found = given.sampled, {}
    for run in recording.runs:
        if run.id not in {own.id for own in given.orders.runs}:
            continue
        result = simulate_as_recorded(loaded, recording, run.id).result
        there = np.searchsorted(run.time, result.time - np.diff(run.time).min() / 2)  # times of parts are rounded
        values = {}
        for column, channel in recording.channels.items():
            values[column] = run.values[column]
            if channel.name in result.signals:
                values[column] = np.full(len(run.time), np.nan)
                values[column][there] = result[channel.name]
        own = replace(recording, runs=(replace(run, values=values),))
        found[run.id] = dict(tracked_recording(own, orders, turns)[0].runs[0].vectors)
    return found


def _along_table(loaded: Diagram, given: Given, orders: Sequence[int], turns: int) -> dict[str, dict[str, np.ndarray]]:
    """Return the orders of a diagram along the speeds of a table."""
    from rotorsim.identification.in_orders import orders_beside

    recording = given.orders
    labels = {one.label: name for name, one in recording.channels.items()}
    alone = replace(recording, slow_roll=False)  # nothing of the recording is fitted along
    found = {}
    for run in recording.runs:
        beside = orders_beside(loaded, alone, run.id).compared.simulated
        found[run.id] = {labels[label]: vectors for label, vectors in beside.items() if label in labels}
    return found


def _figure(
    kind: str,
    given: Given,
    found: CriticalSpeeds,
    chosen: Sequence[str],
    simulated: dict[str, dict[str, np.ndarray]],
    diagram: str,
    operating: tuple[float, float] | None,
) -> Figure:
    """Return the figure of the first run."""
    from rotorsim.report.figures import orders as figures

    run, channels = given.orders.runs[0], given.orders.channels
    shown = {name: channels[name] for name in chosen if channels[name].order == found.order}
    title = f"{given.orders.name}, {run.id}"
    units = sorted({one.unit for one in shown.values()})
    if kind in ("bode", "polar"):
        hint = "--signal chooses what is drawn"
        refuse_if(len(units) > 1, f"--figure {kind} has one scale, not {' and '.join(units)}", title, hint=hint)
        some = dict(list(shown.items())[: figures.MOST_CHANNELS])
        if len(some) < len(shown):
            note(f"drawn: the first {len(some)} of {len(shown)} channels; --signal chooses others")
        tracked = figures.Tracked(run, some, found, simulated.get(run.id, {}), diagram, operating)
        what = "Bode plot" if kind == "bode" else "Polar plot"
        draw = figures.bode_plot if kind == "bode" else figures.polar_plot
        return draw(tracked, f"{what} of {found.order}X, {title}")
    if kind == "cascade" and run.noise is not None:
        hint = "bode, polar and centreline are drawn of runs at constant speeds"
        raise RotorsimError(Problem("--figure cascade needs a run-up or coast-down", title, hint=hint))
    if given.sampled is None:
        hint = "bode and polar are drawn of tables"
        raise RotorsimError(Problem(f"--figure {kind} needs samples: these are order vectors", title, hint=hint))
    return _of_samples(kind, given, run, chosen, title)


def _of_samples(kind: str, given: Given, run: OrderRun, chosen: Sequence[str], title: str) -> Figure:
    from rotorsim.recordings.recording import Channel
    from rotorsim.report.figures import orders as figures
    from rotorsim.report.text.orders import shown_unit
    from rotorsim.signals.turning import turning

    assert given.sampled is not None
    of_column: dict[tuple[str, int | None, float | None], dict[str, Channel]] = {}
    for name in chosen:
        one = given.orders.channels[name]
        if one.axis is not None:
            of_column.setdefault((one.signal, one.node, one.position), {})[one.axis] = one
    pairs = [(axes["x"], axes["y"]) for axes in of_column.values() if len(axes) == 2]
    refuse_if(not pairs, f"--figure {kind} needs channels of axis x and of axis y of one place", title)
    unit, factor = shown_unit(next(one for one in given.orders.channels.values() if one.column == pairs[0][0].column))
    if kind == "centreline":
        blind = [one.column for pair in pairs for one in pair if given.sampled.channels[one.column].coupling == "ac"]
        what = f'--figure centreline needs means, and {", ".join(blind)} have none: "coupling": "ac"'
        refuse_if(blind, what, title)
        of_run = [at for at in given.positions if at.run == run.id]
        columns = [(x.column, y.column) for x, y in pairs]
        return figures.centreline_plot(of_run, columns, unit, factor, f"Shaft centreline, {title}")
    own = next(one for one in given.sampled.runs if one.id == run.id)
    x, y = (own.values[one.column] for one in pairs[0])
    window = float(own.time[-1] - own.time[0]) / CASCADE_WINDOWS
    speed = np.abs(turning(given.sampled, own).speed)
    named = f"Cascade of full spectra, {pairs[0][0].signal}, {title}"
    return figures.cascade_plot(own.time, x + 1j * y, speed, unit, factor, named, window)
