"""``rotorsim step``."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    Chosen,
    diagram_options,
    json_option,
    note,
    plot_option,
    quantity,
    refuse_if,
    save_plot,
    show,
    warn,
)

if TYPE_CHECKING:
    from rotorsim.linear.control.step_response import StepResponse
ZERO_FINAL = 1e-6  # of the largest value: what integral action makes zero, but for rounding


@click.command("step")
@diagram_options
@click.option(
    "--from", "source", required=True, metavar="PORT", help="Where a step of 1 (SI) is added; or a part of it."
)
@click.option("--to", "signal", required=True, metavar="SIGNAL", help="The signal whose response is wanted.")
@click.option("--stop", metavar="TIME", help="Length (default: six time constants of the slowest pole).")
@plot_option("the response over time")
@json_option
def command(chosen: Chosen, source: str, signal: str, stop: str | None, plot: str | None, as_json: bool) -> None:
    """Response of a signal to a step at a port: final value, overshoot, rise and settling time.

    The step is added to the value of an output port, or to what arrives at an input port; the loops stay closed. It is
    that of the diagram linear about its operating point; sampled blocks are treated exactly, and see the step at a hit.

    \b
    rotorsim step jeffcott --from amb.force --to rotor.displacement --stop "0.1 s" --plot step.png
    """
    end = None if stop is None else quantity(stop, "s", "--stop")
    refuse_if(end is not None and end <= 0, f"--stop {stop}: not a length", hint="for example --stop '0.1 s'")
    loaded = chosen.open()
    from rotorsim.linear.control.step_response import step_response

    found = step_response(loaded, source, signal, stop=end)
    for text in found.notes:
        note(text)
    if not found.stable:
        warn("not stable: there is no final value", loaded.name, "'rotorsim modes' shows what grows")
    save_plot(lambda: found.plot(f"{signal} after a step at {source}, {loaded.name}"), plot)
    show(as_json, lambda: _data(found, loaded.name), lambda: _text(found))


def _text(found: StepResponse) -> str:
    """Return the numbers of every entry that is not zero."""
    from rotorsim.report.text.table import table

    largest = max(abs(one.largest) for one in found.numbers)
    rows = []
    for one, (above, below) in zip(found.numbers, found.units, strict=True):
        if abs(one.largest) > 1e-9 * largest:
            unit = (
                above if below == "1" else f"{above}/({below})" if any(c in below for c in " /") else f"{above}/{below}"
            )
            final = f"{one.final:.5g} {unit}" if isfinite(one.final) else "-"
            if abs(one.final) <= ZERO_FINAL * abs(one.largest):
                final = f"0 {unit}"
            rows.append(
                (
                    one.input,
                    one.output,
                    final,
                    f"{one.largest:.5g} {unit}",
                    f"{1e3 * one.at:.4g}",
                    f"{100 * one.overshoot:.3g} %" if isfinite(one.overshoot) else "-",
                    f"{1e3 * one.rise:.4g}" if isfinite(one.rise) else "-",
                    f"{1e3 * one.settling:.4g}" if isfinite(one.settling) else "-",
                )
            )
    if not rows:
        return "no response: nothing of this port reaches the signal"
    header = ("from", "to", "final", "largest", "at [ms]", "overshoot", "rise [ms]", "settled 2 % [ms]")
    return table(header, rows, left=(0, 1))


def _data(found: StepResponse, diagram: str) -> dict[str, Any]:
    return {
        "diagram": diagram,
        "stable": found.stable,
        "time": found.time,
        "outputs": found.outputs,
        "inputs": found.inputs,
        "value": found.value,
        "numbers": [asdict(one) for one in found.numbers],
    }
