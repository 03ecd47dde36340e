"""``rotorsim modes``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rotorsim.cli.shared import Chosen, diagram_options, json_option, note, show
from rotorsim.report.text.table import table

if TYPE_CHECKING:
    from rotorsim.linear.eigenmodes import Modes

ZERO_DAMPING = 1e-9  # damping ratio of an undamped mode, but for rounding
HEADER = ("mode", "damped [Hz]", "undamped [Hz]", "damping ratio", "whirl")


@click.command("modes")
@diagram_options
@json_option
def command(chosen: Chosen, as_json: bool) -> None:
    """Natural frequencies, damping ratios and whirl of the linearised diagram, in ascending damped frequency.

    \b
    rotorsim modes fe_rigid --without amb --set "speed=3000 rpm"
    """
    loaded = chosen.open()
    from rotorsim.linear.eigenmodes import modes

    result = modes(loaded)
    for text in (*result.notes, *([] if result.stable else ["unstable: a pole has a positive real part"])):
        note(text)
    data = {"diagram": loaded.name, "speed": result.speed, "stable": result.stable, "modes": result.to_table()}
    show(as_json, lambda: {**data, "real_poles": result.real_poles}, lambda: _text(result))


def _text(result: Modes) -> str:
    rows: dict[bool, list[tuple[str, ...]]] = {True: [], False: []}
    for k, mode in enumerate(result.modes, 1):
        frequencies = f"{mode.frequency_hz:.4f}", f"{mode.natural_frequency_hz:.4f}"
        damping = f"{round(mode.damping_ratio, 6) + 0.0:.6f}"
        grows = ", grows" if mode.damping_ratio < -ZERO_DAMPING else ""
        rows[mode.resonant].append((str(k), *frequencies, damping, mode.whirl + grows))
    parts = [table(HEADER, rows[True])]
    if rows[False]:
        parts.append(f"damped beyond 0.707, which no force brings to resonance\n{table(HEADER, rows[False])}")
    if len(result.real_poles):
        least = 0.0 if result.stable else 1e-9 * float(abs(result.real_poles).max())
        poles = (f"{p:.4g}{' (grows)' if not result.stable and p > least else ''}" for p in result.real_poles)
        parts.append(f"poles that do not oscillate [1/s]: {', '.join(poles)}")
    return "\n\n".join(parts)
