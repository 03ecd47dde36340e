"""``rotorsim periodic``."""

from __future__ import annotations

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

__all__ = ["command"]


@click.command("periodic")
@common.diagram_options
@click.option("--speeds", metavar="START:STEP:STOP", help="Speeds (default: the speed of the diagram).")
@click.option(
    "--harmonics",
    type=click.IntRange(1, 1000),
    metavar="H",
    help="Number of harmonics kept (default: as many as needed).",
)
@click.option("--plot", metavar="FILE", help="Draw harmonics against speed: .png, .svg or .pdf.")
@common.json_option
def command(
    diagram: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    speeds: str | None,
    harmonics: int | None,
    plot: str | None,
    as_json: bool,
) -> None:
    """The settled motion at one or many speeds: direct where the diagram is linear, else harmonic balance.

    \b
    rotorsim periodic jeffcott --speeds "900 rpm:100 rpm:6000 rpm" --json
    """
    common.check_target("--plot", plot, (".png", ".svg", ".pdf"))
    chosen = common.speeds_of(speeds) if speeds else None
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    from rotorsim.simulate.periodic import periodic

    found = periodic(loaded, speeds=chosen, harmonics=harmonics)
    for name in found.drifting:
        common.note(f"{name} drifts: its mean has no settled value")
    if plot:
        from rotorsim.report.figures import save_figure
        from rotorsim.report.linear_figures import periodic_figure

        two_axes = [name for name, v in found.harmonics.items() if len(v) > 1 and found.units.get(name) == "m"]
        if not two_axes:
            raise RotorsimError(Problem(what="--plot needs several speeds and a displacement", hint="add --speeds"))
        save_figure(periodic_figure(found, two_axes[0], loaded.name), plot)
        common.note(f"wrote {plot}")
    if as_json:
        common.echo_json(
            {
                "speeds": found.speeds,
                "orders": found.orders,
                "harmonics": found.harmonics,
                "units": found.units,
                "status": found.status,
                "stable": found.stable,
                "drifting": found.drifting,
            }
        )
    else:
        rows = [
            [
                row["signal"],
                f"{row['speed'] * 30 / 3.141592653589793:.6g}",
                f"{row['order']:g}",
                f"{row['amplitude']:.6g}",
                f"{row['phase'] * 180 / 3.141592653589793:.2f}",
                row["unit"],
            ]
            for row in found.to_table(threshold=1e-4)
        ]
        click.echo(common.table(["signal", "speed [rpm]", "order", "amplitude", "phase [deg]", "unit"], rows))
    failed = [
        Problem(what=text, subject=f"{speed * 30 / 3.141592653589793:.6g} rpm")
        for speed, text, good in zip(found.speeds, found.status, found.settled, strict=True)
        if not good
    ]
    if failed:
        raise RotorsimError(*failed, exit_code=1)


def _table(found: Periodic, name: str) -> str:
    """Return the harmonics of one signal above 1e-4 of the largest at each speed."""
    unit, scale = common.display_unit(found.units[name])
    lines = []
    for j, speed in enumerate(found.speeds):
        values = found.harmonics[name][j]
        largest = max((abs(value) for value in values if abs(value) == abs(value)), default=0.0)
        lines += [
            (f"{rpm(float(speed)):.6g}", f"{order:g}", f"{abs(value) * scale:.6g}", f"{degrees(value):.2f}")
            for order, value in zip(found.orders, values, strict=True)
            if abs(value) > 1e-4 * largest
        ]
    return name + "\n" + common.table(("speed [rpm]", "order", f"amplitude [{unit}, 0-peak]", "phase [deg]"), lines)


def degrees(value: complex) -> float:
    """Return the phase of a complex amplitude in degrees."""
    return math.degrees(cmath.phase(value))


def _is_pair(name: str, known: Iterable[str]) -> bool:
    """Whether a signal is x + i y: its first axis is there as well."""
    return (f"{name[:-1]},1]" if name.endswith("]") else f"{name}[1]") in known
