"""``rotorsim orders``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click

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
    refuse_if,
    save_plot,
    share_of,
    show,
    show_problems,
    span_of,
)
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from rotorsim.measure.order_vectors import OrderVectors
    from rotorsim.recordings.orders import OrderRecording
    from rotorsim.recordings.recording import Recording
    from rotorsim.signals.orders.critical_speeds import CriticalSpeeds
    from rotorsim.signals.orders.filtered import Passband

FIGURE_KINDS = ("bode", "polar", "cascade", "centreline")
PHASE_WORDS = ("lead", "lag")  # those of rotorsim.recordings.orders
WIDEST = 0.5  # of an order, as a passband


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
    from rotorsim.measure.order_vectors import filtered_vectors, order_vectors

    read = _read(chosen, runs)
    ids = known_names(runs, [run.id for run in read.runs], lambda name: f"--run {name}: no such run in {read.name}")
    if width is None:
        given = order_vectors(read, ids, wanted, turns)
    else:
        given = filtered_vectors(read, ids, wanted, width, steady_lines)
    if given.sampled is not None:
        show_problems(given.orders.warnings)
    if slow is not None:
        warned = len(given.orders.warnings)
        given = given.without_slow_roll(*slow)
        show_problems(given.orders.warnings[warned:])
    tracked = given.orders
    names = _channels(tracked, signals)
    from rotorsim.signals.orders.critical_speeds import CriticalSpeeds, critical_speeds

    kinds = list(wanted) or sorted({channel.order for channel in tracked.channels.values()})
    notes = given.notes
    if width is None:
        single = given.of_single_turns(kinds)
        notes = single.notes
        found = [critical_speeds(run, single.orders.channels, order) for run in single.orders.runs for order in kinds]
    else:
        found = [CriticalSpeeds(run.id, order, run.speed, ()) for run in tracked.runs for order in kinds]
        notes += ("critical speeds are told without --filter: a filter makes resonances broader, and noise smooth",)
    if beside is not None and not plot:
        notes += ("--beside is drawn: --plot FILE",)
    for text in notes:
        note(text)
    from rotorsim.report.text import orders as words

    def said() -> str:
        parts = []
        for run in tracked.runs:
            own = {name: tracked.channels[name] for name in names if tracked.channels[name].order in kinds}
            lines = [words.run_text(run), words.peaks_text(run, own)]
            lines += [words.critical_text(one, own, span) for one in found if one.run == run.id and width is None]
            parts.append("\n\n".join(lines))
        return "\n\n\n".join(parts)

    if plot:
        refuse_if(
            len(tracked.runs) > 1,
            f"--plot draws one run, {chosen.name} has {len(tracked.runs)}",
            hint=f"--run {tracked.runs[0].id}, for example",
        )
        simulated = {}
        if beside is not None:
            from rotorsim.identification.simulated_orders import simulated_vectors

            simulated = simulated_vectors(beside, given, kinds, turns, trust_blocks=chosen.trust_blocks)
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
    show(as_json, lambda: words.orders_data(tracked, found if width is None else [], span), said)
    untold = [f"{one.run}, {one.order}X" for one in found if not (one.found or one.explained)]
    hint = "lead taken for lag, a speed that turns back, a rub, a clipped probe? the figure shows what the modes leave"
    what = "the motion is not that of linear modes, and no critical speed is told"
    refuse_if(untold, what, "; ".join(untold), hint=hint, exit_code=1)


def _read(chosen: Chosen, runs: Sequence[str]) -> Recording | OrderRecording:
    """Return a recording, or the run of a diagram as one, of which the runs that are wanted are usable."""
    from rotorsim.measure.order_vectors import run_as_recorded, usable

    read: Recording | OrderRecording
    if is_recording(chosen.name):
        from rotorsim.recordings.orders import load_any

        chosen.refuse_changes("a recording")
        read = load_any(chosen.name)
        show_problems(read.warnings)
    else:
        read, notes = run_as_recorded(chosen.open())
        for text in notes:
            note(text)
    read, problems = usable(read, runs)
    show_problems(problems)
    return read


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


def _channels(recording: OrderRecording, signals: Sequence[str]) -> list[str]:
    """Return the channels of signals, or entries of them, that are wanted; else of the first signal."""
    every = recording.channels
    known = {name for one in every.values() for name in (one.signal, one.name)}
    wanted = known_names(signals, known, lambda name: f"--signal {name}: not measured in {recording.name}")
    wanted = wanted or [next(iter(every.values())).signal]
    return [name for name, one in every.items() if one.signal in wanted or one.name in wanted]


def _figure(
    kind: str,
    given: OrderVectors,
    found: CriticalSpeeds,
    chosen: Sequence[str],
    simulated: Mapping[str, Mapping[str, np.ndarray]],
    diagram: str,
    operating: tuple[float, float] | None,
) -> Figure:
    """Return the figure of the first run."""
    from rotorsim.report.figures import orders as figures

    run, channels = given.orders.runs[0], given.orders.channels
    shown = {name: channels[name] for name in chosen if channels[name].order == found.order}
    drawn = figures.Tracked(run, shown, found, simulated.get(run.id, {}), diagram, operating)
    if kind in ("bode", "polar") and len(shown) > figures.MOST_CHANNELS:
        note(f"drawn: the first {figures.MOST_CHANNELS} of {len(shown)} channels; --signal chooses others")
    return figures.orders_figure(kind, given, drawn)
