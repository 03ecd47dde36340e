"""``rotorsim modes``."""

from __future__ import annotations

import click

from rotorsim.cli import common

__all__ = ["command"]


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
    from rotorsim.simulate.modes import modes

    found = modes(loaded)
    for text in found.notes:
        common.note(text)
    if as_json:
        common.echo_json(
            {"modes": found.to_table(), "real_poles": found.real_poles, "speed": found.speed, "stable": found.stable}
        )
        return
    rows = [
        [
            str(k),
            f"{row['frequency_hz']:.4f}",
            f"{row['natural_frequency_hz']:.4f}",
            f"{row['damping_ratio']:.6f}",
            f"{row['whirl']}{'  UNSTABLE' if row['damping_ratio'] < 0 else ''}",
        ]
        for k, row in enumerate(found.to_table(), 1)
    ]
    click.echo(common.table(["mode", "damped [Hz]", "undamped [Hz]", "damping ratio", "whirl"], rows))
    if len(found.real_poles):
        poles = ", ".join(f"{pole:.4g}" for pole in found.real_poles)
        click.echo(f"\npoles that do not oscillate [1/s]: {poles}")
