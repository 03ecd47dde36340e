"""``rotorsim fmu``."""

from __future__ import annotations

import click

from rotorsim.cli.shared import (
    Chosen,
    Group,
    diagram_options,
    file_option,
    fmi_option,
    json_option,
    note_mistakes,
    platform_option,
    problem_data,
    show,
    show_help,
    show_problems,
)
from rotorsim.errors import RotorsimError
from rotorsim.report.text.table import counted, table

SOURCE = "source"


@click.group("fmu", cls=Group, invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Functional mock-up units: export diagrams for other tools, look into FMUs.

    Each verb prints machine-readable JSON with --json.
    """
    show_help(context)


@command.command("export")
@diagram_options
@click.option("--block", "blocks", multiple=True, metavar="NAME", help="Export only this block; repeatable.")
@click.option(
    "--input",
    "inputs",
    multiple=True,
    metavar="PORT",
    help="Make this additive input port an input too, such as rotor.force; repeatable.",
)
@click.option(
    "--output",
    "outputs",
    multiple=True,
    metavar="SIGNAL",
    help="Output this signal (default: what is recorded, or all ports of --block); repeatable.",
)
@fmi_option
@platform_option
@click.option("--arrays", is_flag=True, help="Vectors and matrices as arrays instead of scalars (FMI 3.0).")
@click.option("--fixed", is_flag=True, help="Parameters cannot change after initialisation.")
@file_option("-o", "--out", suffixes=(".fmu",), required=True, metavar="FILE.fmu", help="Write the FMU here.")
@json_option
def export(
    chosen: Chosen,
    blocks: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    version: str,
    platforms: tuple[str, ...],
    arrays: bool,
    fixed: bool,
    out: str,
    as_json: bool,
) -> None:
    """Write a diagram, or some of its blocks, as an FMU for model exchange and co-simulation.

    With --block, what comes from other blocks becomes an input. Co-simulation takes the diagram's own step. FMUs in the
    diagram go along inside (--trust-blocks: their code is run); a step at which those for Co-Simulation make a stable
    loop unstable is refused, as by `rotorsim run`.

    \b
    rotorsim fmu export jeffcott -o jeffcott.fmu
    rotorsim fmu export jeffcott --block rotor --fmi 3.0 -o rotor.fmu
    """
    loaded = chosen.open()
    from rotorsim.fmi.export.export import export_fmu
    from rotorsim.fmi.export.nested import couples_by_steps

    if not blocks and couples_by_steps(loaded):
        from rotorsim.simulation.run import simulate

        simulate(loaded, stop=loaded.solver.step)  # refuses a step that must diverge
    done = export_fmu(
        loaded,
        out,
        blocks=blocks or None,
        version=version,
        platforms=[name for name in platforms if name != SOURCE] if platforms else None,
        arrays=arrays,
        inputs=inputs,
        outputs=outputs or None,
        fixed=fixed,
    )
    show_problems(done.warnings)
    counts = {role: done.interface.count(role) for role in ("parameter", "input", "output", "state", "event")}
    inside = [
        {
            "block": one.block,
            "model": one.kind.identifier,
            "fmi": one.description.version,
            "platforms": sorted(one.libraries),
        }
        for one in done.interface.nested
    ]
    data = {
        "file": out,
        "fmi": version,
        "model": done.interface.identifier,
        "token": done.token,
        "blocks": list(done.interface.part.blocks),
        "step": loaded.solver.step,
        "variables": counts,
        "libraries": done.libraries,
        "fmus": inside,
    }
    sizes = [(name, f"{size / 1e3:.0f} kB") for name, size in done.libraries.items()]
    lines = [
        f"{out}: FMI {version}, model exchange and co-simulation, step {loaded.solver.step:g} s",
        ", ".join(counted(n, role) for role, n in counts.items()),
        *(
            f"holds {one['model']} for {one['block']}: FMI {one['fmi']}, {', '.join(one['platforms'])}"
            for one in inside
        ),
        table(("platform", "library"), sizes) if sizes else "sources only",
    ]
    show(as_json, lambda: data, lambda: "\n".join(lines))


@command.command("info")
@click.argument("file", metavar="FILE")
@click.option("--all", "every", is_flag=True, help="Show local variables too, and all of every kind.")
@json_option
def info(file: str, every: bool, as_json: bool) -> None:
    """Show what an FMU holds: platforms, kinds, variables with units, and what of it is supported.

    Nothing of it is loaded or unpacked.
    """
    from rotorsim.fmi.description.info import information, information_text
    from rotorsim.fmi.runtime.slave import describe_fmu

    data = information(describe_fmu(file), every=every)
    show(as_json, lambda: data, lambda: information_text(data, every=every))


@command.command("validate")
@click.argument("file", metavar="FILE")
@click.option("--load", is_flag=True, help="Instantiate and initialise it too, in a process of its own: it is code.")
@click.option("--no-fmpy", is_flag=True, help="Do not ask FMPy's validator.")
@json_option
def validate(file: str, load: bool, no_fmpy: bool, as_json: bool) -> int:
    """Find every mistake in an FMU: archive, model description, libraries.

    Its code is not run without --load. Exit code 0: no mistake, 1: mistakes, 2: it cannot be read at all.
    """
    from rotorsim.fmi.validate import validate_fmu

    try:
        problems, code = validate_fmu(file, load=load, fmpy=not no_fmpy), 0
    except RotorsimError as error:
        problems, code = list(error.problems), 2
    mistakes = sum(problem.severity == "error" for problem in problems)
    code = code or int(mistakes > 0)
    show_problems(problems)
    fine = f"{file}: no mistakes" + (f", {counted(len(problems), 'warning')}" if problems else "")
    data = {"fmu": file, "valid": code == 0, "problems": [problem_data(problem) for problem in problems]}
    show(as_json, lambda: data, lambda: "" if code else fine)
    note_mistakes(mistakes)
    return code
