"""``rotorsim margins``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    Chosen,
    given_options,
    is_recording,
    json_option,
    known_names,
    note,
    plot_option,
    refuse_if,
    save_plot,
    show,
    show_problems,
)

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.linear.control.margins import Margins
    from rotorsim.signals.injection.measured_margins import MeasuredMargins


@click.command("margins")
@click.argument("diagram", metavar="RECORDING|DIAGRAM")
@given_options
@click.option(
    "--at",
    "ports",
    multiple=True,
    metavar="PORT",
    help="Where it is injected, or a part of it (default: input 'displacement' of every controller); repeatable.",
)
@click.option("--run", "runs", multiple=True, metavar="ID", help="Run of a recording (default: all); repeatable.")
@click.option("--beside", metavar="DIAGRAM", help="Model of what was recorded, at its speed and settings.")
@plot_option("sensitivity over the zones, and the open loop")
@json_option
def command(
    chosen: Chosen, ports: tuple[str, ...], runs: tuple[str, ...], beside: str | None, plot: str | None, as_json: bool
) -> None:
    """Sensitivity, gain and phase margins of every bearing axis, and their zones after ISO 14839-3.

    Of DIAGRAM: a test signal is added to the sensor's signal, or at the output of a controller, of one axis after the
    other, the loops of the others closed; sampled controllers exactly. Of RECORDING, of kind "injection": the same as
    measured, with 90 % intervals.

    \b
    rotorsim margins jeffcott --plot margins.png
    rotorsim margins two_amb_rotor --set "speed=6000 rpm" --at controller_a.current
    rotorsim margins swept --beside jeffcott --plot margins.png
    """
    if is_recording(chosen.name):
        chosen.refuse_changes("a recording")
        refuse_if(ports, "--at: recording.json says where it was injected", chosen.name)
        _of_recording(chosen, runs, beside, plot, as_json)
        return
    loaded = chosen.open()
    refuse_if(runs or beside, "--run and --beside need a recording, not a diagram", chosen.name)
    from rotorsim.linear.control.margins import margins
    from rotorsim.linear.linearisation import speed_of
    from rotorsim.model.compiled import model_for_runs
    from rotorsim.report.text.margins import margins_data, margins_text

    model = model_for_runs(loaded)
    result = margins(model, ports)
    for text in result.notes:
        note(text)
    save_plot(lambda: result.plot(f"Margins of {loaded.name}"), plot)
    speed = speed_of(model, model.p0)
    show(as_json, lambda: margins_data(result, loaded.name, speed), lambda: margins_text(result))


def _of_recording(chosen: Chosen, runs: Sequence[str], beside: str | None, plot: str | None, as_json: bool) -> None:
    """Say what a recording shows, beside a diagram."""
    from rotorsim.recordings.injection import load_injection
    from rotorsim.report.text.margins import margins_data, measured_data, measured_text
    from rotorsim.signals.injection.measured_margins import measured_margins

    recording = load_injection(chosen.name)
    show_problems(recording.warnings)
    ids = known_names(
        runs, [run.id for run in recording.runs], lambda name: f"--run {name}: no such run in {recording.name}"
    )
    every = measured_margins(recording, ids)
    if plot:
        hint = f"--run {every[0].runs[0]}, for example"
        refuse_if(len(every) > 1, f"--plot draws one condition, {chosen.name} has {len(every)}", hint=hint)
    pairs = [(one, None if beside is None else _modelled(beside, chosen.trust_blocks, one)) for one in every]
    for measured, modelled in pairs:
        for text in (*measured.notes, *(modelled.notes if modelled else ())):
            note(text)
    measured, modelled = pairs[0]
    save_plot(
        lambda: measured.plot(f"Margins of {recording.name}, {', '.join(measured.runs)}", modelled=modelled), plot
    )

    def data() -> dict[str, Any]:
        of_diagram = [None if own is None else margins_data(own, beside or "", one.speed) for one, own in pairs]
        return measured_data(every, of_diagram)

    show(as_json, data, lambda: "\n\n\n".join(measured_text(one, own, beside or "") for one, own in pairs))


def _modelled(diagram: str, trust_blocks: bool, measured: MeasuredMargins) -> Margins:
    """Return the margins of a diagram at the speed and with the settings of what was measured."""
    from rotorsim.linear.control.margins import margins
    from rotorsim.model.load import load
    from rotorsim.recordings.injection import port_of

    loaded = load(diagram, set=measured.settings, trust_blocks=trust_blocks)
    show_problems(loaded.warnings)
    found = margins(loaded, [port_of(axis.name) for axis in measured.axes], parameters=_speed(loaded, measured))
    known = [axis.name for axis in found.axes]
    missing = [axis.name for axis in measured.axes if axis.name not in known]
    refuse_if(
        missing, f"{diagram} has no {', '.join(missing)}", f"--beside {diagram}", hint=f"it has {', '.join(known)}"
    )
    return found


def _speed(diagram: Diagram, measured: MeasuredMargins) -> dict[str, float]:
    """Return the speed that was measured as a parameter of a diagram that has one."""
    if measured.speed is None:
        note(f"{', '.join(measured.runs)}: speed not known; {diagram.name} turns as it stands there")
        return {}
    return {"speed": measured.speed} if "speed" in diagram.parameters else {}
