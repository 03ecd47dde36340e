"""``rotorsim modes``."""

from __future__ import annotations

import click

from rotorsim.cli import common

__all__ = ["command"]

ROUNDING = 1e-9  # damping ratio of an undamped mode, but for rounding


@click.command("modes")
@common.diagram_options
@common.json_option
def command(
    diagram: str, settings: tuple[str, ...], without: tuple[str, ...], trust_blocks: bool, as_json: bool
) -> None:
    """Natural frequencies, damping ratios and whirl of the linearised diagram, in ascending damped frequency.

    \b
    rotorsim modes fe_rigid --without amb --set "speed=3000 rpm"
    """
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    from rotorsim.linear.eigenmodes import modes

    found = modes(loaded)
    for text in found.notes:
        common.note(text)
    if not found.stable:
        common.note("unstable: a pole has a positive real part")
    if as_json:
        common.echo_json(
            {
                "diagram": loaded.name,
                "speed": found.speed,
                "stable": found.stable,
                "modes": found.to_table(),
                "real_poles": found.real_poles,
            }
        )
        return
    numbered = list(enumerate(found.modes, 1))
    for title, resonant in (("", True), ("\ndamped beyond 0.707, which no force brings to resonance", False)):
        rows = [
            (
                str(k),
                f"{mode.frequency_hz:.4f}",
                f"{mode.natural_frequency_hz:.4f}",
                f"{round(mode.damping_ratio, 6) + 0.0:.6f}",
                mode.whirl + (", grows" if mode.damping_ratio < -ROUNDING else ""),
            )
            for k, mode in numbered
            if mode.resonant == resonant
        ]
        if rows and title:
            click.echo(title)
        if rows or resonant:
            click.echo(common.table(("mode", "damped [Hz]", "undamped [Hz]", "damping ratio", "whirl"), rows))
    if len(found.real_poles):
        grows = 0.0 if found.stable else 1e-9 * float(abs(found.real_poles).max())
        marks = [" (grows)" if not found.stable and pole > grows else "" for pole in found.real_poles]
        poles = ", ".join(f"{pole:.4g}{mark}" for pole, mark in zip(found.real_poles, marks, strict=True))
        click.echo(f"\npoles that do not oscillate [1/s]: {poles}")
