"""``rotorsim check``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    Chosen,
    echo_json,
    is_recording,
    json_option,
    note_mistakes,
    parse_settings,
    problem_data,
    refuse_all,
    set_option,
    show_problems,
    trust_option,
    without_option,
)
from rotorsim.errors import Problem, RotorsimError, near_miss

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.recordings.orders import OrderRecording

# Of recordings for identification: loops may be at rest, are injected at one by one, and are repeated.
OF_ROTATION = ("missing_channel", "no_phase_reference", "swapped_axes", "constant_signal", "two_runs_alike")
Found = tuple[dict[str, Any], Sequence[Problem], int, str]  # entry for --json, problems, exit code, what it holds


@click.command("check")
@click.argument("sources", metavar="DIAGRAM|RECORDING...", nargs=-1, required=True)
@set_option
@without_option
@trust_option
@json_option
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
    chosen = Chosen(sources[0], settings, without, trust_blocks)
    parse_settings(settings)
    if all(map(is_recording, sources)):
        chosen.refuse_changes("a recording")
    report: dict[str, list[dict[str, Any]]] = {"diagrams": [], "recordings": []}
    mistakes = code = 0
    against: Diagram | None = None
    for source in sources:
        if is_recording(source):
            kind, (entry, problems, found, line) = "recordings", _recording(source, against)
        else:
            kind, (against, (entry, problems, found, line)) = "diagrams", _diagram(replace(chosen, name=source))
        report[kind].append({**entry, "valid": found == 0, "problems": [problem_data(problem) for problem in problems]})
        code = max(code, found)
        mistakes += sum(problem.severity == "error" for problem in problems)
        show_problems(problems)
        if not found and not as_json:
            click.echo(f"{source}: {line}, no mistakes")
    if as_json:
        echo_json({key: entries for key, entries in report.items() if entries})
    note_mistakes(mistakes)
    return code


def _diagram(chosen: Chosen) -> tuple[Diagram | None, Found]:
    """Return a diagram, and what is found in it."""
    from rotorsim.model.load import load

    entry: dict[str, Any] = {"diagram": chosen.name, "valid": False}
    try:
        values = parse_settings(chosen.settings)
        loaded = load(chosen.name, set=values, without=chosen.without, trust_blocks=chosen.trust_blocks)
    except RotorsimError as error:
        return None, (entry, error.problems, 2, "")
    entry |= {"blocks": len(loaded.nodes), "wires": len(loaded.wires)}
    return loaded, (entry, loaded.warnings, 0, f"{entry['blocks']} blocks, {entry['wires']} wires")


def _recording(name: str, against: Diagram | None) -> Found:
    """Return the same of a recording; its signals are looked at when its files can be read.

    against: the diagram whose signals and parameters it names.
    """
    from rotorsim.measure.checks import check_signals
    from rotorsim.recordings.document import recording_kind
    from rotorsim.recordings.orders import OrderRecording, load_any
    from rotorsim.report.text.recording import contents, contents_line
    from rotorsim.signals.pickup import check_harmonics

    entry: dict[str, Any] = {"recording": name, "valid": False}
    try:
        if recording_kind(name) == "injection":
            return _injection(entry, name, against)
        recording = load_any(name)
        if isinstance(recording, OrderRecording):
            return _orders(entry, recording, against)
        problems = [*recording.warnings, *check_signals(recording)]
        code = int(any(problem.severity == "error" for problem in problems))
        problems += [] if code else check_harmonics(recording)
        if against is not None:
            from rotorsim.identification.harmonic.experiment import check_against

            foreign = check_against(against, recording)
            problems, code = [*problems, *foreign], 2 if foreign else code
    except RotorsimError as error:
        return entry, error.problems, error.exit_code, ""
    held = contents(recording)
    return entry | held, problems, code, contents_line(held)


def _injection(entry: dict[str, Any], name: str, against: Diagram | None) -> Found:
    """Return the same of a recording of an injected test signal. Raises RotorsimError for ports a diagram has not."""
    from rotorsim.linear.loop import injections
    from rotorsim.measure.checks import check_signals
    from rotorsim.recordings.injection import load_injection, port_of
    from rotorsim.report.text.table import counted

    recording = load_injection(name)
    if against is not None:
        known = [one.name for one in injections(against, list(dict.fromkeys(map(port_of, recording.loops))))]
        refuse_all(
            [
                Problem("no such entry", name, hint=near_miss(name, known))
                for name in recording.loops
                if name not in known
            ]
        )
    found = [*recording.warnings, *check_signals(recording)]
    problems = [one for one in found if one.severity == "error" or one.code not in OF_ROTATION]
    entry |= {"kind": "injection", "axes": len(recording.loops), "runs": len(recording.runs)}
    axes = "1 axis" if entry["axes"] == 1 else f"{entry['axes']} axes"
    line = f"injection at {axes}, {counted(entry['runs'], 'run')}"
    return entry, problems, int(any(problem.severity == "error" for problem in problems)), line


def _orders(entry: dict[str, Any], recording: OrderRecording, against: Diagram | None) -> Found:
    """Return the same of a recording of orders over the speed. Raises RotorsimError for what a diagram has not."""
    from rotorsim.identification.waveform.order_tracking import tracked_orders
    from rotorsim.measure.order_vectors import check_vectors
    from rotorsim.report.text.table import counted

    if against is not None:
        tracked_orders(against, recording, recording.runs, against.free)
    entry |= {"kind": "orders", "channels": len(recording.channels), "runs": len(recording.runs)}
    entry["rows"] = sum(len(run.speed) for run in recording.runs)
    line = ", ".join(counted(entry[f"{one}s"], one) for one in ("channel", "run", "row"))
    return entry, (*recording.warnings, *check_vectors(recording)), 0, f"orders of {line}"
