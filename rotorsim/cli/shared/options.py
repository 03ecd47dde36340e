"""Options that several verbs have, and groups of verbs."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import click

from rotorsim.cli.shared.inputs import Chosen, check_target
from rotorsim.diagram.solver import SOLVER_METHODS
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.units import AMPLITUDE_KINDS

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

RESULTS = (".csv", ".h5", ".npz")
FIGURES = (".png", ".svg", ".pdf")
NOISE_KINDS = ("white", "thesis", "uniform")  # `measure.record.KINDS`, which takes SciPy to import

json_option = click.option("--json", "as_json", is_flag=True, help="Print machine-readable JSON.")
progress_option = click.option(
    "--progress/--no-progress", default=None, help="Show progress on stderr (default: only on a terminal)."
)
diagram_argument = click.argument("diagram", metavar="DIAGRAM")
recording_argument = click.argument("recording", metavar="RECORDING")
set_option = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="Give a parameter another value: speed='3000 rpm', controller.KP=14000, controller.KD[2]=5; repeatable.",
)
without_option = click.option(
    "--without", multiple=True, metavar="BLOCK", help="Cut the wires of this block (no crack, no AMB, ...); repeatable."
)
trust_option = click.option(
    "--trust-blocks",
    is_flag=True,
    help="Run what the diagram brings along, block files in its folders and its FMUs: they are code.",
)
hold_out_option = click.option("--hold-out", metavar="RECORDING", help="Further runs, on which the fit is only scored.")
measured_input_option = click.option(
    "--measured-input",
    "given",
    multiple=True,
    metavar="PORT",
    help="Take this port as it was measured; what makes it need not be right.",
)
fmi_option = click.option(
    "--fmi",
    "version",
    type=click.Choice(["2.0", "3.0"]),
    default="2.0",
    help="Version of FMI [2.0]; 3.0 makes a system SSP 2.0.",
)
platform_option = click.option(
    "--platform",
    "platforms",
    multiple=True,
    metavar="NAME",
    help="linux64, aarch64-linux, win64, darwin64, aarch64-darwin, ... or source (no library); repeatable. "
    "Default: this machine's. Others need ziglang.",
)


def _together(*options: Decorator) -> Decorator:
    """Return a decorator that adds several options, the first one first."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


def _chosen(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give a verb its diagram with --set, --without and --trust-blocks as one `Chosen`."""

    @wraps(function)
    def call(
        diagram: str, settings: tuple[str, ...], trust_blocks: bool, without: tuple[str, ...] = (), **others: Any
    ) -> Any:
        return function(Chosen(diagram, settings, without, trust_blocks), **others)

    return call


given_options = _together(set_option, without_option, trust_option, _chosen)
diagram_options = _together(diagram_argument, given_options)
parameter_options = _together(set_option, trust_option, _chosen)


def _show_amplitudes(context: click.Context, parameter: click.Parameter, shown: str) -> None:
    """Show amplitudes as asked for until the verb ends."""
    from rotorsim.report.amplitudes import amplitudes

    context.with_resource(amplitudes(shown))


amplitude_option = click.option(
    "--amplitude",
    type=click.Choice(list(AMPLITUDE_KINDS)),
    default="0-peak",
    show_default=True,
    expose_value=False,
    callback=_show_amplitudes,
    help="How figures and tables show amplitudes of sinusoids; --json stays 0-peak, in SI.",
)
jobs_options = _together(
    click.option("--workers", type=click.IntRange(1), metavar="N", help="Processes (default: one for every CPU)."),
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask cluster that you trust to run code here, tls://host:port or tcp://host:port (default: none).",
    ),
)


def file_option(*names: str, suffixes: tuple[str, ...], help: str, **more: Any) -> Decorator:
    """Return the option of a file that is written; one that cannot be is refused before the work is done."""

    def checked(context: click.Context, parameter: click.Parameter, file: str | None) -> str | None:
        check_target(parameter.opts[-1], file, suffixes)
        return file

    return click.option(*names, callback=checked, help=help, **{"metavar": "FILE", **more})


def plot_option(what: str) -> Decorator:
    """Return --plot; what: is drawn."""
    return file_option("--plot", suffixes=FIGURES, help=f"Draw {what}: .png, .svg or .pdf.")


def solver_option(help: str, **more: Any) -> Decorator:
    """Return --solver."""
    return click.option("--solver", type=click.Choice(SOLVER_METHODS, case_sensitive=False), help=help, **more)


def noise_kind_option(name: str, help: str, **more: Any) -> Decorator:
    """Return --noise-kind under the name of its parameter."""
    return click.option("--noise-kind", name, type=click.Choice(NOISE_KINDS), help=help, **more)


def show_help(context: click.Context) -> None:
    """Print the help of a group that is called without a verb."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


class Group(click.Group):
    """Verb with verbs of its own, which knows near misses of them."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        verbs = self.list_commands(ctx)
        if args and not args[0].startswith("-") and args[0] not in verbs:
            raise RotorsimError(Problem(f"unknown verb '{self.name} {args[0]}'", hint=near_miss(args[0], verbs)))
        return super().resolve_command(ctx, args)
