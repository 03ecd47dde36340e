"""``rotorsim modes``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rotorsim.cli.shared import Chosen, diagram_options, json_option, note, plot_option, refuse_if, save_plot, show
from rotorsim.cli.shared.variations import variations
from rotorsim.report.text.table import table

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.linear.control.root_locus import RootLocus
    from rotorsim.linear.modes.eigenmodes import Modes

ZERO_DAMPING = 1e-9  # damping ratio of an undamped mode, but for rounding
HEADER = ("mode", "damped [Hz]", "undamped [Hz]", "damping ratio", "whirl")


FOLDED = "sampled: several images of some poles show alike, and their frequency and damping ratio may be another's: {}"


@click.command("modes")
@diagram_options
@click.option("--vary", metavar="NAME=VALUES", help="Root locus over a parameter: start:step:stop, or a list.")
@plot_option("the modes, or the root locus")
@json_option
def command(chosen: Chosen, vary: str | None, plot: str | None, as_json: bool) -> None:
    """Natural frequencies, damping ratios and whirl of the linearised diagram, in ascending damped frequency.

    With --vary the poles over values of a parameter, and the values at which the machine becomes unstable; sampled
    controllers exactly.

    \b
    rotorsim modes fe_rigid --without amb --set "speed=3000 rpm"
    rotorsim modes jeffcott --vary "controller.KD=0:0.25:8" --plot locus.png
    """
    loaded = chosen.open()
    if vary is not None:
        _over(loaded, vary, plot, as_json)
        return
    from rotorsim.linear.modes.eigenmodes import modes

    result = modes(loaded)
    said = [*result.notes, *([] if result.stable else ["unstable: a pole has a positive real part"])]
    if rates := {mode.modulo for mode in result.modes if mode.modulo}:
        said.append(FOLDED.format(f"'modulo {max(rates):.6g} Hz'"))
    for text in said:
        note(text)
    save_plot(lambda: result.plot(f"Modes, {loaded.name}"), plot)
    data = {"diagram": loaded.name, "speed": result.speed, "stable": result.stable, "modes": result.to_table()}
    show(as_json, lambda: {**data, "real_poles": result.real_poles}, lambda: _text(result))


def _over(loaded: Diagram, vary: str, plot: str | None, as_json: bool) -> None:
    """Say the poles over values of a parameter."""
    import numpy as np

    from rotorsim.linear.control.root_locus import root_locus

    varied = variations([vary], loaded, None, 0)
    refuse_if(varied.drawn, f"--vary {vary}: a root locus needs values, not a distribution")
    ((name, values),) = varied.runs.items()
    found = root_locus(loaded, name, np.unique(values))
    folded = np.isfinite(found.modulo)
    for text in (*found.notes, *([FOLDED.format("hollow in the figure")] if folded.any() else [])):
        note(text)
    save_plot(lambda: found.plot(f"Root locus over {name}, {loaded.name}"), plot)
    data = {
        "diagram": loaded.name,
        "parameter": name,
        "unit": found.unit,
        "values": found.values,
        "poles": found.poles,
        "frequency_modulo_hz": found.modulo,
        "stable": found.stable,
        "limits": [
            {"value": one.value, "frequency_hz": one.frequency, "frequency_modulo_hz": one.modulo}
            for one in found.limits
        ],
    }
    show(as_json, lambda: data, lambda: _locus_text(found))


def _locus_text(found: RootLocus) -> str:
    """Return the least damped pole at each value, and the limits of stability."""
    import numpy as np

    frequency, ratio, modulo = found.least_damped()
    unit = "" if found.unit == "1" else f" [{found.unit}]"
    rows = [
        (
            f"{value:.6g}",
            f"{hz:.4f}" + ("" if np.isnan(rate) else f" modulo {rate:.6g}"),
            f"{round(z, 6) + 0.0:.6f}",
            "stable" if stable else "unstable",
        )
        for value, hz, rate, z, stable in zip(found.values, frequency, modulo, ratio, found.stable, strict=True)
    ]
    text = table((f"{found.parameter}{unit}", "least damped [Hz]", "damping ratio", "machine"), rows)
    limits = [
        f"limit of stability: {one.value:.6g}{unit}, at {one.frequency:.4f} Hz"
        + ("" if np.isnan(one.modulo) else f" modulo {one.modulo:.6g} Hz")
        for one in found.limits
    ]
    same = "stable" if found.stable[0] else "unstable"
    said = limits or [f"{same} at all of these values"]
    least, most = int(found.zeros.min()), int(found.zeros.max())
    if most:
        said.append(f"poles at zero: {f'{least} to ' * (least < most)}{most}, of what nothing returns")
    return "\n\n".join([text, "\n".join(said)])


def _text(result: Modes) -> str:
    rows: dict[bool, list[tuple[str, ...]]] = {True: [], False: []}
    for k, mode in enumerate(result.modes, 1):
        frequencies = f"{mode.frequency_hz:.4f}", f"{mode.natural_frequency_hz:.4f}"
        damping = f"{round(mode.damping_ratio, 6) + 0.0:.6f}"
        grows = ", grows" if mode.damping_ratio < -ZERO_DAMPING else ""
        grows += f", modulo {mode.modulo:.6g} Hz" if mode.modulo else ""
        rows[mode.resonant].append((str(k), *frequencies, damping, mode.whirl + grows))
    parts = [table(HEADER, rows[True])]
    if rows[False]:
        parts.append(f"damped beyond 0.707, which no force brings to resonance\n{table(HEADER, rows[False])}")
    if len(result.real_poles):
        least = 0.0 if result.stable else 1e-9 * float(abs(result.real_poles).max())
        zeros = int((result.real_poles == 0).sum())
        moving = result.real_poles[result.real_poles != 0]
        poles = [f"{p:.4g}{' (grows)' if not result.stable and p > least else ''}" for p in moving]
        poles += [f"0{f' ({zeros} times)' * (zeros > 1)}"] * (zeros > 0)
        parts.append(f"poles that do not oscillate [1/s]: {', '.join(poles)}")
    return "\n\n".join(parts)
