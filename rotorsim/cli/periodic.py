"""``rotorsim periodic``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.settled.result import Periodic

__all__ = ["command"]

NOTICED = 0.01  # of the largest harmonic: a change of others by the orders that --harmonics leaves out


@click.command("periodic")
@common.diagram_options
@click.option("--speeds", metavar="SPEEDS", help="start:step:stop, a list, or one (default: the diagram's speed).")
@click.option("--harmonics", type=click.IntRange(1, 10_000), metavar="H", help="Highest order (default: as needed).")
@click.option("--subharmonic", type=click.IntRange(1, 100), default=1, show_default=True, help="Period in turns.")
@click.option("--record", multiple=True, metavar="SIGNAL", help="Show this signal, not the recorded ones; repeatable.")
@click.option("--plot", metavar="FILE", help="Draw harmonics against speed: .png, .svg or .pdf.")
@common.json_option
def command(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
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
    common.check_target("--plot", plot, common.FIGURES)
    chosen = common.speeds_of(speeds) if speeds else None
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    from rotorsim.cli.app import show_problems
    from rotorsim.settled.periodic import periodic

    found = periodic(loaded, speeds=chosen, harmonics=harmonics, subharmonic=subharmonic, signals=record or None)
    for name in found.drifting:
        common.note(f"{name} drifts: its mean has no settled value")
    if plot:
        if len(found.speeds) < 2:
            raise RotorsimError(Problem(what="--plot needs several speeds", hint="give --speeds"))
        from rotorsim.report.figures.linear import periodic_figure
        from rotorsim.report.figures.run import save_figure

        save_figure(periodic_figure(found, title=loaded.name), plot)
        common.note(f"written: {plot}")
    failed = [
        Problem(what=text, subject=f"{loaded.name} at {common.rpm(float(speed)):.6g} rpm")
        for speed, text, settled in zip(found.speeds, found.status, found.settled, strict=True)
        if not settled
    ]
    show_problems(failed)
    worst = int(found.truncation_error.argmax())
    if found.truncation_error[worst] > NOTICED:
        share, H = 100 * float(found.truncation_error[worst]), found.provenance["harmonics"]
        what = f"{2 * H + 1} orders instead of {H} change those that are kept by up to {share:.2g} % of the largest"
        hint = "leave --harmonics out: as many as needed"
        where = f"{loaded.name} at {common.rpm(float(found.speeds[worst])):.6g} rpm"
        show_problems([Problem(what, where, hint=hint, severity="warning")])
    shaky = [float(speed) for speed, stable in zip(found.speeds, found.stable, strict=True) if stable is False]
    if shaky:
        between = " .. ".join(f"{common.rpm(speed):.6g}" for speed in dict.fromkeys((shaky[0], shaky[-1])))
        what = f"unstable at {len(shaky)} of {len(found.speeds)} speeds ({between} rpm): this motion is never reached"
        hint = "'rotorsim modes' shows which pole grows"
        show_problems([Problem(what, loaded.name, hint=hint, severity="warning")])
    if as_json:
        signals = {
            name: {"unit": found.units[name], "real": value.real, "imag": value.imag}
            for name, value in found.harmonics.items()
        }
        common.echo_json(
            {
                "diagram": loaded.name,
                "speeds": found.speeds,
                "speeds_rpm": [common.rpm(float(speed)) for speed in found.speeds],
                "orders": found.orders,
                "harmonics": signals,
                "status": found.status,
                "stable": found.stable,
                "drifting": found.drifting,
            }
        )
    else:
        click.echo("\n\n".join(_table(found, name) for name in found.two_axis or found.harmonics))
    return 1 if failed else 0


def _table(found: Periodic, name: str) -> str:
    """Return the harmonics of one signal that exceed 1e-4 of the largest at their speed."""
    unit, scale = common.display_unit(found.units[name])
    lines = []
    shaky = False in found.stable
    for speed, values, stable in zip(found.speeds, found.harmonics[name], found.stable, strict=True):
        mark = (("unstable" if stable is False else "settled"),) if shaky else ()
        sizes = [abs(value) for value in values.tolist()]
        largest = max((size for size in sizes if math.isfinite(size)), default=0.0)
        lines += [
            (
                f"{common.rpm(float(speed)):.6g}",
                f"{order:g}",
                f"{size * scale:.6g}",
                f"{common.degrees(value):.2f}",
                *mark,
            )
            for order, value, size in zip(found.orders, values, sizes, strict=True)
            if size > 1e-4 * largest
        ]
    header = ("speed [rpm]", "order", f"amplitude [{unit}, 0-peak]", "phase [deg]", *(("motion",) if shaky else ()))
    return name + "\n" + common.table(header, lines)
