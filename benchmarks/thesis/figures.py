"""The result figures of the thesis, redrawn from the shipped diagrams: python -m benchmarks.thesis figures.

Each figure returns what was drawn and the numbers that the text of the thesis states of it, beside those found here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.images import save_png
from benchmarks.markers import table_text
from benchmarks.thesis.panels import WINDOW, harmonic, history, orbit, peak, peak_near, ramp, spectrum, square
from rotorsim import Result, load, simulate
from rotorsim.report.style import BLUE, ORANGE, display, figure, styled

__all__ = ["FIGURES", "Stated", "draw", "stated_table", "write"]

DISPLACEMENT, CURRENT = "rotor.displacement", "controller.current"
RUN_UP = 20.0  # s, at 50 rad/s^2
UM = 1e6


@dataclass(frozen=True)
class Stated:
    """A number that the thesis prints of a figure, beside the one found here, in one unit."""

    figure: str
    what: str
    printed: float
    here: float
    unit: str

    @property
    def difference(self) -> str:
        return f"{100 * (self.here / self.printed - 1):+.1f} %"


Drawing = tuple[Figure, list[Stated]]


@cache
def _run(diagram: str, *, without: tuple[str, ...] = (), speed: str | None = None) -> Result:
    """Return a run of 5 s of a shipped diagram."""
    loaded = load(diagram, without=without, set={"speed": speed} if speed else None)
    wanted = [DISPLACEMENT, CURRENT, "clock.theta", *(["rotor.tilt"] if diagram != "jeffcott" else [])]
    return simulate(loaded, record=[name for name in wanted if not (without and name == CURRENT)])


@cache
def _run_up(diagram: str, signal: str, polar_inertia: float | None = None) -> Result:
    """Return a run-up of 20 s with the angle that the thesis takes, omega(t) t."""
    given = {"clock.angle": "omega_t", "speed_limit": "10000 rpm"} | (
        {} if polar_inertia is None else {"rotor.polar_inertia": polar_inertia}
    )
    return simulate(load(diagram, set=given), record=[signal, "clock.speed", "clock.theta"], stop=RUN_UP)


def figure_2_7() -> Drawing:
    """cracked Jeffcott rotor, 1500 rpm: displacement and current."""
    result = _run("jeffcott")
    made = figure(8.6, 7.6, "Figure 2-7: jeffcott, 1500 rpm")
    axes = made.subplots(3, 2, height_ratios=(1, 1, 1.5)).ravel()
    for panel, (signal, word) in zip(
        axes,
        [
            (f"{name}[{k}]", f"{axis}-{word}")
            for name, word in ((DISPLACEMENT, "displacement"), (CURRENT, "current"))
            for k, axis in ((1, "x"), (2, "y"))
        ],
        strict=False,
    ):
        history(panel, result, [signal], [""], f"({'abcd'[list(axes).index(panel)]}) {word}")
    orbit(axes[4], result, CURRENT, "(e) current orbit")
    orbit(axes[5], result, DISPLACEMENT, "(f) shaft centreline orbit")
    return made, []


def figure_2_8() -> Drawing:
    """with and without magnetic bearing, 1500 rpm."""
    bearing, none = _run("jeffcott"), _run("jeffcott", without=("amb",))
    made = figure(9.6, 3.2, "Figure 2-8: jeffcott, 1500 rpm, with and without magnetic bearing")
    axes = made.subplots(1, 3)
    first, last = (int(np.searchsorted(bearing.time, t - 1e-9)) for t in (WINDOW[0], WINDOW[0] + 0.16))
    for result, label, colour, dash in ((none, "without AMB", ORANGE, "--"), (bearing, "with AMB", BLUE, "-")):
        r, unit = display(result.complex(DISPLACEMENT)[first:last], "m")
        for panel, values in zip(axes, (r.real, r.imag), strict=False):
            panel.plot(result.time[first:last], values, dash, color=colour, label=label, lw=1.1)
        axes[2].plot(*(part[: len(r) // 4] for part in (r.real, r.imag)), dash, color=colour, label=label, lw=1.1)
    for panel, title in zip(axes, ("(a) x-displacement", "(b) y-displacement", "(c) centreline orbit"), strict=True):
        panel.set_title(title, loc="left")
        panel.set(xlabel="time [s]", ylabel=f"[{unit}]")
        panel.margins(x=0)
    axes[2].set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    square(axes[2], display(none.complex(DISPLACEMENT)[first:last], "m")[0])
    made.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return made, []


def figure_2_9() -> Drawing:
    """cracked Jeffcott rotor, 900 rpm."""
    result = _run("jeffcott", speed="900 rpm")
    made = figure(8.6, 2.8, "Figure 2-9: jeffcott, 900 rpm")
    for k, (panel, axis) in enumerate(zip(made.subplots(1, 2), "xy", strict=True)):
        history(panel, result, [f"{DISPLACEMENT}[{k + 1}]"], [""], f"({'ab'[k]}) {axis}-displacement")
    return made, []


def _spectra(number: str, result: Result, signal: str, title: str) -> Figure:
    made = figure(8.6, 5.2, f"Figure {number}: {title}")
    (a, b), (c, d) = made.subplots(2, 2)
    spectrum(a, c, result, signal, ("(a) amplitude of displacement", "(c) phase of displacement"))
    spectrum(b, d, result, CURRENT, ("(b) amplitude of current", "(d) phase of current"))
    return made


def figure_2_10() -> Drawing:
    """full spectrum of the Jeffcott rotor, 1500 rpm."""
    result = _run("jeffcott")
    stated = [
        Stated("2-10", f"amplitude of R_{order}", printed, UM * abs(harmonic(result, DISPLACEMENT, order)), "um")
        for order, printed in ((1, 3.17), (2, 2.0), (3, 1.13), (5, 0.968), (-1, 0.739))
    ]
    stated.append(Stated("2-10", "amplitude of I_1", 38.8, 1e3 * abs(harmonic(result, CURRENT, 1)), "mA"))
    return _spectra("2-10", result, DISPLACEMENT, "jeffcott, 1500 rpm, 4 s to 5 s"), stated


def _resonances(
    number: str, speed: np.ndarray, height: np.ndarray, printed: dict[str, tuple[float, float]]
) -> Iterator[Stated]:
    """Yield speed and height of each resonance that the thesis states, [rpm] and [um]."""
    for name, (at, high) in printed.items():
        here, top = peak_near(speed, height, at)
        yield Stated(number, f"{name}: speed alpha t", at, here, "rpm")
        yield Stated(number, f"{name}: envelope", high, UM * top, "um")


def figure_2_11() -> Drawing:
    """run-up of the Jeffcott rotor."""
    signal = f"{DISPLACEMENT}[1]"
    made = figure(8.6, 3.4, "Figure 2-11: jeffcott_runup, 50 rad/s^2, angle omega(t) t")
    drawn = ramp(
        *made.subplots(1, 2), _run_up("jeffcott_runup", signal), signal, ("(a) x-displacement", "(b) Hilbert envelope")
    )
    printed = {"1X": (3684, 87.23), "1/2X": (1841, 22.89), "1/3X": (1222, 12.83)}
    return made, list(_resonances("2-11", *drawn, printed))


def figure_3_3() -> Drawing:
    """offset disc, 1620 rpm."""
    result = _run("offset_disc")
    made = figure(8.6, 5.2, "Figure 3-3: offset_disc, 1620 rpm")
    a, b, c, d = made.subplots(2, 2, height_ratios=(1, 1.3)).ravel()
    history(a, result, [f"{DISPLACEMENT}[1]"], [""], "(a) x-displacement")
    history(b, result, ["rotor.tilt[2]"], [""], "(b) tilt about the x-axis")
    history(c, result, [f"{CURRENT}[1]"], [""], "(c) x-current")
    orbit(d, result, DISPLACEMENT, "(d) shaft centreline orbit")
    return made, [Stated("3-3", "largest tilt about the x-axis", 18.2, UM * peak(result, "rotor.tilt[2]"), "urad")]


def figure_3_4() -> Drawing:
    """run-up of the offset disc with and without gyroscopic moments."""
    signal = f"{DISPLACEMENT}[1]"
    made = figure(8.6, 5.6, "Figure 3-4: offset_disc_runup, 50 rad/s^2, angle omega(t) t")
    (a, b), (c, d) = made.subplots(2, 2)
    whole = ramp(
        a,
        b,
        _run_up("offset_disc_runup", signal),
        signal,
        ("(a) x-displacement, with G", "(b) Hilbert envelope, with G"),
    )
    still = ramp(
        c,
        d,
        _run_up("offset_disc_runup", signal, 0.0),
        signal,
        ("(c) x-displacement, without G", "(d) Hilbert envelope, without G"),
    )
    stated = list(_resonances("3-4", *whole, {"1X": (3596, 75.4), "1/2X": (1793, 20.85), "1/3X": (1186, 12.27)}))
    stated.append(Stated("3-4", "1X without G: speed alpha t", 3579, peak_near(*still, 3579)[0], "rpm"))
    return made, stated


def figure_3_5() -> Drawing:
    """full spectrum of the offset disc, 1620 rpm."""
    return _spectra("3-5", _run("offset_disc"), DISPLACEMENT, "offset_disc, 1620 rpm, 4 s to 5 s"), []


def figure_4_5() -> Drawing:
    """beam on rigid supports, 1620 rpm: currents."""
    made = figure(6.4, 2.8, "Figure 4-5: fe_rigid, 1620 rpm, AMB currents")
    history(made.add_subplot(), _run("fe_rigid"), [f"{CURRENT}[1]", f"{CURRENT}[2]"], ["x", "y"], "")
    return made, []


def figure_4_6() -> Drawing:
    """beam on rigid supports, 1620 rpm: displacements of the nodes."""
    result = _run("fe_rigid")
    made = figure(6.4, 3.2, "Figure 4-6: fe_rigid, 1620 rpm, displacements in the plane of x")
    nodes = range(1, 7)
    history(made.add_subplot(), result, [f"{DISPLACEMENT}[{n},1]" for n in nodes], [f"node {n}" for n in nodes], "")
    steep = max(peak(result, f"rotor.tilt[{node},{axis}]") for node in nodes for axis in (1, 2))
    return made, [Stated("4-6", "largest tilt of all nodes", 20.04, UM * steep, "urad")]


def _orbit(number: str, speed: str | None, title: str) -> Figure:
    made = figure(4.2, 4.2, f"Figure {number}: fe_rigid, {title}")
    orbit(made.add_subplot(), _run("fe_rigid", speed=speed), f"{DISPLACEMENT}[4]", "node 4")
    return made


def figure_4_7() -> Drawing:
    """beam on rigid supports, 1620 rpm: orbit at node 4."""
    return _orbit("4-7", None, "1620 rpm"), []


def figure_4_8() -> Drawing:
    """beam on rigid supports, 4500 rpm: orbit at node 4."""
    return _orbit("4-8", "4500 rpm", "4500 rpm"), []


def figure_4_9() -> Drawing:
    """full spectrum of the beam on rigid supports, 1620 rpm."""
    return _spectra("4-9", _run("fe_rigid"), f"{DISPLACEMENT}[3]", "fe_rigid, node 3, 1620 rpm, 4 s to 5 s"), []


def figure_4_10() -> Drawing:
    """run-up of the beam on rigid supports."""
    made = figure(8.6, 5.6, "Figure 4-10: fe_rigid_runup, 50 rad/s^2, angle omega(t) t")
    stated = []
    for row, node in zip(made.subplots(2, 2), (3, 4), strict=True):
        signal = f"{DISPLACEMENT}[{node},1]"
        letters = "ab" if node == 3 else "cd"
        titles = (f"({letters[0]}) x-displacement, node {node}", f"({letters[1]}) Hilbert envelope, node {node}")
        drawn = ramp(*row, _run_up("fe_rigid_runup", f"{DISPLACEMENT}[{node}]"), signal, titles)
        printed = {"1X, node 3": (2591, 144.8)} if node == 3 else {"2X, node 4": (8208, 1554.0)}
        stated += _resonances("4-10", *drawn, printed)
    return made, stated


def figure_5_4() -> Drawing:
    """beam on flexible supports, 1620 rpm."""
    result = _run("fe_flexible")
    made = figure(9.6, 3.0, "Figure 5-4: fe_flexible, 1620 rpm")
    a, b, c = made.subplots(1, 3)
    history(a, result, [f"{CURRENT}[1]"], [""], "(a) x-current")
    history(b, result, [f"{CURRENT}[2]"], [""], "(b) y-current")
    orbit(c, result, f"{DISPLACEMENT}[4]", "(c) orbit at node 4")
    return made, []


def figure_5_5() -> Drawing:
    """run-up of the beam on flexible supports."""
    signal = f"{DISPLACEMENT}[4,1]"
    made = figure(8.6, 3.4, "Figure 5-5: fe_flexible_runup, node 4, 50 rad/s^2, angle omega(t) t")
    drawn = ramp(
        *made.subplots(1, 2),
        _run_up("fe_flexible_runup", f"{DISPLACEMENT}[4]"),
        signal,
        ("(a) x-displacement", "(b) Hilbert envelope"),
    )
    speed, height = drawn
    printed = {"1X": (2715, 65.72), "2X": (5284, 143.14), "1/2X": (1378, 30.34)}
    return made, list(_resonances("5-5", speed, height, printed))


FIGURES: dict[str, Callable[[], Drawing]] = {
    "2-7": figure_2_7,
    "2-8": figure_2_8,
    "2-9": figure_2_9,
    "2-10": figure_2_10,
    "2-11": figure_2_11,
    "3-3": figure_3_3,
    "3-4": figure_3_4,
    "3-5": figure_3_5,
    "4-5": figure_4_5,
    "4-6": figure_4_6,
    "4-7": figure_4_7,
    "4-8": figure_4_8,
    "4-9": figure_4_9,
    "4-10": figure_4_10,
    "5-4": figure_5_4,
    "5-5": figure_5_5,
}


def draw(number: str) -> Drawing:
    """Return a figure and what the thesis states of it."""
    with styled():
        made, stated = FIGURES[number]()
    engine = made.get_layout_engine()
    assert engine is not None
    engine.set(w_pad=0.08, h_pad=0.06)
    return made, stated


def write(number: str, folder: Path) -> tuple[Path, list[Stated]]:
    """Write a figure as FOLDER/figure-2-7.png; return the file and what the thesis states of it."""
    made, stated = draw(number)
    file = folder / f"figure-{number}.png"
    save_png(made, file)
    return file, stated


def stated_table(stated: list[Stated]) -> str:
    """Return the numbers as a table: printed, here, and how far apart."""
    rows = [
        [item.figure, item.what, f"{item.printed:.4g} {item.unit}", f"{item.here:.4g} {item.unit}", item.difference]
        for item in stated
    ]
    return table_text(["figure", "", "printed", "here", "difference"], rows)
