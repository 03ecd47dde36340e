"""``rotorsim periodic``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import click

from rotorsim.cli.shared import (
    Chosen,
    amplitude_option,
    diagram_options,
    json_option,
    note,
    plot_option,
    refuse_if,
    save_plot,
    show,
    show_problems,
    speeds_of,
    warn,
)
from rotorsim.errors import Problem
from rotorsim.report.text.table import degrees, display_unit, percent, rpm, table

if TYPE_CHECKING:
    from rotorsim.settled.result import Periodic

NOTICED = 0.01  # of the largest harmonic: a change of others by the orders that --harmonics leaves out
LISTED_SHARE = 1e-4  # of the largest harmonic at a speed


@click.command("periodic")
@diagram_options
@click.option("--speeds", metavar="SPEEDS", help="start:step:stop, a list, or one (default: the diagram's speed).")
@click.option("--harmonics", type=click.IntRange(1, 10_000), metavar="H", help="Highest order (default: as needed).")
@click.option("--subharmonic", type=click.IntRange(1, 100), default=1, show_default=True, help="Period in turns.")
@click.option("--record", multiple=True, metavar="SIGNAL", help="Show this signal, not the recorded ones; repeatable.")
@plot_option("harmonics against speed")
@amplitude_option
@json_option
def command(
    chosen: Chosen,
    speeds: str | None,
    harmonics: int | None,
    subharmonic: int,
    record: tuple[str, ...],
    plot: str | None,
    as_json: bool,
) -> int:
    """The settled motion at one or many speeds: direct where the diagram is linear, else harmonic balance.

    Prints the harmonics of two-axis signals; --json gives those of every recorded signal, complex.
    Exit code 1 if there is no solution at some speed.

    \b
    rotorsim periodic jeffcott --speeds "900 rpm:100 rpm:6000 rpm" --json
    """
    at = speeds_of(speeds) if speeds else None
    loaded = chosen.open()
    from rotorsim.settled.periodic import periodic

    result = periodic(loaded, speeds=at, harmonics=harmonics, subharmonic=subharmonic, signals=record or None)
    for name in result.drifting:
        note(f"{name} drifts: its mean has no settled value")
    coupling = result.provenance.get("coupling_error")
    if coupling is not None:
        known = [error for error in coupling if math.isfinite(error)]
        told = f"{percent(max(known))} of the largest harmonic at most" if known else "not known"
        missing = f", not known at {len(coupling) - len(known)} speeds" if known and len(known) < len(coupling) else ""
        settled = f"co-simulated, extrapolated from {result.counters['turns']} periods"
        note(f"{settled}; error of the coupling: {told}{missing}")
    if result.images:
        note(_of_images(result))
    refuse_if(plot and len(result.speeds) < 2, "--plot needs several speeds", hint="give --speeds")

    save_plot(lambda: result.plot(title=loaded.name), plot)
    places = [f"{loaded.name} at {rpm(float(speed)):.6g} rpm" for speed in result.speeds]
    states = zip(result.status, places, result.settled, strict=True)
    failed = [Problem(text, place) for text, place, settled in states if not settled]
    show_problems(failed)
    worst = int(result.truncation_error.argmax())
    share, H = float(result.truncation_error[worst]), result.provenance["harmonics"]
    if share > NOTICED:
        what = (
            f"{2 * H + 1} orders instead of {H} change those that are kept by up to {100 * share:.2g} % of the largest"
        )
        warn(what, places[worst], "leave --harmonics out: as many as needed")
    shaky = [float(speed) for speed, stable in zip(result.speeds, result.stable, strict=True) if stable is False]
    if shaky:
        between = " .. ".join(dict.fromkeys(f"{rpm(speed):.6g}" for speed in (shaky[0], shaky[-1])))
        what = f"unstable at {len(shaky)} of {len(result.speeds)} speeds ({between} rpm): this motion is never reached"
        hint = "'rotorsim modes' shows which pole grows" if coupling is None else "other gains"
        warn(what, loaded.name, hint)
    data = {
        "diagram": loaded.name,
        "speeds": result.speeds,
        "speeds_rpm": rpm(result.speeds),
        "orders": result.orders,
        "harmonics": {
            name: {"unit": result.units[name], "real": value.real, "imag": value.imag}
            for name, value in result.harmonics.items()
        },
        "status": result.status,
        "stable": result.stable,
        "drifting": result.drifting,
    } | ({} if coupling is None else {"coupling_error": coupling})
    if result.images:
        data |= {"images": result.images, "largest": result.largest_values}
    names = result.two_axis or result.harmonics
    show(as_json, lambda: data, lambda: "\n\n".join(_table(result, name) for name in names))
    return 1 if failed else 0


def _of_images(result: Periodic) -> str:
    """Return what sampling adds to the motion beside its harmonics."""
    import numpy as np

    added = []
    for name in result.two_axis or result.harmonics:
        unit, scale = display_unit(result.units[name])
        added.append(f"{np.nanmax(result.images[name]) * scale:.3g} {unit} of {name}")
    return f"sampled: images beside the orders, at these plus multiples of 1/T, reach {', '.join(added)}"


def _table(result: Periodic, name: str) -> str:
    """Return the harmonics of one signal that exceed LISTED_SHARE of the largest at their speed."""
    import numpy as np

    from rotorsim.report.amplitudes import from_peak, of_amplitude

    unit, scale = display_unit(result.units[name])
    shaky = False in result.stable
    lines = []
    for speed, values, stable in zip(result.speeds, result.harmonics[name].tolist(), result.stable, strict=True):
        mark = (("unstable" if stable is False else "settled"),) if shaky else ()
        least = LISTED_SHARE * max((abs(value) for value in values if math.isfinite(abs(value))), default=0.0)
        sizes = from_peak(np.abs(values), result.orders) * scale
        lines += [
            (f"{rpm(float(speed)):.6g}", f"{order:g}", f"{size:.6g}", f"{degrees(value):.2f}", *mark)
            for order, value, size in zip(result.orders, values, sizes, strict=True)
            if abs(value) > least
        ]
    amplitude = f"amplitude [{of_amplitude(unit)}]"
    header = ("speed [rpm]", "order", amplitude, "phase [deg]", *(("motion",) if shaky else ()))
    return f"{name}\n{table(header, lines)}"
