"""``rotorsim accept``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    Chosen,
    check_folder,
    gathered,
    given_options,
    is_recording,
    json_option,
    note,
    quantity,
    refuse_all,
    refuse_if,
    show,
    show_problems,
    span_of,
)
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.recordings.orders import OrderRecording
    from rotorsim.recordings.recording import Recording

ACCEPTED_ZONES = ("A", "B")  # of rotorsim.acceptance.conditions
INJECTION, ORDERS = "injection", "orders"  # kinds of recording.json


@click.command("accept")
@click.argument("diagram", metavar="DIAGRAM|RECORDING")
@click.argument("recordings", metavar="[RECORDING]...", nargs=-1)
@given_options
@click.option("--operating", metavar="LOW:HIGH", help="Operating speeds (default: the diagram's own speed).")
@click.option("--trip", metavar="SPEED", help="Trip speed (default: 1.05 times the largest operating speed).")
@click.option(
    "--clearance",
    "clearances",
    multiple=True,
    metavar="[SIGNAL=]LENGTH",
    help="Least radial clearance at all probes, or at a signal such as rotor.displacement[4]; repeatable.",
)
@click.option(
    "--unbalance",
    "planes",
    multiple=True,
    metavar="PLANE",
    help="Where unbalance may be, such as rotor.force[4] (default: where blocks 'unbalance' act); repeatable.",
)
@click.option("--mass", metavar="MASS", help="Mass of the rotor (default: from its equations).")
@click.option(
    "--zone", type=click.Choice(ACCEPTED_ZONES), default="A", show_default=True, help="Worst zone of ISO 14839."
)
@click.option(
    "--cross-coupling",
    "couplings",
    multiple=True,
    metavar="PLANE=STIFFNESS",
    help="Anticipated cross-coupled stiffness of seals or impellers in a plane; repeatable.",
)
@click.option("--out", metavar="DIR", help="Write report.html, its figures as PNG, and acceptance.json there.")
@json_option
def command(
    chosen: Chosen,
    recordings: tuple[str, ...],
    operating: str | None,
    trip: str | None,
    clearances: tuple[str, ...],
    planes: tuple[str, ...],
    mass: str | None,
    zone: str,
    couplings: tuple[str, ...],
    out: str | None,
    as_json: bool,
) -> int:
    """Judge a machine by ISO 14839-2 and -3 and by API 617: number, limit, clause and verdict of each requirement.

    Of DIAGRAM: displacement against the clearance, stability margins, response to unbalance with critical speeds and
    separation margins, damping, critical speed map, mode shapes. Of each RECORDING what its kind tells: displacement
    and vibration, run-ups, injected sweeps. Verdicts in brackets are advice. Exit code 1: not all is met, or judged.

    \b
    rotorsim accept two_amb_rotor --operating "1200 rpm:1620 rpm" --clearance "0.2 mm" --out acceptance
    rotorsim accept jeffcott sweep runup --operating "2000 rpm:3000 rpm" --clearance "0.2 mm"
    """
    check_folder("--out", out)
    given = gathered(
        operating=lambda: None if operating is None else span_of(operating, "--operating"),
        trip=lambda: None if trip is None else quantity(trip, "rad/s", "--trip"),
        clearance=lambda: _by_place(clearances, "m", "--clearance", "0.2 mm", "rotor.displacement[4]", bare=True),
        mass=lambda: None if mass is None else quantity(mass, "kg", "--mass"),
        cross_coupling=lambda: _by_place(couplings, "N/m", "--cross-coupling", "1e6 N/m", "rotor.force[4]", bare=False),
    )
    names = [chosen.name, *recordings]
    alone = is_recording(chosen.name)
    if alone:
        chosen.refuse_changes("a recording")
        refuse_if(planes or mass or couplings, "--unbalance, --mass and --cross-coupling need a diagram", chosen.name)
    hint = "DIAGRAM is given once, before the recordings; `rotorsim check` says what is wrong with a recording"
    refuse_all([Problem("not a recording", name, hint=hint) for name in recordings if not is_recording(name)])
    measured = [_measured(name) for name in (names if alone else recordings)]
    from rotorsim.acceptance.acceptance import accept
    from rotorsim.report.text.acceptance import acceptance_data, acceptance_text

    result = accept(None if alone else chosen.open(), measured, planes=planes, zone=zone, **given)
    for text in result.conditions.notes:
        note(text)
    if out is not None:
        from rotorsim.report.acceptance.report import save_acceptance

        files = save_acceptance(result, out, measured)
        note(f"wrote {files[0]} and {len(files) - 1} files beside it")
    show(as_json, lambda: acceptance_data(result), lambda: acceptance_text(result))
    return 0 if result.verdict == "met" else 1


def _by_place(
    texts: tuple[str, ...], unit: str, option: str, value: str, place: str, *, bare: bool
) -> dict[str, float] | None:
    """Return ``[PLACE=]VALUE`` texts as a mapping, "" for all places; None for none. Raises RotorsimError."""
    found: dict[str, float] = {}
    problems: list[Problem] = []
    hint = f"for example {option} '{place}={value}'" + (f" or {option} '{value}'" if bare else "")
    form = "[SIGNAL=]LENGTH" if bare else "PLANE=STIFFNESS"
    for text in texts:
        name, equals, amount = (part.strip() for part in text.rpartition("="))
        if not amount or bool(equals) != bool(name) or not (name or bare):
            problems.append(Problem(f"{option} {text}: not {form}", hint=hint))
        elif name in found:
            problems.append(Problem(f"{option} {text}: {name or 'all places'} twice", hint="give each place once"))
        else:
            try:
                found[name] = quantity(amount, unit, option)
            except RotorsimError as error:
                problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    return found or None


def _measured(name: str) -> Recording | OrderRecording:
    """Return a recording of any kind."""
    from rotorsim.recordings.document import recording_kind
    from rotorsim.recordings.injection import load_injection
    from rotorsim.recordings.loading import load_recording
    from rotorsim.recordings.orders import load_orders

    kind = recording_kind(name)
    loaders: dict[str, Any] = {INJECTION: load_injection, ORDERS: load_orders}
    recording: Recording | OrderRecording = loaders.get(kind, load_recording)(Path(name))
    show_problems(recording.warnings)
    return recording
