"""Where a diagnosis points: the machine drawn along its shaft with probabilities at the nodes, and in the diagram."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.draw import draw_svg
from rotorsim.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, figure, legend_below, styled

SHADES = ((0.5, "#b33c00"), (0.1, "#f08a3c"), (0.0, "#f7c896"))  # probability from which, colour of a frame
NEW = BLUE  # frame of blocks that the diagnosis put in
PORTS = ((RED, "////"), (BLUE, "...."), (GREEN, "xxxx"), (PURPLE, "----"), (ORANGE, "++"))
OTHERS = 8  # places elsewhere that are listed
READING = {"": "", "reading": "(reading)", "both": "(reading too)", "branch": ""}  # what is written of a side of a wire
STEEL, DISC, MAGNET = "#c9d3dc", "#8fa3b5", "#d9c9e6"


@dataclass(frozen=True)
class _Shaft:
    """A rotor along its axis: z of every node, ends and radii of pieces, (z, radius, width) of discs; pinned nodes."""

    block: str
    z: np.ndarray
    ends: np.ndarray
    radius: np.ndarray
    discs: tuple[tuple[float, float, float], ...]
    pinned: tuple[int, ...]
    only: int | None = None  # the node that stands for the whole of a rotor without nodes
    row: str = "node"  # what a row of its ports is called

    def node(self, index: tuple[int, ...]) -> int | None:
        """Return the node (from 0) that an index of a port means."""
        return self.only if self.only is not None else index[0] if index else None


@styled()
def places_figure(diagram: Diagram, places: Sequence[PlaceClass], recorded: Iterable[str]) -> Figure | None:
    """Return the machine along its shaft with the probability of each place, and other places beside it.

    diagram: as given. recorded: flat names of the measured signals. None without a rotor.
    """
    shaft = _shaft(diagram)
    if shaft is None:
        return None
    every = [(spot, one.probability) for one in places for spot in one.places]
    here = [(spot, p) for spot, p in every if spot.block == shaft.block]
    there = [(spot, p) for spot, p in every if spot.block != shaft.block][:OTHERS]
    left, right = [*(["bars"] if here else []), "machine"], ["others"] if there else []
    made = figure(10.5, 4.4 if here else 3.0, _title(places))
    mosaic: list[Any] = [[name, *right] for name in left]
    widths = (2.6, 1.0) if right else (1.0,)
    axes = made.subplot_mosaic(mosaic, width_ratios=widths, height_ratios=(1.0, 1.5)[: len(left)])
    _draw_machine(axes["machine"], diagram, shaft, recorded)
    if here:
        axes["bars"].sharex(axes["machine"])
        _draw_bars(axes["bars"], shaft, here)
        legend_below(made, axes["bars"])
    if right:
        _draw_others(axes["others"], there)
    return made


def _title(places: Sequence[PlaceClass]) -> str:
    if not places:
        return "The machine as the diagram has it; no place is suspect"
    return f"Where it acts: {places[0].words} with probability {places[0].probability:.2f}"


# -- the machine -------------------------------------------------------------------------------------------------------


def _shaft(diagram: Diagram) -> _Shaft | None:
    """Return the first rotor of a diagram along its axis; one without nodes as a disc between two bearings."""
    for name, node in diagram.nodes.items():
        if "rotor" not in node.block.roles or "displacement" not in node.outputs:
            continue
        shape = node.outputs["displacement"].shape
        if len(shape) == 2 and hasattr(node.block, "drawing"):
            return _drawn(name, node.block.drawing(node.values))
        if shape == (2,):
            at = 0.35 if "tilt" in node.outputs else 0.5
            z = np.array([0.0, at, 1.0])
            return _Shaft(name, z, z, np.full(2, 0.016), ((at, 0.13, 0.05),), (0, 2), only=1)
    return None


def _drawn(name: str, drawing: Any) -> _Shaft:
    """Return the shaft of a drawing, not to scale across, so that thin shafts are seen: discs by their masses."""
    z, span = np.array(drawing.stations), drawing.length
    ends = np.array([0.0, *(one.end for one in drawing.sections)])
    outer = np.array([one.outer_at((one.begin + one.end) / 2) for one in drawing.sections])
    largest = max((disc.mass for disc in drawing.discs), default=0.0)
    discs = tuple((d.position, 0.12 * span * np.cbrt(d.mass / largest), 0.03 * span) for d in drawing.discs if d.mass)
    pinned = tuple(int(np.abs(z - at).argmin()) for at in drawing.pinned)
    return _Shaft(name, z, ends, outer / outer.max() * 0.02 * span, discs, pinned, row=drawing.station)


def _draw_machine(axes: Axes, diagram: Diagram, shaft: _Shaft, recorded: Iterable[str]) -> None:
    z, ends, span = shaft.z, shaft.ends, float(np.ptp(shaft.ends))
    edge: dict[str, Any] = {"ec": INK, "lw": 0.8}
    axes.bar(ends[:-1], 2 * shaft.radius, np.diff(ends), -shaft.radius, align="edge", fc=STEEL, zorder=2, **edge)
    for at, radius, width in shaft.discs:
        axes.bar(at, 2 * radius, width, -radius, fc=DISC, zorder=3, **edge)
    for k in shaft.pinned:
        axes.plot(z[k], -0.045 * span, "^", ms=17, mfc="white", mec=INK, zorder=1.5)
    bearings = _acting(diagram, shaft, "bearing")
    for k, names in bearings.items():
        for number, name in enumerate(names):
            _draw_bearing(axes, float(z[k]) + 0.05 * span * number, span, name, "current" in diagram.nodes[name].inputs)
    for k, names in _acting(diagram, shaft, "excitation").items():
        axes.annotate(", ".join(names), (z[k], -0.25 * span), ha="center", va="top", fontsize=7.5, color=GREY)
    for k in _probes(shaft, recorded):
        beside = k in bearings or any(abs(z[k] - disc[0]) < 1e-6 * span for disc in shaft.discs)
        at, arrow = float(z[k]) - 0.035 * span * beside, {"arrowstyle": "-|>", "color": GREEN, "lw": 1.4}
        axes.annotate("", (at, 0.03 * span), (at, 0.19 * span), arrowprops=arrow)
        axes.annotate("probe", (at, 0.2 * span), ha="center", va="bottom", fontsize=7.5, color=GREEN)
    if shaft.only is None:
        axes.plot(z, np.zeros(len(z)), "o", ms=3.5, color=INK, zorder=4)
        axes.set_xticks(z, [f"{k + 1}" for k in range(len(z))])
        axes.set_xlabel(f"{shaft.row} of {shaft.block}, {span:.3g} m from end to end")
    else:
        axes.set_xticks([z[1]], [shaft.block])
    axes.set(ylim=(-0.33 * span, 0.3 * span), xlim=(-0.06 * span, 1.06 * span), yticks=[])
    axes.grid(visible=False)
    axes.spines["left"].set_visible(False)


def _draw_bearing(axes: Axes, z: float, span: float, name: str, magnetic: bool) -> None:
    """Draw the poles of a magnet on both sides, or a spring to the ground."""
    if magnetic:
        poles = np.array([-0.185, 0.135]) * span
        axes.bar([z, z], 0.05 * span, 0.06 * span, poles, fc=MAGNET, ec=INK, lw=0.9, zorder=4)
        axes.annotate(name, (z + 0.04 * span, 0.16 * span), ha="left", va="center", fontsize=8)
        return
    x, y = z + 0.012 * span * np.array([0, 0, 1, -1, 1, -1, 1, 0, 0]), np.linspace(-0.02 * span, -0.15 * span, 9)
    axes.plot(x, y, color=INK, lw=1.0, zorder=2)
    axes.plot([z - 0.03 * span, z + 0.03 * span], [y[-1]] * 2, color=INK, lw=1.4)
    axes.annotate(name, (z, -0.165 * span), ha="center", va="top", fontsize=8)


def _acting(diagram: Diagram, shaft: _Shaft, category: str) -> dict[int, list[str]]:
    """Return node (from 0) -> blocks of a category whose force acts there."""
    acting: dict[int, list[str]] = {}
    for wire in diagram.wires:
        k, name = shaft.node(wire.target.index), wire.source.block
        onto = (wire.target.block, wire.target.port) == (shaft.block, "force")
        if onto and k is not None and category in diagram.nodes[name].block.roles:
            acting.setdefault(k, []).append(name)
    return {k: list(dict.fromkeys(names)) for k, names in acting.items()}


def _probes(shaft: _Shaft, recorded: Iterable[str]) -> list[int]:
    """Return the nodes (from 0) whose displacement is recorded."""
    entries = (name.removesuffix("]").partition("[") for name in recorded)
    inside = [entry.split(",") for port, _, entry in entries if port == f"{shaft.block}.displacement"]
    nodes = {shaft.node((int(index[0]) - 1,)) for index in inside if len(index) > 1 or shaft.only is not None}
    return sorted(k for k in nodes if k is not None and 0 <= k < len(shaft.z))


# -- probabilities -----------------------------------------------------------------------------------------------------


def _draw_bars(axes: Axes, shaft: _Shaft, places: Sequence[tuple[Spot, float]]) -> None:
    ports = list(dict.fromkeys(spot.port for spot, _ in places))
    width = min(0.05 * float(np.ptp(shaft.z)), 0.6 * float(np.diff(np.sort(shaft.z)).min()) / max(len(ports), 1))
    for spot, probability in places:
        k, number = shaft.only if spot.node is None else spot.node - 1, ports.index(spot.port)
        if k is None or not 0 <= k < len(shaft.z):
            continue
        colour, hatch = PORTS[number % len(PORTS)]
        z, label = float(shaft.z[k]) + width * (number - (len(ports) - 1) / 2), f"{shaft.block}.{spot.port}"
        axes.bar(z, probability, width, color=colour, alpha=0.55, hatch=hatch, ec=colour, label=label)
        axes.annotate(f"{probability:.2f}", (z, probability), ha="center", va="bottom", fontsize=8)
    axes.set(ylim=(0, 1.15), yticks=[0, 0.5, 1.0], ylabel="probability")
    axes.tick_params(labelbottom=False)


def _draw_others(axes: Axes, places: Sequence[tuple[Spot, float]]) -> None:
    bars = axes.barh(range(len(places)), [p for _, p in places], color=RED, alpha=0.55, height=0.6)
    axes.bar_label(bars, fmt=" %.2f", fontsize=8)
    axes.set_yticks(range(len(places)), [spot.words for spot, _ in places])
    axes.set(ylim=(max(len(places), 2) - 0.4, -0.6), xlim=(0, 1.15), xlabel="probability")
    axes.set_title("elsewhere in the diagram", loc="left")


def block_diagram(
    diagram: Diagram, places: Sequence[PlaceClass], new: Iterable[str], signals: Sequence[MissingSignal] = ()
) -> str:
    """Return the SVG of a diagram: blocks framed by the probability that the fault acts there, new ones in blue.

    signals: missing in time; then wires are marked, with the class of places and its probability.
    """
    wires = {
        (spot.block, spot.port): (shade(probability), f"{letter} {probability:.2f} {READING[spot.side]}".rstrip())
        for letter, spots, probability in reversed(place_classes(signals))
        for spot in spots
    }
    frames = {
        spot.block: shade(one.probability)
        for one in sorted(places, key=lambda one: one.probability)
        for spot in one.places
        if (spot.block, spot.port) not in wires
    }
    frames |= dict.fromkeys(new, NEW)
    return draw_svg(diagram, {block: colour for block, colour in frames.items() if block in diagram.nodes}, wires)


def shade(probability: float) -> str:
    """Return the colour of a place."""
    return next(colour for least, colour in SHADES if probability >= least)


def place_classes(signals: Sequence[MissingSignal]) -> list[tuple[str, tuple[Spot, ...], float]]:
    """Return the classes of places of missing signals with their letters (and the number of the signal, of several)."""
    return [
        (f"{number + 1 if len(signals) > 1 else ''}{chr(ord('A') + k)}", one.places, one.probability)
        for number, signal in enumerate(signals)
        for k, one in enumerate(signal.classes)
        if one.probability >= CRITERIA.listed
    ]
