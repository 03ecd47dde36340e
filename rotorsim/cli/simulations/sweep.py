"""``rotorsim sweep``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from rotorsim.cli.shared import (
    RESULTS,
    Chosen,
    amplitude_option,
    diagram_options,
    file_option,
    jobs_options,
    json_option,
    known_names,
    listed,
    note,
    plot_option,
    progress_bar,
    progress_option,
    quantity,
    refuse_if,
    save_plot,
    show,
    show_problems,
    solver_option,
    warn,
)
from rotorsim.errors import Problem

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.simulation.ensemble.result import Ensemble

ENSEMBLE_FIGURES = ("curve", "map", "band", "bifurcation", "cascade")  # of `report.figures.ensemble`
NEEDED = {"bifurcation": "poincare", "cascade": "history"}


@dataclass(frozen=True)
class Drawn:
    """What is drawn: file, kind of figure, signal, reduction, the parameter along the axis."""

    plot: str | None
    figure: str
    signal: str
    of: str
    over: str


@click.command("sweep")
@diagram_options
@click.option(
    "--vary",
    multiple=True,
    metavar="NAME=VALUES",
    help="Vary a parameter: start:step:stop, a list a,b,c, normal(mean, std) or uniform(low, high); repeatable: every "
    "combination is run.",
)
@click.option("--draws", type=click.IntRange(1), help="Draws of the distributions [100], the same ones everywhere.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of the draws.")
@click.option("--stop", metavar="TIME", help="Stop time of every run, as '5 s' or in seconds.")
@click.option("--turns", type=float, metavar="N", help="Run every shaft for N turns, in equal steps of a turn.")
@click.option("--step", metavar="TIME", help="Step, as '0.1 ms' or in seconds; with --turns the largest one.")
@click.option(
    "--window", metavar="START:STOP", help="What is reduced, as '4 s:5 s'; with --turns '100:200' (default: 2nd half)."
)
@click.option(
    "--reduce",
    "kinds",
    metavar="KIND,...",
    help="What is kept of every run [peak,rms]: peak, peak_to_peak, mean, rms, radius, last, harmonics=3, poincare, "
    "envelope=200, history.",
)
@click.option("--record", multiple=True, metavar="SIGNAL", help="Signals (default: those of the diagram); repeatable.")
@click.option("--angle", metavar="SIGNAL", help="Shaft angle of harmonics and turns (default: of the clock).")
@solver_option("Method; rk4 runs side by side, others one by one.")
@click.option("--store", metavar="FILE", help="Keep every run here; an interrupted sweep resumes from it.")
@jobs_options
@file_option("--out", suffixes=RESULTS, help="Write a table as .csv, or everything as .h5 or .npz.")
@plot_option("the runs")
@click.option("--figure", type=click.Choice(ENSEMBLE_FIGURES), help="Kind of --plot (default: what fits).")
@click.option("--show", "signal", default="", metavar="SIGNAL", help="Signal of --plot (default: the first).")
@click.option("--of", default="", metavar="KIND", help="Reduction of --plot (default: peak).")
@click.option(
    "--over", default="", metavar="NAME", help="Parameter along the axis of --plot (default: the first grid)."
)
@click.option("--no-compiler", is_flag=True, help="Use CasADi's virtual machine instead of compiled C (slower).")
@progress_option
@amplitude_option
@json_option
def command(
    chosen: Chosen,
    vary: tuple[str, ...],
    draws: int | None,
    seed: int,
    stop: str | None,
    turns: float | None,
    step: str | None,
    window: str | None,
    kinds: str | None,
    record: tuple[str, ...],
    angle: str | None,
    solver: str | None,
    store: str | None,
    scheduler: str | None,
    workers: int | None,
    out: str | None,
    plot: str | None,
    figure: str | None,
    signal: str,
    of: str,
    over: str,
    no_compiler: bool,
    progress: bool | None,
    as_json: bool,
) -> int:
    """Simulate a diagram many times with varied parameters, side by side; reduce, write and draw the runs.

    Every run is what 'rotorsim run' gives for its values. Exit code 1 where some did not finish (unstable, diverged).

    \b
    rotorsim sweep jeffcott --vary "speed=600 rpm:10 rpm:3000 rpm" --reduce radius,harmonics --plot resonance.png
    rotorsim sweep jeffcott --vary "speed=600 rpm:20 rpm:3000 rpm" --vary "controller.KP=9e3:1e3:3e4" --plot map.png
    rotorsim sweep jeffcott --vary "speed=600 rpm:50 rpm:3000 rpm" --vary "rotor.mass=normal(2 kg, 5 %)" --plot band.png
    """
    of = of.strip()
    for name, given in {"--figure": figure, "--show": signal, "--of": of, "--over": over}.items():
        refuse_if(given and not plot, f"{name} needs --plot FILE")
    refuse_if(stop and turns is not None, "--stop and --turns exclude each other", hint="give one of them")
    refuse_if(not vary, "nothing varies", hint='for example --vary "speed=600 rpm:10 rpm:6000 rpm"')
    reduce = list(listed(kinds)) if kinds is not None else None
    from rotorsim.cli.shared.variations import variations, window_of_run
    from rotorsim.simulation.ensemble.files import refuse_table, save_ensemble
    from rotorsim.simulation.ensemble.many import simulate_many
    from rotorsim.simulation.ensemble.reductions import DEFAULT, chosen_reductions

    wanted = [*(DEFAULT if reduce is None else reduce)]
    if figure in NEEDED and NEEDED[figure] not in chosen_reductions(wanted):
        wanted.append(NEEDED[figure])
    if out and out.lower().endswith(".csv"):
        refuse_table(chosen_reductions(wanted), out)
    times = {name: quantity(text, "s", f"--{name}") for name, text in (("step", step), ("stop", stop)) if text}
    part = None if window is None else window_of_run(window, "s" if turns is None else "turns")
    loaded = chosen.open()
    varied = variations(vary, loaded, draws, seed)
    for name, node in loaded.nodes.items():
        if node.block.type_name == "to_file":
            warn("its file is not written: it would be that of one run alone", name, hint="--out FILE holds all runs")
    recorded = [*record] or _recorded(loaded, wanted)
    _check_figure(Drawn(plot, figure or "", signal, of, over), chosen_reductions(wanted), recorded, [*varied.runs])
    with progress_bar(loaded.name, progress) as bar:
        ensemble = simulate_many(
            loaded,
            varied.runs,
            stop=times.get("stop"),
            step=times.get("step"),
            turns=turns,
            reduce=wanted,
            window=part,
            record=recorded,
            method=solver,
            angle=angle,
            scheduler=scheduler,
            workers=workers,
            store=store,
            progress=bar,
            use_compiler=not no_compiler,
        )
    files = [file for file in (out, plot) if file]
    if out:
        save_ensemble(ensemble, out)
        note(f"written: {out}")
    code = _report(ensemble, files, as_json)
    banded = "band" if varied.drawn and not set(NEEDED.values()) & set(ensemble.values) else ""
    drawn = Drawn(plot, figure or banded, signal, of, over or next(iter(varied.grid), ""))
    save_plot(lambda: ensemble.plot(drawn.figure, drawn.signal, drawn.of, drawn.over), drawn.plot)
    return code


def _check_figure(drawn: Drawn, kinds: Mapping[str, int], recorded: Sequence[str], varied: Sequence[str]) -> None:
    """Refuse names that no figure of the runs will have, before they are run."""
    bases = [name.partition("[")[0] for name in recorded]
    if drawn.signal and drawn.signal.partition("[")[0] not in bases:
        known_names([drawn.signal], recorded, lambda name: f"--show {name}: this signal is not recorded")
    if drawn.of:
        known_names([drawn.of], kinds, lambda name: f"--of {name}: not kept (--reduce {name})")
    if drawn.over:
        known_names([drawn.over], varied, lambda name: f"--over {name}: nothing varies it")


def _recorded(diagram: Diagram, wanted: Sequence[str]) -> list[str]:
    """Return what a diagram records without angle and speed of the shaft; with them where spectra are drawn."""
    clocks = {name for name, node in diagram.nodes.items() if node.block.category == "clock"}
    return [str(end) for end in diagram.record if end.block not in clocks or "history" in wanted]


def _report(ensemble: Ensemble, files: list[str], as_json: bool) -> int:
    """Say what was run and how it ended; print the table, or all rows as JSON; return the exit code."""
    from rotorsim.report.text.ensemble import ensemble_data, ensemble_line, ensemble_table, not_finished, remarks

    note(ensemble_line(ensemble))
    show(as_json, lambda: ensemble_data(ensemble) | {"files": files}, lambda: ensemble_table(ensemble))
    said = [Problem(what, subject, hint=hint) for subject, what, hint in not_finished(ensemble)]
    show_problems([*said, *(Problem(what, subject, severity="warning") for subject, what in remarks(ensemble))])
    return 1 if said else 0
