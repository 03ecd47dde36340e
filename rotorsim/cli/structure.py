"""``rotorsim diagnose DIAGRAM --sensors``: which faults sensors detect and isolate, before anything is measured."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import TYPE_CHECKING

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram

__all__ = ["show_isolation"]


def show_isolation(
    diagram: Diagram,
    sensors: str,
    speeds: str | None,
    *,
    physics: Collection[str] | None = None,
    trust_blocks: bool,
    progress: bool | None,
    as_json: bool,
) -> None:
    """Print which faults of a diagram are isolable with sensors ("rotor.displacement[3],controller.current").

    physics: only these faults (default: all).
    """
    from rotorsim.diagnosis.isolability.isolation import isolate, isolation_data
    from rotorsim.report.text.isolability import isolability_text

    wanted = list(dict.fromkeys(name.strip() for name in re.split(r",(?![^\[]*\])", sensors) if name.strip()))
    at = [] if speeds is None else [float(speed) for speed in common.speeds_of(speeds)]
    if 0 in at:
        raise RotorsimError(Problem(f"--speeds {speeds}: the shaft does not turn", hint="leave 0 out"))
    with common.progress_bar("signatures", progress) as show:
        isolation = isolate(diagram, wanted, speeds=at, physics=physics, trust_blocks=trust_blocks, progress=show)
    if as_json:
        common.echo_json(isolation_data(isolation))
    else:
        click.echo(isolability_text(isolation))
