"""``rotorsim cosim``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common
from rotorsim.cli.app import show_problems
from rotorsim.errors import Problem, RotorsimError, visible

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.simulation.result import Result

__all__ = ["command"]


@click.command("cosim")
@click.argument("diagram", metavar="DIAGRAM")
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
@click.option(
    "--solver",
    type=click.Choice(("rk4", "dop853", "rk45", "radau", "bdf", "lsoda"), case_sensitive=False),
    default="rk4",
    show_default=True,
    help="Of the states of FMUs for Model Exchange; radau, bdf and lsoda are implicit.",
)
@click.option("--no-check", is_flag=True, help="Run even if the linearised coupled loop is unstable.")
@click.option("--out", metavar="FILE", help="Write the signals: .csv, .h5 or .npz.")
@click.option("--log", "log", metavar="FILE", help="Write all that the FMUs say, every category; - is the terminal.")
@common.set_option
@common.trust_option
@common.progress_option
@common.json_option
def command(
    diagram: str,
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
    log: str | None,
    settings: tuple[str, ...],
    trust_blocks: bool,
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
    from rotorsim.cosim.cosimulation import cosimulate_diagram
    from rotorsim.fmi.runtime.printing import printing_elsewhere

    common.check_target("--out", out, (".csv", ".h5", ".npz"))
    width = common.quantity(step, "s", "--step")
    end = None if stop is None else common.quantity(stop, "s", "--stop")
    if end is not None and not end > 0:
        raise RotorsimError(Problem(f"--stop {stop}: must be positive", hint="such as --stop '0.2 s'"))
    every = _rates(rates)
    groups = [[name.strip() for name in part.split(",") if name.strip()] for part in parts]
    for part, names in zip(parts, groups, strict=True):
        if not names:
            raise RotorsimError(Problem(f"--part '{part}': names no block", hint="such as --part controller,reference"))
    loaded = common.open_diagram(diagram, settings, (), trust_blocks)
    with common.progress_bar("cosim", progress) as show, printing_elsewhere(), _logging(log) as hear:
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
            progress=show,
            log=hear,
        )
    if out:
        from rotorsim.simulation.files import save

        save(result, out)
        common.note(f"written: {out}")
    made = dict(result.provenance)
    show_problems(_warnings(made, log))
    if as_json:
        import numpy as np

        peaks = {name: float(np.nanmax(np.abs(values))) for name, values in result.signals.items() if values.size}
        units = {name: result.units[name] for name in peaks}
        common.echo_json(
            {
                "status": result.status,
                "message": result.message,
                "coupling": made,
                "counters": dict(result.counters),
                "time": result.time[[0, -1]],
                "peak": peaks,
                "units": units,
            }
        )
    else:
        click.echo(
            f"{result.status}: {result.counters['steps']} communication steps to {result.time[-1]:g} s, {master}"
        )
        for line in ["stability of the coupling: not analysed (--no-check)"] if no_check else _stability(made):
            click.echo(line)
        for name, about in made.get("fmus", {}).items():
            if about["most_parts"] > 1:
                click.echo(
                    f"{name}: its inputs move within a step: taken in up to {about['most_parts']} parts, "
                    f"{about['do_steps']} calls of doStep"
                )
            for text, said in about["texts"].items():
                click.echo(f"{name}: {text} is '{visible(' '.join(said.split())[:100])}' at the end")
        if text := _peaks(loaded, result):
            click.echo(f"\n{text}")
    if result.status != "finished":
        what, _, hint = result.message.partition("\n\nhint: ")
        kept = f"what was computed until then is in {out}" if out else "--out FILE keeps what was computed until then"
        show_problems([Problem(what, hint=f"{hint}; {kept}" if hint else kept)])
        sys.exit(1)


@contextmanager
def _logging(file: str | None) -> Iterator[Callable[[str, float, str, str, str], None] | None]:
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


def _warnings(made: Mapping[str, Any], log: str | None) -> list[Problem]:
    """Return what FMUs have warned of."""
    found = []
    for name, about in made.get("fmus", {}).items():
        odd = sum(count for status, count in about["messages"].items() if status != "OK")
        parts = [f"{about['warnings']} call{'s' * (about['warnings'] != 1)} returned a warning"] * bool(
            about["warnings"]
        )
        parts += [f"{odd} message{'s' * (odd != 1)} of warnings or errors"] * bool(odd)
        if parts:
            what = "; ".join(parts) + "".join(f"\n  it said: {line[:300]}" for line in about["said"])
            hint = "" if log else "--log FILE keeps all that it says"
            found.append(Problem(what, name, hint=hint, severity="warning"))
    return found


def _peaks(diagram: Diagram, result: Result) -> str:
    """Return peak and rms of the recorded signals as a table."""
    from rotorsim.cli.summary import peaks_table

    clock = common.clock_of(diagram)
    wanted = dict.fromkeys(str(name).partition("[")[0] for name in diagram.record)
    signals = {
        name: values for base in wanted for name, values in result.signals.items() if name.partition("[")[0] == base
    }
    return peaks_table(replace(result, signals=signals), f"{clock}.theta" if clock else "")


def _rates(texts: tuple[str, ...]) -> dict[str, int]:
    """Return participant -> number of steps. Raises RotorsimError."""
    found: dict[str, int] = {}
    for text in texts:
        name, equals, number = text.partition("=")
        if not (name.strip() and equals and number.strip().isdecimal()):
            raise RotorsimError(Problem(f"--rate {text}: not PARTICIPANT=N", hint="such as --rate controller=5"))
        if name.strip() in found:
            what = f"--rate {text}: {name.strip()} has a rate already"
            raise RotorsimError(Problem(what, hint="give one for each"))
        found[name.strip()] = int(number)
    return found


def _stability(made: Mapping[str, Any]) -> list[str]:
    """Return what is said of the stability of the coupling."""
    if "stability_not_analysed" in made:
        return [f"stability of the coupling: not analysed ({made['stability_not_analysed']})"]
    if "largest_stable_step" not in made:
        return []
    limit, kept = made["largest_stable_step"], made["damping_kept"]
    if limit == 0:
        return ["the linearised loop is unstable as a whole, with any step"]
    said = f"largest stable step: {limit:.3g} s" if limit < float("inf") else "stable with all steps tried"
    shown = "not told (no mode oscillates)" if kept is None else f"{kept:.1%}"
    return [f"damping kept by the coupling: {shown}; {said}"]
