"""``rotorsim run``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    RESULTS,
    Chosen,
    amplitude_option,
    clock_of,
    diagram_options,
    file_option,
    json_option,
    note,
    plot_option,
    progress_bar,
    progress_option,
    quantity,
    refuse_all,
    show,
    show_problems,
    solver_option,
)
from rotorsim.errors import Problem
from rotorsim.report.text.table import percent, table

if TYPE_CHECKING:
    from rotorsim.model.compiled import Model
    from rotorsim.signals.spectrum import Harmonics
    from rotorsim.simulation.result import Result


@dataclass(frozen=True)
class Output:
    """What is wanted of a run: signals that are shown, name of the shaft angle, files."""

    shown: tuple[str, ...]
    angle: str
    out: str | None
    plot: str | None
    as_json: bool


@click.command("run")
@diagram_options
@solver_option("Method; rk4 has a fixed step.")
@click.option("--step", metavar="TIME", help="Step, as '0.1 ms' or in seconds.")
@click.option("--stop", metavar="TIME", help="Stop time, as '5 s' or in seconds.")
@click.option("--record", multiple=True, metavar="SIGNAL", help="Record this signal as well (block.port); repeatable.")
@file_option("--out", suffixes=RESULTS, help="Write the recorded signals: .csv (as FMPy does), .h5 or .npz.")
@plot_option("the recorded signals")
@click.option("--input", "recording", metavar="RECORDING", help="Drive it as a run of this recording was.")
@click.option("--run", "run_id", metavar="ID", help="The run of --input (default: the first).")
@click.option(
    "--start",
    type=click.Choice(["estimated", "diagram"]),
    help="States at the first sample of --input: those that leave least (default), or those of the diagram.",
)
@click.option(
    "--settle", is_flag=True, help="Start in the settled motion, samplers and what they hold too: no transient."
)
@click.option("--no-compiler", is_flag=True, help="Use CasADi's virtual machine instead of compiled C (slower).")
@progress_option
@amplitude_option
@json_option
def command(
    chosen: Chosen,
    solver: str | None,
    step: str | None,
    stop: str | None,
    record: tuple[str, ...],
    out: str | None,
    plot: str | None,
    recording: str | None,
    run_id: str | None,
    start: str | None,
    settle: bool,
    no_compiler: bool,
    progress: bool | None,
    as_json: bool,
) -> int:
    """Simulate a diagram; write, plot and summarise the recorded signals.

    Prints the peak of every recorded signal; of two-axis signals the harmonics at constant speed, and the
    resonance in a run-up. With --input, what a recording measured drives it, and the errors are printed.

    \b
    rotorsim run jeffcott --plot jeffcott.png
    rotorsim run diagrams/jeffcott.json --set "speed=1800 rpm" --stop "8 s" --out run.csv
    rotorsim run servo.json --input measurements/2026-11 --run run02 --plot beside.png
    """
    if recording is not None:
        unheard = {"--solver": solver, "--step": step, "--stop": stop, "--no-compiler": no_compiler, "--settle": settle}
        hint = "the recorded instants say where it goes, in steps that are short enough"
        refuse_all([Problem(f"{name} does not go with --input", hint=hint) for name, used in unheard.items() if used])
        from rotorsim.recordings.document import recording_kind

        if recording_kind(recording) == "orders":
            unheard = {"--start": start, "--record": bool(record), "--out": out}
            hint = "orders are compared row by row: --plot draws them, --json prints the errors"
            problems = [Problem(f"{name} does not go with orders", hint=hint) for name, used in unheard.items() if used]
            refuse_all(problems)
            return _along_orders(chosen, recording, run_id, plot, as_json)
        return _as_recorded(chosen, recording, run_id, start or "estimated", record, out, plot, as_json)
    alone = {"--run": run_id, "--start": start}
    refuse_all([Problem(f"{name} needs --input RECORDING") for name, used in alone.items() if used is not None])
    times = {name: quantity(text, "s", f"--{name}") for name, text in (("step", step), ("stop", stop)) if text}
    loaded = chosen.open()

    clock = clock_of(loaded)
    shown = tuple(dict.fromkeys([*map(str, loaded.record), *record]))
    rising = clock is not None and loaded.nodes[clock].block.option.profile != "constant"
    hidden = [f"{clock}.theta", *([f"{clock}.speed"] if rising else [])] if clock else []

    from rotorsim.model.compiled import model_for_runs
    from rotorsim.simulation.run import simulate
    from rotorsim.simulation.sinks import check_sinks

    check_sinks(loaded)
    model = model_for_runs(loaded)
    initial = None
    if settle:
        from rotorsim.settled.periodic import settled_start

        initial = settled_start(loaded)
    with progress_bar(loaded.name, progress) as bar:
        # With a function to call, the run is cut into pieces, so that Ctrl-C is heard between them.
        result = simulate(
            model,
            stop=times.get("stop"),
            step=times.get("step"),
            method=solver,
            record=tuple(dict.fromkeys([*shown, *hidden])),
            initial=initial,
            use_compiler=not no_compiler,
            progress=bar or _silent,
        )
    angle = f"{clock}.theta" if clock else ""
    return _report(model, result, Output(shown, angle, out, plot, as_json))


def _as_recorded(
    chosen: Chosen,
    source: str,
    run_id: str | None,
    start: str,
    record: tuple[str, ...],
    out: str | None,
    plot: str | None,
    as_json: bool,
) -> int:
    """Drive a diagram as a run was; write and draw simulated beside measured, print the errors."""
    from rotorsim.identification.as_recorded import simulate_as_recorded
    from rotorsim.recordings.loading import load_recording

    loaded, recording = chosen.open(), load_recording(source)
    found = simulate_as_recorded(loaded, recording, run_id, start=start, record=record)
    show_problems(found.warnings)
    among = f" of {len(recording.runs)} (--run chooses another)" if len(recording.runs) > 1 and run_id is None else ""
    states = "starts estimated" if start == "estimated" else "starts of the diagram"
    note(f"{loaded.name}: driven as run {found.run}{among}, {len(found.result.time)} samples, {states}")
    files = []
    if out:
        from rotorsim.simulation.files import save

        save(found.result, out)
        files.append(out)
    if plot:
        from rotorsim.report.figures.as_recorded import as_recorded_figure
        from rotorsim.report.figures.run import save_figure

        save_figure(as_recorded_figure(found), plot)
        files.append(plot)
    if files:
        note("written: " + ", ".join(files))
    nrmse, rms = found.errors.nrmse, found.errors.rms
    shown = {name: in_unit(rms[name], found.units[name]) for name in found.outputs}
    rows = [(name, percent(nrmse.get(name, math.nan)), f"{value:.4g}", unit) for name, (value, unit) in shown.items()]
    data = {
        "diagram": loaded.name,
        "recording": recording.name,
        "run": found.run,
        "start": {"states": start, "values": dict(found.starts)},
        "errors": {name: {"nrmse": nrmse.get(name), "rms": rms[name]} for name in found.outputs},
        "time": {"samples": len(found.result.time), "steps_between_samples": found.sub},
        "warnings": [f"{problem.subject}: {problem.what}" for problem in found.warnings],
        "files": files,
    }
    show(as_json, lambda: data, lambda: table(("signal", "NRMSE", "rms error", "unit"), rows))
    return 0


def _along_orders(chosen: Chosen, source: str, run_id: str | None, plot: str | None, as_json: bool) -> int:
    """Simulate a diagram along a run of orders over the speed; draw it beside what was measured, print the errors."""
    from rotorsim.identification.simulated_orders import orders_beside
    from rotorsim.recordings.orders import load_orders

    loaded, recording = chosen.open(), load_orders(source)
    found = orders_beside(loaded, recording, run_id)
    show_problems(recording.warnings)
    run = found.compared.run
    note(
        f"{loaded.name}: along run {run.id}, {len(run.speed)} rows" + (", slow roll fitted" if found.slow_roll else "")
    )
    if plot:
        from rotorsim.report.figures.run import save_figure
        from rotorsim.report.identification.orders import beside_figure

        save_figure(beside_figure(found, f"{loaded.name} beside run {run.id} of {recording.name}"), plot)
        note(f"written: {plot}" + (f", of {next(iter(found.rms))} alone" if len(found.rms) > 1 else ""))
    shown = {name: in_unit(value, found.units[name]) for name, value in found.rms.items()}
    rows = [(name, percent(found.nrmse.get(name, math.nan)), f"{v:.4g}", unit) for name, (v, unit) in shown.items()]
    data = {
        "diagram": loaded.name,
        "recording": recording.name,
        "run": run.id,
        "errors": {name: {"nrmse": found.nrmse.get(name), "rms": value} for name, value in found.rms.items()},
        "noise": dict(found.noise),
        "slow_roll": {name: [vector.real, vector.imag] for name, vector in found.slow_roll.items()},
        "files": [plot] if plot else [],
    }
    show(as_json, lambda: data, lambda: table(("order", "NRMSE", "rms error", "unit"), rows))
    return 0


def in_unit(value: float, unit: str) -> tuple[float, str]:
    """Return an SI value in the unit in which it was recorded."""
    from rotorsim.units import conversion

    return value / conversion(unit, None), "" if unit == "1" else unit


def _silent(fraction: float) -> None:
    """Take the place of a progress bar."""


def _report(model: Model, result: Result, wanted: Output) -> int:
    """Write, draw and print a result; return the exit code."""
    from rotorsim.report.amplitudes import shown_amplitudes
    from rotorsim.report.text import run as text
    from rotorsim.simulation.sinks import write_sinks

    note(text.run_line(result))
    if coupling := result.provenance.get("coupling"):
        from rotorsim.report.text.coupling import fmu_lines, said_by_fmus, stability_lines

        show_problems(said_by_fmus(coupling, "'rotorsim cosim --log FILE' keeps all that it says"))
        error = result.counters.get("step_error")
        told = [] if error is None else [f"error of the coupling: {percent(error)} of the rms of a signal at most"]
        for line in (*stability_lines(coupling), *told, *fmu_lines(coupling)):
            note(line)
    asked = replace(result, signals={name: result.signals[name] for name in wanted.shown})
    files = [str(path) for path in write_sinks(model.diagram, result)]
    if wanted.out:
        from rotorsim.simulation.files import save

        save(asked, wanted.out)
        files.append(wanted.out)
    if wanted.plot and len(result.time) > 1:
        from rotorsim.report.figures.run import overview, save_figure

        save_figure(overview(result), wanted.plot)
        files.append(wanted.plot)
    if files:
        note("written: " + ", ".join(files))
    ports = {name.partition("[")[0] for name in wanted.shown}
    angle = wanted.angle
    harmonics = [item for item in text.harmonics_of(result, angle) if item.signal.partition("[")[0] in ports]
    motion = text.motion(result, angle, harmonics, text.settled_motion(model, result, angle, harmonics))
    run_ups = text.run_ups(result, angle, wanted.shown)
    harmonic_tables = [item.table(shown_amplitudes()) for item in harmonics]
    tables = [text.peaks_table(asked, angle), text.motion_line(motion), *harmonic_tables]
    tables.append(text.run_up_table(run_ups))
    show(
        wanted.as_json,
        lambda: _data(asked, harmonics, files) | {"motion": motion, "run_up": run_ups},
        lambda: "\n\n".join(part for part in tables if part),
    )
    if not result.message:
        return 0
    fine = result.status == "finished"
    what, _, said = result.message.partition("\n\nhint: ")
    hint = "; ".join(part for part in (said, _hint(result, wanted.out)) if part)
    subject = str(result.provenance.get("diagram", ""))
    show_problems([Problem(what, subject, hint=hint, severity="warning" if fine else "error")])
    return 0 if fine else 130 if result.status == "stopped" and not result.cause else 1


def _hint(result: Result, out: str | None) -> str:
    """Return what helps: a smaller step, or a look at the modes; and where the part is that was computed."""
    smaller = ""
    if result.cause == "step":
        smaller = "a smaller --step, or --solver dop853 or radau, which choose their own"
    if result.cause == "coupling":
        smaller = "a smaller --step, or 'rotorsim cosim' with another --master or --order"
    if result.status == "finished":
        return smaller
    computed = "what was computed" + ("" if result.status == "unstable" else " until then")
    kept = f"{computed} is in {out}" if out else f"--out FILE keeps {computed}"
    if result.status == "stopped":
        return kept
    if smaller:
        return f"{smaller}; {kept}"
    return kept if result.cause in ("sampled", "loop", "part") else f"{kept}; 'rotorsim modes' shows which modes grow"


def _data(result: Result, harmonics: Sequence[Harmonics], files: Sequence[str]) -> dict[str, Any]:
    from rotorsim.report.text.run import peaks
    from rotorsim.report.text.spectrum import harmonics_data

    return {
        "diagram": result.provenance.get("diagram"),
        "status": result.status,
        "message": result.message,
        "time": {"stop": float(result.time[-1]) if len(result.time) else None, "samples": len(result.time)},
        "signals": peaks(result),
        "harmonics": {item.signal: {"unit": item.unit, **harmonics_data(item)} for item in harmonics},
        "counters": dict(result.counters),
        "provenance": dict(result.provenance),
        "files": list(files),
    }
