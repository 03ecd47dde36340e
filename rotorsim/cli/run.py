"""``rotorsim run``."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rotorsim.simulate.result import Result

__all__ = ["command"]

METHODS = ("rk4", "dop853", "rk45", "radau", "bdf", "lsoda")


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
) -> None:
    """Simulate a diagram; write, plot and summarise the recorded signals.

    Prints the peak of every recorded signal and, at constant speed, the harmonics of two-axis signals.

    \b
    rotorsim run jeffcott --plot jeffcott.png
    rotorsim run diagrams/jeffcott.json --set "speed=1800 rpm" --stop "8 s" --out run.csv
    """
    common.check_target("--out", out, (".csv", ".h5", ".npz"))
    common.check_target("--plot", plot, (".png", ".svg", ".pdf"))
    times = {name: common.quantity(text, "s", f"--{name}") for name, text in (("step", step), ("stop", stop)) if text}
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)

    from rotorsim.simulate.run import simulate

    signals = [*map(str, loaded.record), *(name for name in record if name not in set(map(str, loaded.record)))]
    with common.progress_bar(loaded.name, progress) as show:
        # With a function to call, the run is cut into pieces, so that Ctrl-C is heard between them.
        result = simulate(
            loaded, **times, method=solver, record=signals, use_compiler=not no_compiler, progress=show or _silent
        )
    _report(result, out, plot, as_json)


def _silent(fraction: float) -> None:
    """Take the place of a progress bar."""


def _report(result: Result, out: str | None, plot: str | None, as_json: bool) -> None:
    raise NotImplementedError
