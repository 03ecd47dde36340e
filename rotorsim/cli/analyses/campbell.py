"""``rotorsim campbell``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import click

from rotorsim.cli.shared import (
    Chosen,
    diagram_options,
    json_option,
    note,
    plot_option,
    save_plot,
    show,
    speeds_of,
    warn,
    whole_numbers,
)
from rotorsim.report.text.table import rpm, table

if TYPE_CHECKING:
    from rotorsim.linear.modes.campbell import Campbell


@click.command("campbell")
@diagram_options
@click.option(
    "--speeds",
    metavar="SPEEDS",
    default="0 rpm:250 rpm:12000 rpm",
    show_default=True,
    help="start:step:stop, or a list.",
)
@click.option("--orders", metavar="LIST", default="1,2", show_default=True, help="Orders whose crossings are wanted.")
@plot_option("the Campbell diagram")
@json_option
def command(chosen: Chosen, speeds: str, orders: str, plot: str | None, as_json: bool) -> None:
    """Natural frequencies against speed, each mode followed by its shape, and the critical speeds.

    \b
    rotorsim campbell fe_rigid --without amb --speeds "0 rpm:100 rpm:6000 rpm" --plot campbell.png
    """
    range_of_speeds, multiples = speeds_of(speeds), whole_numbers("--orders", orders, "for example --orders 1,2")
    loaded = chosen.open()
    from rotorsim.linear.modes.campbell import campbell

    result = campbell(loaded, speeds=range_of_speeds, orders=multiples)

    save_plot(lambda: result.plot(loaded.name, orders=multiples), plot)
    unstable = result.speeds[~result.stable]
    if len(unstable):
        between = " .. ".join(dict.fromkeys(f"{rpm(float(speed)):.6g}" for speed in unstable[[0, -1]]))
        what = f"unstable at {len(unstable)} of {len(result.speeds)} speeds ({between} rpm): a pole grows there"
        warn(what, loaded.name, "'rotorsim modes --set speed=...' shows which; a critical speed there is never reached")
    folded = [k + 1 for k in range(len(result.resonant)) if result.resonant[k] and (result.modulo[:, k] > 0).any()]
    if folded:
        rate = f"{result.modulo[result.modulo > 0].max():.6g} Hz"
        note(f"sampled: several images of mode {', '.join(map(str, folded))} show alike; frequency modulo {rate}")
    left_out = len(result.resonant) - int(sum(result.resonant))
    if left_out and not as_json:
        note(f"{left_out} modes with a damping ratio above 0.707 at all speeds, no resonance: --json has them")
    crossings = [
        {
            "order": c.order,
            "speed": c.speed,
            "speed_rpm": rpm(c.speed),
            "frequency_hz": c.frequency_hz,
            "mode": c.mode,
            "whirl": c.whirl,
            "damping_ratio": c.damping_ratio,
            "stable": c.stable,
            "frequency_modulo_hz": c.modulo,
        }
        for c in result.crossings
    ]
    data = {
        "diagram": loaded.name,
        "speeds": result.speeds,
        "speeds_rpm": rpm(result.speeds),
        "frequency_hz": result.frequency_hz,
        "damping_ratio": result.damping_ratio,
        "whirl": result.whirl,
        "frequency_modulo_hz": result.modulo,
        "stable": result.stable,
        "critical_speeds": crossings,
    }
    show(as_json, lambda: data, lambda: _text(result))


def _text(result: Campbell) -> str:
    """Return the frequencies and the critical speeds; whether the machine is stable, where it is not everywhere."""
    shown = [k for k, resonant in enumerate(result.resonant) if resonant]
    shaky = not result.stable.all()
    last = ("machine",) if shaky else ()
    machine = {True: ("stable",) if shaky else (), False: ("unstable",) if shaky else ()}
    rows = [
        (
            f"{rpm(float(speed)):.6g}",
            *(f"{f:.4f}" if math.isfinite(f) else "-" for f in frequencies[shown]),
            *machine[bool(stable)],
        )
        for speed, frequencies, stable in zip(result.speeds, result.frequency_hz, result.stable, strict=True)
    ]
    text = table(("speed [rpm]", *(f"mode {k + 1} [Hz]" for k in shown), *last), rows)
    crossings = [
        (
            f"{c.order}X",
            f"{rpm(c.speed):.2f}",
            f"{c.frequency_hz:.4f}{c.modulo_text.removesuffix(' Hz')}",
            f"{c.damping_ratio:.5f}",
            c.whirl,
            *machine[bool(c.stable)],
        )
        for c in result.crossings
        if result.resonant[c.mode - 1]
    ]
    header = ("order", "critical speed [rpm]", "frequency [Hz]", "damping ratio", "whirl", *last)
    return f"{text}\n\n{table(header, crossings)}" if crossings else text
