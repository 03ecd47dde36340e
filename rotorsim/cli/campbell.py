"""``rotorsim campbell``."""

from __future__ import annotations

import math

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

__all__ = ["command"]


@click.command("campbell")
@common.diagram_options
@click.option(
    "--speeds",
    metavar="SPEEDS",
    default="0 rpm:250 rpm:12000 rpm",
    show_default=True,
    help="start:step:stop, or a list.",
)
@click.option("--orders", metavar="LIST", default="1,2", show_default=True, help="Orders whose crossings are wanted.")
@click.option("--plot", metavar="FILE", help="Draw the Campbell diagram: .png, .svg or .pdf.")
@common.json_option
def command(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    speeds: str,
    orders: str,
    plot: str | None,
    as_json: bool,
) -> None:
    """Natural frequencies against speed, each mode followed by its shape, and the critical speeds.

    \b
    rotorsim campbell fe_rigid --without amb --speeds "0 rpm:100 rpm:6000 rpm" --plot campbell.png
    """
    common.check_target("--plot", plot, common.FIGURES)
    chosen = common.speeds_of(speeds)
    multiples = _whole_numbers(orders)
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    from rotorsim.cli.app import show_problems
    from rotorsim.linear.campbell import campbell

    found = campbell(loaded, speeds=chosen, orders=multiples)
    if plot:
        from rotorsim.report.figures.linear import campbell_figure
        from rotorsim.report.figures.run import save_figure

        save_figure(campbell_figure(found, loaded.name, orders=multiples), plot)
        common.note(f"written: {plot}")
    shaky = not found.stable.all()
    if shaky:
        speeds_there = found.speeds[~found.stable]
        between = " .. ".join(
            f"{common.rpm(float(speed)):.6g}" for speed in dict.fromkeys(speeds_there[[0, -1]].tolist())
        )
        what = f"unstable at {len(speeds_there)} of {len(found.speeds)} speeds ({between} rpm): a pole grows there"
        hint = "'rotorsim modes --set speed=...' shows which; a critical speed there is never reached"
        show_problems([Problem(what, loaded.name, hint=hint, severity="warning")])
    if as_json:
        every = [
            {
                "order": c.order,
                "speed": c.speed,
                "speed_rpm": common.rpm(c.speed),
                "frequency_hz": c.frequency_hz,
                "mode": c.mode,
                "whirl": c.whirl,
                "damping_ratio": c.damping_ratio,
                "stable": c.stable,
            }
            for c in found.crossings
        ]
        common.echo_json(
            {
                "diagram": loaded.name,
                "speeds": found.speeds,
                "speeds_rpm": [common.rpm(float(speed)) for speed in found.speeds],
                "frequency_hz": found.frequency_hz,
                "damping_ratio": found.damping_ratio,
                "whirl": found.whirl,
                "stable": found.stable,
                "critical_speeds": every,
            }
        )
        return
    shown = [k for k, resonant in enumerate(found.resonant) if resonant]
    rows = [
        (
            f"{common.rpm(float(speed)):.6g}",
            *(f"{f:.4f}" if math.isfinite(f) else "-" for f in frequencies[shown]),
            *_machine(bool(stable), shaky),
        )
        for speed, frequencies, stable in zip(found.speeds, found.frequency_hz, found.stable, strict=True)
    ]
    last = ("machine",) if shaky else ()
    click.echo(common.table(("speed [rpm]", *(f"mode {k + 1} [Hz]" for k in shown), *last), rows))
    if len(shown) < len(found.resonant):
        left_out = len(found.resonant) - len(shown)
        common.note(f"{left_out} modes with a damping ratio above 0.707 at all speeds, no resonance: --json has them")
    crossings = [c for c in found.crossings if found.resonant[c.mode - 1]]
    if crossings:
        rows = [
            (
                f"{c.order}X",
                f"{common.rpm(c.speed):.2f}",
                f"{c.frequency_hz:.4f}",
                f"{c.damping_ratio:.5f}",
                c.whirl,
                *_machine(c.stable, shaky),
            )
            for c in crossings
        ]
        click.echo()
        click.echo(
            common.table(("order", "critical speed [rpm]", "frequency [Hz]", "damping ratio", "whirl", *last), rows)
        )


def _machine(stable: bool, shown: bool) -> tuple[str, ...]:
    """Return the last column of a table, which is there only where something is unstable."""
    return ("stable" if stable else "unstable",) if shown else ()


def _whole_numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        what = f"--orders {text}: not a list of whole numbers"
        raise RotorsimError(Problem(what=what, hint="for example --orders 1,2")) from None
