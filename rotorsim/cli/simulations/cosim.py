"""``rotorsim cosim``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    RESULTS,
    Chosen,
    amplitude_option,
    clock_of,
    diagram_argument,
    file_option,
    json_option,
    listed,
    named_values,
    note,
    parameter_options,
    plot_option,
    progress_bar,
    progress_option,
    quantity,
    refuse_if,
    show,
    show_problems,
    solver_option,
)
from rotorsim.errors import Problem, RotorsimError
from rotorsim.report.text.coupling import fmu_lines, said_by_fmus, stability_lines

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.simulation.result import Result

Hear = Callable[[str, float, str, str, str], None]  # block, time, status, category, text


@click.command("cosim")
@diagram_argument
@click.option("--step", required=True, metavar="TIME", help="Communication step, such as '0.1 ms'.")
@click.option("--stop", metavar="TIME", help="Stop time (default: the diagram's).")
@click.option(
    "--master",
    type=click.Choice(["jacobi", "gauss_seidel", "iterative", "waveform"]),
    default="gauss_seidel",
    show_default=True,
    help="iterative repeats each step until all agree, waveform the whole run.",
)
@click.option(
    "--order",
    type=click.IntRange(0, 3),
    help="Inputs within a step: 0 held, 1 linear, 2 quadratic, 3 cubic.  [default: 0; 3 of master iterative]",
)
@click.option("--part", "parts", multiple=True, metavar="BLOCK,...", help="Blocks that are a participant; repeatable.")
@click.option(
    "--rate",
    "rates",
    multiple=True,
    metavar="PARTICIPANT=N",
    help="This participant (or the one of this block) takes N steps at once; repeatable.",
)
@click.option(
    "--adaptive",
    type=click.FloatRange(0.0, 1.0, min_open=True),
    metavar="ERROR",
    help="Relative error allowed per step; the step then adapts.",
)
@click.option("--fast", is_flag=True, help="The plain loop in C, for FMUs for Co-Simulation.")
@solver_option(
    "Of the states of FMUs for Model Exchange; radau, bdf and lsoda are implicit.", default="rk4", show_default=True
)
@click.option("--no-check", is_flag=True, help="Run even if the linearised coupled loop is unstable.")
@file_option("--out", suffixes=RESULTS, help="Write the signals: .csv, .h5 or .npz.")
@plot_option("the recorded signals")
@click.option("--log", "log", metavar="FILE", help="Write all that the FMUs say, every category; - is the terminal.")
@parameter_options
@progress_option
@amplitude_option
@json_option
def command(
    chosen: Chosen,
    step: str,
    stop: str | None,
    master: str,
    order: int | None,
    parts: tuple[str, ...],
    rates: tuple[str, ...],
    adaptive: float | None,
    fast: bool,
    solver: str,
    no_check: bool,
    out: str | None,
    plot: str | None,
    log: str | None,
    progress: bool | None,
    as_json: bool,
) -> None:
    """Co-simulate DIAGRAM: its FMUs, the parts given, and the rest exchange signals at communication points.

    Coupling adds delay: the damping that it leaves and the largest stable step are computed and said, and a step that
    must diverge is refused. Sampled signals are held, and their hits are communication points too.

    \b
    rotorsim cosim jeffcott --part controller --step "0.1 ms" --master iterative
    rotorsim cosim jeffcott --part controller --step "20 us" --order 1 --rate controller=5
    """
    from rotorsim.cosim.cosimulation import cosimulate_diagram, recorded

    width = quantity(step, "s", "--step")
    end = None if stop is None else quantity(stop, "s", "--stop")
    refuse_if(end is not None and not end > 0, f"--stop {stop}: must be positive", hint="such as --stop '0.2 s'")
    every = _rates(rates)
    groups, hint = [list(listed(part)) for part in parts], "such as --part controller,reference"
    for part, names in zip(parts, groups, strict=True):
        refuse_if(not names, f"--part '{part}': names no block", hint=hint)
    loaded = chosen.open()
    with progress_bar("cosim", progress) as bar, _logging(log) as hear:
        result = cosimulate_diagram(
            loaded,
            groups,
            step=width,
            stop=end,
            master=master,
            order=order,
            adaptive=adaptive,
            fast=fast,
            check=not no_check,
            rates=every,
            solver=solver.lower(),
            progress=bar,
            log=hear,
        )
    if out:
        from rotorsim.simulation.files import save

        save(result, out)
        note(f"written: {out}")
    if plot and len(result.time) > 1:
        from rotorsim.report.figures.run import overview, save_figure

        save_figure(overview(recorded(loaded, result)), plot)
        note(f"written: {plot}")
    made = dict(result.provenance)
    show_problems(said_by_fmus(made, "" if log else "--log FILE keeps all that it says"))
    head = f"{result.status}: {result.counters['steps']} communication steps to {result.time[-1]:g} s, {master}"
    stability = ["stability of the coupling: not analysed (--no-check)"] if no_check else stability_lines(made)
    lines = [head, *stability, *fmu_lines(made)]
    show(as_json, lambda: _data(result), lambda: "\n".join([*lines, *_peaks(loaded, result)]))
    if result.status != "finished":
        what, _, hint = result.message.partition("\n\nhint: ")
        kept = f"what was computed until then is in {out}" if out else "--out FILE keeps what was computed until then"
        show_problems([Problem(what, hint=f"{hint}; {kept}" if hint else kept)])
        sys.exit(1)


def _data(result: Result) -> dict[str, Any]:
    import numpy as np

    peaks = {name: float(np.nanmax(np.abs(values))) for name, values in result.signals.items() if values.size}
    return {
        "status": result.status,
        "message": result.message,
        "coupling": dict(result.provenance),
        "counters": dict(result.counters),
        "time": result.time[[0, -1]],
        "peak": peaks,
        "units": {name: result.units[name] for name in peaks},
    }


@contextmanager
def _logging(file: str | None) -> Iterator[Hear | None]:
    """Give a function that writes messages of FMUs to a file, or None."""
    if file is None:
        yield None
        return
    try:
        stream = sys.stderr if file == "-" else open(file, "w", encoding="utf-8")  # noqa: SIM115 - closed below
    except OSError as error:
        why = (error.strerror or str(error)).lower()
        raise RotorsimError(Problem(f"--log {file}: cannot be written: {why}")) from None

    def hear(block: str, time: float, status: str, category: str, text: str) -> None:
        plain = "".join(c if c.isprintable() else " " for c in text)
        print(f"{time:.9g}\t{block}\t{status}\t{category}\t{plain}", file=stream)

    try:
        yield hear
    finally:
        if file != "-":
            stream.close()


def _peaks(diagram: Diagram, result: Result) -> list[str]:
    """Return peak and rms of the recorded signals as a table, after an empty line."""
    from rotorsim.cosim.cosimulation import recorded
    from rotorsim.report.text.run import peaks_table

    clock = clock_of(diagram)
    text = peaks_table(recorded(diagram, result), f"{clock}.theta" if clock else "")
    return ["", text] if text else []


def _rates(texts: Sequence[str]) -> dict[str, int]:
    """Return participant -> number of steps. Raises RotorsimError."""
    numbers = named_values(
        texts,
        lambda text: Problem(f"--rate {text}: not PARTICIPANT=N", hint="such as --rate controller=5"),
        lambda name: Problem(f"--rate {name}: has a rate already", hint="give one for each"),
    )
    for name, number in numbers.items():
        hint = "such as --rate controller=5"
        refuse_if(not number.isdecimal(), f"--rate {name}={number}: not PARTICIPANT=N", hint=hint)
    return {name: int(number) for name, number in numbers.items()}
