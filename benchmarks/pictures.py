"""The pictures of the documents: python -m benchmarks.pictures [NAME ...] [--out docs/images].

Drawings of how data flow, and figures that verbs of rotorsim draw: the commands here are those that the pages show.
The result figures of the thesis: python -m benchmarks.thesis figures.
"""

from __future__ import annotations

import argparse
import os
import shlex
import tempfile
from collections.abc import Callable
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner
from matplotlib.figure import Figure

from benchmarks.diagnosis.report import overlap_picture
from benchmarks.engine.controllers import sensitivity_picture
from benchmarks.flows import diagnosis_flow, engine_flow
from benchmarks.fmi.delay import delay_figure
from benchmarks.harness import ROOT
from benchmarks.images import save_png, shrink_png
from rotorsim.cli.app import rotorsim

__all__ = ["DRAWN", "MEASURED", "PICTURES", "write"]

SETTLED = (
    'record jeffcott --set "controller.KD=3.3 A s/m" --speeds "900 rpm:300 rpm:3000 rpm" --settle '
    '--hold-out "3600 rpm, 4200 rpm" --noise "0.5 %" --out bench'
)

TWO_SETS = (
    'record jeffcott --speeds "5520 rpm:120 rpm:6000 rpm" --noise "5 %" --seed 2 --out two_sets '
    '--gains "controller.KP=12200" --gains "controller.KP=9000, controller.KD=4.5"'
)

SWEPT = {
    "map": 'sweep jeffcott --vary "speed=600 rpm:60 rpm:3000 rpm" --vary "controller.KP=0:2000:40000" --stop "2 s" '
    "--reduce radius --show rotor.displacement --plot map.png",
    "band": 'sweep jeffcott --vary "speed=1500 rpm:75 rpm:3000 rpm" --vary "rotor.mass=normal(2 kg, 3 %)" '
    '--vary "eccentricity=normal(24 um, 10 %)" --stop "2 s" --reduce radius --plot band.png',
    "bifurcation": 'sweep jeffcott_rub --vary "speed=5000 rpm:10 rpm:11000 rpm" --turns 200 --window 150:200 '
    '--figure bifurcation --show "rotor.displacement[1]" --plot bifurcation.png',
    "cascade": 'sweep jeffcott_rub --vary "speed=5000 rpm:400 rpm:11000 rpm" --stop "2 s" --step "25 us" '
    '--window "1 s:2 s" --figure cascade --plot cascade.png',
}


RAN_UP = (
    'record jeffcott_runup --set "acceleration=300 rad/s^2" --set "solver.stop=3.4 s" '
    '--set "solver.step=0.05 ms" --window "0.2 s:3.4 s" --rate "5000 Hz" --noise "0.5 %" --out runup'
)


ACCEPTED = 'accept two_amb_rotor --operating "2000 rpm:2500 rpm" --clearance "0.2 mm" --zone B --out acceptance'
INJECTED = (
    'record jeffcott --inject controller.displacement --amplitude "1 um" --set "solver.stop=20 s" --rate "5 kHz" '
    '--noise "2 %" --out swept'
)


TAPERED = (
    "draw blower.json --shaft --out cones.png "
    '--set "rotor.outer_diameter=[0.03, 0.048, 0.034, 0.045, 0.045, 0.048, 0.03]" '
    '--set "rotor.conical_sections=[3, 5]" --set "rotor.end_outer_diameter=[0.045, 0.034]" '
    '--set "rotor.sleeve_begins=[0.075, 0.4, 0.755]" '
    '--set "rotor.sleeve_lengths=[0.07, 0.08, 0.07]" --set "rotor.sleeve_outer_diameter=[0.08, 0.07, 0.08]" '
    '--set "rotor.sleeve_inner_diameter=[0.048, 0.045, 0.048]" --set "rotor.sleeve_stiffness_share=[0, 0.3, 0]"'
)


@dataclass(frozen=True)
class Picture:
    """Commands of rotorsim in an empty folder, and the file among what they leave that is the picture."""

    commands: tuple[str, ...]
    file: str


