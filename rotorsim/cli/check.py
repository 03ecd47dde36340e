"""``rotorsim check``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common, recorded
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram

__all__ = ["command"]


@click.command("check")
@click.argument("sources", metavar="DIAGRAM|RECORDING...", nargs=-1, required=True)
@common.set_option
@common.without_option
@common.trust_option
@common.json_option
def command(
    sources: tuple[str, ...], settings: tuple[str, ...], without: tuple[str, ...], trust_blocks: bool, as_json: bool
) -> int:
    """Find every mistake in diagrams and recordings: file:line:column, what is wrong, how to cure it.

    Of a recording (a folder with recording.json) the signals are checked as well; after a diagram, also whether the
    diagram has the signals and the parameters that it names. Exit code 2 if there is any mistake, 1 if only the
    signals of a recording have errors; warnings do not count.

    \b
    rotorsim check jeffcott measured
    """
    from rotorsim.cli.app import show_problems

    values = common.parse_settings(settings)
    kinds = {source: recorded.is_recording(source) for source in sources}
    if (settings or without) and all(kinds.values()):
        raise RotorsimError(Problem(what="--set and --without need a diagram, not a recording", subject=sources[0]))
    report: dict[str, list[dict[str, Any]]] = {"diagrams": [], "recordings": []}
    mistakes = code = 0
    against: Diagram | None = None
    for source in sources:
        if kinds[source]:
            entry, problems, found, line = _recording(source, against)
        else:
            against, (entry, problems, found, line) = _diagram(source, values, without, trust_blocks)
        code = max(code, found)
        mistakes += sum(problem.severity == "error" for problem in problems)
        report["recordings" if kinds[source] else "diagrams"].append(entry)
        show_problems(problems)
        if not found and not as_json:
            click.echo(f"{source}: {line}, no mistakes")
    if as_json:
        common.echo_json({key: entries for key, entries in report.items() if entries})
    if mistakes:
        common.note(f"\n{mistakes} mistake{'s' if mistakes > 1 else ''}")
    return code


Found = tuple[dict[str, Any], Sequence[Problem], int, str]


def _diagram(
    name: str, settings: Mapping[str, Any], without: Sequence[str], trust_blocks: bool
) -> tuple[Diagram | None, Found]:
    """Return a diagram, and its entry for --json, its problems, the exit code and what it holds."""
    from rotorsim.cli.app import problem_data
    from rotorsim.model.load import load

    entry: dict[str, Any] = {"diagram": name, "valid": True}
    loaded = None
    try:
        loaded = load(name, set=settings, without=without, trust_blocks=trust_blocks)
        problems, code = loaded.warnings, 0
        entry |= {"blocks": len(loaded.nodes), "wires": len(loaded.wires)}
    except RotorsimError as error:
        problems, code = error.problems, 2
        entry["valid"] = False
    entry["problems"] = [problem_data(problem) for problem in problems]
    return loaded, (entry, problems, code, "" if code else f"{entry['blocks']} blocks, {entry['wires']} wires")


def _recording(name: str, against: Diagram | None) -> Found:
    """Return the same of a recording; its signals are looked at when its files can be read.

    against: the diagram whose signals and parameters it names.
    """
    from rotorsim.cli.app import problem_data
    from rotorsim.measure.checks import check_signals
    from rotorsim.recordings.loading import load_recording
    from rotorsim.signals.pickup import check_harmonics

    entry: dict[str, Any] = {"recording": name, "valid": True}
    line = ""
    try:
        recording = load_recording(name)
        problems = (*recording.warnings, *check_signals(recording))
        code = 1 if any(problem.severity == "error" for problem in problems) else 0
        if not code:
            problems = (*problems, *check_harmonics(recording))
        if against is not None:
            from rotorsim.identification.experiment import check_against

            foreign = check_against(against, recording)
            problems, code = (*problems, *foreign), 2 if foreign else code
        entry |= recorded.contents(recording)
        line = recorded.contents_line(recording)
    except RotorsimError as error:
        problems, code = error.problems, error.exit_code
    entry["valid"] = code == 0
    entry["problems"] = [problem_data(problem) for problem in problems]
    return entry, problems, code, line
