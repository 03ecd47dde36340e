"""``rotorsim check``."""

from __future__ import annotations

from typing import Any

import click

from rotorsim.cli import common
from rotorsim.errors import RotorsimError

__all__ = ["command"]


@click.command("check")
@click.argument("diagrams", metavar="DIAGRAM...", nargs=-1, required=True)
@common.set_option
@common.without_option
@common.trust_option
@common.json_option
def command(
    diagrams: tuple[str, ...], settings: tuple[str, ...], without: tuple[str, ...], trust_blocks: bool, as_json: bool
) -> int:
    """Find every mistake in diagrams: file:line:column, what is wrong, how to cure it.

    Exit code 2 if there is any mistake; warnings do not count.
    """
    from rotorsim.cli.app import problem_data, show_problems
    from rotorsim.diagram.load import load

    values = common.parse_settings(settings)
    report: list[dict[str, Any]] = []
    mistakes = 0
    for name in diagrams:
        entry: dict[str, Any] = {"diagram": name, "valid": True}
        try:
            loaded = load(name, set=values, without=without, trust_blocks=trust_blocks)
            problems = loaded.warnings
            entry |= {"blocks": len(loaded.nodes), "wires": len(loaded.wires)}
        except RotorsimError as error:
            problems = error.problems
            entry["valid"] = False
            mistakes += sum(problem.severity == "error" for problem in problems)
        entry["problems"] = [problem_data(problem) for problem in problems]
        report.append(entry)
        show_problems(problems)
        if entry["valid"] and not as_json:
            click.echo(f"{name}: {entry['blocks']} blocks, {entry['wires']} wires, no mistakes")
    if as_json:
        common.echo_json({"diagrams": report})
    if mistakes:
        common.note(f"\n{mistakes} mistake{'s' if mistakes > 1 else ''}")
    return 0 if all(entry["valid"] for entry in report) else 2
