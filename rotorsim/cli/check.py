"""``rotorsim check``."""

from __future__ import annotations

from typing import Any

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

__all__ = ["command"]


@click.command("check")
@click.argument("diagrams", metavar="DIAGRAM...", nargs=-1, required=True)
@click.option("--trust-blocks", is_flag=True, help="Load the block files in the folders that the diagrams name.")
@common.json_option
def command(diagrams: tuple[str, ...], trust_blocks: bool, as_json: bool) -> None:
    """Find every mistake in diagrams; exit code 2 if there is one."""
    from rotorsim.cli.app import problem_data, show_problems
    from rotorsim.diagram.load import load

    mistakes: list[Problem] = []
    report: list[dict[str, Any]] = []
    for name in diagrams:
        try:
            found = load(name, trust_blocks=trust_blocks)
            problems: tuple[Problem, ...] = found.warnings
            summary = {"blocks": len(found.nodes), "wires": len(found.wires)}
        except RotorsimError as error:
            problems, summary = error.problems, {}
            mistakes += [problem for problem in problems if problem.severity == "error"]
        report.append({"diagram": name, **summary, "problems": [problem_data(problem) for problem in problems]})
        if not as_json:
            show_problems(problems)
            if summary:
                click.echo(f"{name}: {summary['blocks']} blocks, {summary['wires']} wires: fine")
    if as_json:
        common.echo_json({"diagrams": report})
    if mistakes:
        word = "mistake" if len(mistakes) == 1 else "mistakes"
        common.note(f"{len(mistakes)} {word}")
        raise click.exceptions.Exit(2)
