"""``rotorsim fmu``: export here; info and validate in their own module, imported when called."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

import click

from rotorsim.cli import common
from rotorsim.cli.app import show_problems

__all__ = ["command"]

_HELP = {
    "export": "Write a diagram, or some of its blocks, as an FMU.",
    "info": "What is in an FMU: variables, units, platforms, what it can do.",
    "validate": "Find every mistake in an FMU.",
}
_ELSEWHERE = ("info", "validate")
SOURCE = "source"


class _Group(common.Group):
    """Group of which some verbs are in another module."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*super().list_commands(ctx), *(_ELSEWHERE if find_spec("rotorsim.cli.fmu_info") else ())]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in self.list_commands(ctx) and cmd_name in _ELSEWHERE:
            found: click.Command = getattr(import_module("rotorsim.cli.fmu_info"), cmd_name)
            return found
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        lines = [(name, _HELP[name]) for name in self.list_commands(ctx)]
        with formatter.section("Verbs"):
            formatter.write_dl(lines)


@click.group("fmu", cls=_Group, invoke_without_command=True)
@click.pass_context
def command(ctx: click.Context) -> None:
    """Functional mock-up units: export diagrams for other tools, look into FMUs.

    Each verb prints machine-readable JSON with --json.
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


@command.command("export")
@common.diagram_options
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
@click.option("--fmi", "version", type=click.Choice(["2.0", "3.0"]), default="2.0", help="Version of FMI [2.0].")
@click.option(
    "--platform",
    "platforms",
    multiple=True,
    metavar="NAME",
    help="linux64, aarch64-linux, win64, darwin64, aarch64-darwin, ... or source (no library); repeatable. "
    "Default: this machine's. Others need ziglang.",
)
@click.option("--arrays", is_flag=True, help="Vectors and matrices as arrays instead of scalars (FMI 3.0).")
@click.option("--fixed", is_flag=True, help="Parameters cannot change after initialisation.")
@click.option("-o", "--out", required=True, metavar="FILE.fmu", help="Write the FMU here.")
@common.json_option
def export(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
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

    With --block, what comes from other blocks becomes an input. Co-simulation takes the diagram's own step.

    \b
    rotorsim fmu export jeffcott -o jeffcott.fmu
    rotorsim fmu export jeffcott --block rotor --fmi 3.0 -o rotor.fmu
    """
    common.check_target("--out", out, (".fmu",))
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    from rotorsim.fmi.export.export import export_fmu

    wanted = [name for name in platforms if name != SOURCE] if platforms else None
    done = export_fmu(
        loaded,
        out,
        blocks=blocks or None,
        version=version,
        platforms=wanted,
        arrays=arrays,
        inputs=inputs,
        outputs=outputs or None,
        fixed=fixed,
    )
    show_problems(done.warnings)
    counts = {role: done.interface.count(role) for role in ("parameter", "input", "output", "state", "event")}
    if as_json:
        common.echo_json(
            {
                "file": out,
                "fmi": version,
                "model": done.interface.identifier,
                "token": done.token,
                "blocks": list(done.interface.part.blocks),
                "step": loaded.solver.step,
                "variables": counts,
                "libraries": done.libraries,
            }
        )
        return
    click.echo(f"{out}: FMI {version}, model exchange and co-simulation, step {loaded.solver.step:g} s")
    click.echo(", ".join(f"{n} {role}{'' if n == 1 else 's'}" for role, n in counts.items()))
    lines = [[name, f"{size / 1e3:.0f} kB"] for name, size in done.libraries.items()]
    click.echo(common.table(["platform", "library"], lines) if lines else "sources only")
