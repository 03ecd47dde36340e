"""``rotorsim campbell``."""

from __future__ import annotations

from dataclasses import asdict

import click

from rotorsim.cli import common

__all__ = ["command"]


@click.command("campbell")
@common.diagram_options
@click.option(
    "--speeds", metavar="START:STEP:STOP", default="0 rpm:100 rpm:6000 rpm", show_default=True, help="Speeds."
)
@click.option("--plot", metavar="FILE", help="Draw the diagram: .png, .svg or .pdf.")
@common.json_option
def command(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    speeds: str,
    plot: str | None,
    as_json: bool,
) -> None:
    """Natural frequencies against speed, followed by mode shape, and critical speeds.

    \b
    rotorsim campbell fe_rigid --without amb --speeds "0 rpm:100 rpm:6000 rpm" --plot campbell.png
    """
    common.check_target("--plot", plot, (".png", ".svg", ".pdf"))
    chosen = common.speeds_of(speeds)
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    from rotorsim.simulate.campbell import campbell

    found = campbell(loaded, chosen)
    if plot:
        from rotorsim.report.figures import save_figure
        from rotorsim.report.linear_figures import campbell_figure

        save_figure(campbell_figure(found, loaded.name), plot)
        common.note(f"wrote {plot}")
    crossings = [asdict(crossing) for crossing in found.crossings]
    if as_json:
        common.echo_json(
            {
                "speeds": found.speeds,
                "frequency_hz": found.frequency_hz,
                "damping_ratio": found.damping_ratio,
                "whirl": found.whirl,
                "critical_speeds": crossings,
            }
        )
        return
    rpm = 30 / 3.141592653589793
    rows = [
        [
            f"{c['order']}X",
            f"{c['speed'] * rpm:.1f}",
            f"{c['frequency_hz']:.3f}",
            f"{c['damping_ratio']:.5f}",
            c["whirl"],
        ]
        for c in crossings
    ]
    click.echo(common.table(["order", "critical speed [rpm]", "frequency [Hz]", "damping ratio", "whirl"], rows))