DRAWN: dict[str, Callable[[], Figure]] = {
    "engine.png": engine_flow,
    "diagnosis.png": diagnosis_flow,
    "cosimulation.png": delay_figure,
    "controllers.png": sensitivity_picture,
    "missing_signal.png": overlap_picture,
}
PICTURES = {
    "jeffcott.png": Picture(("run jeffcott --plot jeffcott.png",), "jeffcott.png"),
    "diagram.svg": Picture(("draw jeffcott -o diagram.svg",), "diagram.svg"),
    "shaft.png": Picture(("draw drawn_rotor --shaft --out shaft.png",), "shaft.png"),
    "shaft_cones.png": Picture(("new blower --from drawn_rotor", TAPERED), "cones.png"),
    "campbell.png": Picture(
        ('campbell fe_rigid --without amb --speeds "0 rpm:500 rpm:9000 rpm" --plot campbell.png',), "campbell.png"
    ),
    "run_up.png": Picture(("run jeffcott_runup --plot run_up.png",), "run_up.png"),
    "harmonics.png": Picture(
        ('periodic jeffcott --speeds "900 rpm:100 rpm:8000 rpm" --plot harmonics.png',), "harmonics.png"
    ),
    "sweep_map.png": Picture((SWEPT["map"],), "map.png"),
    "sweep_band.png": Picture((SWEPT["band"],), "band.png"),
    "bifurcation.png": Picture((SWEPT["bifurcation"],), "bifurcation.png"),
    "cascade.png": Picture((SWEPT["cascade"],), "cascade.png"),
    "spectrum.png": Picture(
        (
            'record jeffcott --speeds "1200 rpm, 1500 rpm" --noise "1 %" --out measured',
            "spectrum measured --run run02 --plot spectrum.png",
        ),
        "spectrum.png",
    ),
    "frequency.png": Picture(
        ('frequency fe_rigid --from amb.force --to "rotor.displacement[3,1]" --range "10 Hz:500 Hz" --plot bode.png',),
        "bode.png",
    ),
    **{
        f"acceptance_{name}.png": Picture((ACCEPTED,), f"acceptance/{number}_{name}.png")
        for number, name in ((3, "unbalance"), (5, "map"), (6, "shapes"))
    },
    "blower_unbalance.png": Picture(
        (
            "new blower --from drawn_rotor",
            'record blower.json --speeds "6000 rpm, 9000 rpm" --rate "20 kHz" --noise "1 %" --out steady',
            'accept blower.json steady --operating "6000 rpm:9000 rpm" --clearance "0.25 mm" --out acceptance',
        ),
        "acceptance/3_unbalance.png",
    ),
    "root_locus.png": Picture(
        ('modes two_amb_rotor --vary "controller_a.KD=0:0.25:20" --plot locus.png',), "locus.png"
    ),
    "margins.png": Picture(("margins two_amb_rotor --plot margins.png",), "margins.png"),
    "margins_measured.png": Picture((INJECTED, "margins swept --beside jeffcott --plot measured.png"), "measured.png"),
    "orders_bode.png": Picture(
        (RAN_UP, 'orders runup --order 1 --operating "9000 rpm:9500 rpm" --plot bode.png'), "bode.png"
    ),
    "orders_polar.png": Picture(
        (RAN_UP, "orders runup --order 1 --beside jeffcott --figure polar --plot polar.png"), "polar.png"
    ),
    "identified.png": Picture((TWO_SETS, "identify jeffcott two_sets --out result"), "result/parameters.png"),
    "identified_curve.png": Picture((TWO_SETS, "identify jeffcott two_sets --out result"), "result/speed_curve.png"),
    "diagnosed_spectra.png": Picture((SETTLED, "diagnose jeffcott bench --out diagnosis"), "diagnosis/spectra.png"),
    "diagnosed_diagram.svg": Picture((SETTLED, "diagnose jeffcott bench --out diagnosis"), "diagnosis/diagram.svg"),
    "diagnosed_parameters.png": Picture(
        (SETTLED, "diagnose jeffcott bench --out diagnosis"), "diagnosis/parameters.png"
    ),
}
MEASURED = {  # from data that are not part of this repository, by commands that pages show
    "rotor_kit.png": "python -m benchmarks.identification.rotor_kit FOLDER --figure rotor_kit.png"
}


def write(names: list[str], out: Path) -> list[Path]:
    """Draw pictures into a folder; commands that several need are run once."""
    out = out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    for name in names:
        if name in DRAWN:
            save_png(DRAWN[name](), out / name, dots=110)
    done: set[str] = set()
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for name in names:
            picture = PICTURES.get(name)
            if picture is None:
                continue
            for command in picture.commands:
                if command not in done:
                    ended = CliRunner().invoke(rotorsim, shlex.split(command))
                    if ended.exit_code not in (0, 1):
                        raise SystemExit(f"rotorsim {command}: {ended.output}")
                done.add(command)
            if name.endswith(".png"):
                shrink_png(Path(picture.file), out / name)
            else:
                (out / name).write_bytes(Path(picture.file).read_bytes())
    return [out / name for name in names]


def main(arguments: list[str] | None = None) -> None:
    """Draw all pictures, or those named."""
    every = [*DRAWN, *PICTURES]
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pictures", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=every, metavar="NAME", help=f"of {', '.join(every)}")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    given = parser.parse_args(arguments)
    wrong = sorted(set(given.names) - set(every))
    if wrong:
        parser.error(f"no picture {', '.join(wrong)}; hint: {', '.join(every)}")
    for file in write(given.names, given.out):
        print(f"{os.path.relpath(file)}  {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
