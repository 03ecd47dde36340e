"""``rotorsim run``."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common
from rotorsim.cli.app import show_problems
from rotorsim.diagram.solver import METHODS
from rotorsim.errors import Problem

if TYPE_CHECKING:
    from rotorsim.model.compiled import Model
    from rotorsim.signals.spectrum import Harmonics
    from rotorsim.simulation.result import Result

__all__ = ["command"]


@click.command("run")
@common.diagram_options
@click.option("--solver", type=click.Choice(METHODS, case_sensitive=False), help="Method; rk4 has a fixed step.")
@click.option("--step", metavar="TIME", help="Step, as '0.1 ms' or in seconds.")
@click.option("--stop", metavar="TIME", help="Stop time, as '5 s' or in seconds.")
@click.option("--record", multiple=True, metavar="SIGNAL", help="Record this signal as well (block.port); repeatable.")
@click.option("--out", metavar="FILE", help="Write the recorded signals: .csv (as FMPy does), .h5 or .npz.")
@click.option("--plot", metavar="FILE", help="Draw the recorded signals: .png, .svg or .pdf.")
@click.option("--no-compiler", is_flag=True, help="Use CasADi's virtual machine instead of compiled C (slower).")
@common.progress_option
@common.json_option
def command(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    solver: str | None,
    step: str | None,
    stop: str | None,
    record: tuple[str, ...],
    out: str | None,
    plot: str | None,
    no_compiler: bool,
    progress: bool | None,
    as_json: bool,
) -> int:
    """Simulate a diagram; write, plot and summarise the recorded signals.

    Prints the peak of every recorded signal; of two-axis signals the harmonics at constant speed, and the
    resonance in a run-up.

    \b
    rotorsim run jeffcott --plot jeffcott.png
    rotorsim run diagrams/jeffcott.json --set "speed=1800 rpm" --stop "8 s" --out run.csv
    """
    common.check_target("--out", out, (".csv", ".h5", ".npz"))
    common.check_target("--plot", plot, common.FIGURES)
    times = {name: common.quantity(text, "s", f"--{name}") for name, text in (("step", step), ("stop", stop)) if text}
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)

    clock = common.clock_of(loaded)
    shown = [*map(str, loaded.record), *record]
    rising = clock is not None and loaded.nodes[clock].block.option.profile != "constant"
    hidden = [f"{clock}.theta", *([f"{clock}.speed"] if rising else [])] if clock else []
    signals = tuple(dict.fromkeys([*shown, *hidden]))

    from rotorsim.model.compiled import compile_diagram
    from rotorsim.simulation.run import simulate
    from rotorsim.simulation.sinks import check_sinks

    check_sinks(loaded)
    model = compile_diagram(loaded)
    with common.progress_bar(loaded.name, progress) as show:
        # With a function to call, the run is cut into pieces, so that Ctrl-C is heard between them.
        result = simulate(
            model,
            stop=times.get("stop"),
            step=times.get("step"),
            method=solver,
            record=signals,
            use_compiler=not no_compiler,
            progress=show or _silent,
        )
    angle = f"{clock}.theta" if clock else ""
    return _report(model, result, [name for name in signals if name in set(shown)], angle, out, plot, as_json)


def _silent(fraction: float) -> None:
    """Take the place of a progress bar."""


def _report(
    model: Model, result: Result, shown: list[str], angle: str, out: str | None, plot: str | None, as_json: bool
) -> int:
    """Write, draw and print a result; return the exit code."""
    from rotorsim.cli import summary
    from rotorsim.simulation.sinks import write_sinks

    common.note(summary.run_line(result))
    asked = replace(result, signals={name: result.signals[name] for name in shown})
    files = [str(path) for path in write_sinks(model.diagram, result)]
    if out:
        from rotorsim.simulation.files import save

        save(asked, out)
        files.append(out)
    if plot and len(result.time) > 1:
        from rotorsim.report.figures.run import overview, save_figure

        save_figure(overview(result), plot)
        files.append(plot)
    if files:
        common.note("written: " + ", ".join(files))
    found = summary.harmonics_of(result, angle)
    found = [item for item in found if item.signal.partition("[")[0] in {name.partition("[")[0] for name in shown}]
    motion = summary.motion(result, angle, found, summary.settled_motion(model, result, angle, found))
    if as_json:
        common.echo_json(
            _data(asked, found, files) | {"motion": motion, "run_up": summary.run_ups(result, angle, shown)}
        )
    else:
        tables = [summary.peaks_table(asked, angle), summary.motion_line(motion), *(item.table() for item in found)]
        tables.append(summary.run_up_table(result, angle, shown))
        click.echo("\n\n".join(text for text in tables if text))
    if not result.message:
        return 0
    fine = result.status == "finished"
    subject, hint = str(result.provenance.get("diagram", "")), _hint(result, out)
    show_problems([Problem(result.message, subject, hint=hint, severity="warning" if fine else "error")])
    return 0 if fine else 130 if result.status == "stopped" else 1


def _hint(result: Result, out: str | None) -> str:
    """Return what helps: a smaller step, or a look at the modes; and where the part is that was computed."""
    smaller = "a smaller --step, or --solver dop853 or radau, which choose their own" if too_large(result) else ""
    if result.status == "finished":
        return smaller
    kept = f"what was computed until then is in {out}" if out else "--out FILE keeps what was computed until then"
    if result.status == "unstable":
        kept = f"what was computed is in {out}" if out else "--out FILE keeps what was computed"
    if result.status == "stopped":
        return kept
    if smaller:
        return f"{smaller}; {kept}"
    return kept if "sampled blocks" in result.message else f"{kept}; 'rotorsim modes' shows which modes grow"


def too_large(result: Result) -> bool:
    """Return whether the message is about the step."""
    return "is too large" in result.message


def _data(result: Result, found: list[Harmonics], files: list[str]) -> dict[str, Any]:
    from rotorsim.cli.summary import peaks

    return {
        "diagram": result.provenance.get("diagram"),
        "status": result.status,
        "message": result.message,
        "time": {"stop": float(result.time[-1]) if len(result.time) else None, "samples": len(result.time)},
        "signals": peaks(result),
        "harmonics": {
            item.signal: {
                "unit": item.unit,
                "orders": list(item.orders),
                "real": item.values.real,
                "imag": item.values.imag,
                "residual": item.residual,
            }
            for item in found
        },
        "counters": dict(result.counters),
        "provenance": dict(result.provenance),
        "files": files,
    }
