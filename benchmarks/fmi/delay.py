"""A picture of what held inputs do to a magnetic bearing: the cracked Jeffcott rotor cut at its controller."""

from __future__ import annotations

import shlex
import tempfile
from contextlib import chdir

from click.testing import CliRunner
from matplotlib.figure import Figure

from rotorsim import Result, load_result
from rotorsim.cli.app import rotorsim
from rotorsim.report.style import BLUE, INK, ORANGE, RED, display, figure, styled

__all__ = ["delay_figure"]

STOP = "0.12 s"
CUT = f'cosim jeffcott --part controller --stop "{STOP}" --out cut.npz --step '
RUNS = (
    ("whole diagram", f'run jeffcott --stop "{STOP}" --out cut.npz', {"color": INK, "lw": 2.4, "alpha": 0.35}),
    ("held, 0.2 ms", f'{CUT}"0.2 ms"', {"color": BLUE, "lw": 1.1}),
    ("held, 0.7 ms", f'{CUT}"0.7 ms"', {"color": RED, "lw": 1.1}),
    ("linear, 0.7 ms", f'{CUT}"0.7 ms" --order 1', {"color": ORANGE, "lw": 1.1, "ls": "--"}),
)


def _result(command: str) -> Result:
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        ended = CliRunner().invoke(rotorsim, shlex.split(command))
        if ended.exit_code:
            raise SystemExit(f"rotorsim {command}: {ended.output}")
        return load_result("cut.npz")


def delay_figure() -> Figure:
    """Return the x displacement from rest: the whole diagram, and cut with held and with linear inputs."""
    with styled():
        made = figure(8.6, 3.4, "jeffcott, cut at its controller: an input held is an input delayed")
        axes = made.add_subplot()
        for label, command, line in RUNS:
            result = _result(command)
            x, unit = display(result["rotor.displacement[1]"], "m")
            axes.plot(1e3 * result.time, x, label=label, **line)
        axes.set(xlabel="time [ms]", ylabel=f"x [{unit}]")
        axes.margins(x=0)
        axes.legend(ncols=4, loc="lower center", fontsize=8)
        axes.set_ylim(-12, None)
    return made
