"""``rotorsim frequency``."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from rotorsim.cli.shared import Chosen, band_of, diagram_options, json_option, note, plot_option, save_plot, show, warn

if TYPE_CHECKING:
    from rotorsim.linear.control.frequency import FrequencyResponse

SHOWN_PEAKS = 6  # of an entry, the largest
NO_RESPONSE = 1e-9  # of the largest: rounding


@click.command("frequency")
@diagram_options
@click.option(
    "--from", "source", required=True, metavar="PORT", help="Where a test signal is added; or a part, amb.force[1]."
)
@click.option("--to", "signal", required=True, metavar="SIGNAL", help="The signal whose response is wanted.")
@click.option("--range", "span", default="0.1 Hz:2000 Hz", show_default=True, metavar="LOW:HIGH", help="Frequencies.")
@click.option("--open", "open_loop", is_flag=True, help="Open the loop at the port: the signal replaces its value.")
@plot_option("magnitude and phase")
@json_option
def command(
    chosen: Chosen, source: str, signal: str, span: str, open_loop: bool, plot: str | None, as_json: bool
) -> None:
    """Frequency response from a port to a signal, and its peaks.

    The test signal is added to the value of an output port, or to what arrives at an input port; the loops stay closed.
    Magnitudes are of the output's amplitude for an input of amplitude 1, SI; sampled blocks are treated exactly.

    \b
    rotorsim frequency jeffcott --from unbalance.force --to rotor.displacement --plot bode.png
    rotorsim frequency fe_rigid --from amb.force --to "rotor.displacement[3]" --range "10 Hz:500 Hz"
    rotorsim frequency jeffcott --from controller.current --to controller.current --open
    """
    ends = band_of(span, "--range")
    loaded = chosen.open()
    from rotorsim.linear.control.frequency import frequency_response

    found = frequency_response(loaded, source, signal, span=ends, open_loop=open_loop)
    for text in found.notes:
        note(text)
    if not found.stable:
        warn("not stable: the machine never settles to this response", loaded.name, "'rotorsim modes' shows what grows")
    drawn = f"{signal} / {source}, {loaded.name}{', loop opened there' if open_loop else ''}"
    save_plot(lambda: found.plot(drawn), plot)
    show(as_json, lambda: _data(found, loaded.name, open_loop), lambda: _text(found))


def _text(found: FrequencyResponse) -> str:
    """Return the peaks of every entry that is not zero."""
    from rotorsim.report.text.table import degrees, table

    rows = []
    largest = float(np.abs(found.value).max())
    for (o, output), (i, given) in ((a, b) for a in enumerate(found.outputs) for b in enumerate(found.inputs)):
        size = np.abs(found.value[:, o, i])
        if size.max() <= NO_RESPONSE * largest:
            continue
        own = [peak for peak in found.peaks if (peak.output, peak.input) == (output, given)]
        own = sorted(sorted(own, key=lambda peak: -abs(peak.value))[:SHOWN_PEAKS], key=lambda peak: peak.frequency)
        for peak in own:
            number = f"{abs(peak.value):.5g} {found.units[o][i]}"
            rows.append((given, output, f"{peak.frequency:.5g}", number, f"{degrees(peak.value):.1f}"))
        if not own:
            rows.append((given, output, "no peak", f"{size.max():.5g} {found.units[o][i]} at most", ""))
    if not rows:
        return "no response: nothing of this port reaches the signal"
    return table(("from", "to", "peak at [Hz]", "0-peak per 0-peak", "phase [deg]"), rows)


def _data(found: FrequencyResponse, diagram: str, open_loop: bool) -> dict[str, Any]:
    return {
        "diagram": diagram,
        "open_loop": open_loop,
        "stable": found.stable,
        "inputs": found.inputs,
        "outputs": found.outputs,
        "units": found.units,
        "peaks": [asdict(peak) for peak in found.peaks],
        "frequencies": found.frequencies,
        "response": found.value,
        "notes": found.notes,
    }
