"""Where a diagnosis points: the machine drawn along its shaft with probabilities at the nodes, and in the diagram."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagram.diagram import Diagram, Node
from rotorsim.diagram.draw import draw_svg
from rotorsim.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, figure, legend_below, styled

__all__ = ["NEW", "SHADES", "block_diagram", "places_figure"]

SHADES = ((0.5, "#b33c00"), (0.1, "#f08a3c"), (0.0, "#f7c896"))  # probability from which, colour of a frame
NEW = BLUE  # frame of blocks that the diagnosis put in
PORTS = ((RED, "////"), (BLUE, "...."), (GREEN, "xxxx"), (PURPLE, "----"), (ORANGE, "++"))
OTHERS = 8  # places elsewhere that are listed
STEEL, DISC, MAGNET = "#c9d3dc", "#8fa3b5", "#d9c9e6"


@dataclass(frozen=True)
class _Shaft:
    """A rotor along its axis: z of every node, radius of every element, (node, radius, width) of discs; pinned."""

    block: str
    z: np.ndarray
    radius: np.ndarray
    discs: tuple[tuple[int, float, float], ...]
    pinned: tuple[int, ...]
    only: int | None = None  # the node that stands for the whole of a rotor without nodes

    def node(self, index: tuple[int, ...]) -> int | None:
        """Return the node (from 0) that an index of a port means."""
        return self.only if self.only is not None else index[0] if index else None


def places_figure(diagram: Diagram, places: Sequence[tuple[Spot, float]], recorded: Iterable[str]) -> Figure:
    """Return the machine along its shaft with the probability of each place, and other places beside it.

    diagram: as given. recorded: flat names of the measured signals.
    """
    shaft = _shaft(diagram)
    here = [(spot, p) for spot, p in places if shaft is not None and spot.block == shaft.block]
    there = [(spot, p) for spot, p in places if (spot, p) not in here][:OTHERS]
    with styled():
        if shaft is None:
            made = figure(7.0, 1.4 + 0.35 * max(len(there), 2), "Where it acts: probability of each place")
            _draw_others(made.add_subplot(), there, "")
            return made
        made = figure(10.5, 4.4 if here else 3.0, _title(places))
        grid = made.add_gridspec(
            2 if here else 1,
            2 if there else 1,
            height_ratios=(1.0, 1.5) if here else (1.0,),
            width_ratios=(2.6, 1.0) if there else (1.0,),
        )
        machine = made.add_subplot(grid[-1, 0])
        _draw_machine(machine, diagram, shaft, recorded)
        if here:
            bars = made.add_subplot(grid[0, 0], sharex=machine)
            _draw_bars(bars, shaft, here)
            legend_below(made, bars)
        if there:
            _draw_others(made.add_subplot(grid[:, 1]), there, "elsewhere in the diagram")
    return made


def _title(places: Sequence[tuple[Spot, float]]) -> str:
    if not places:
        return "The machine as the diagram has it; no place is suspect"
    spot, probability = places[0]
    return f"Where it acts: {spot} with probability {probability:.2f}"


# -- the machine -------------------------------------------------------------------------------------------------------


def _shaft(diagram: Diagram) -> _Shaft | None:
    """Return the first rotor of a diagram along its axis; one without nodes as a disc between two bearings."""
    for name, node in diagram.nodes.items():
        if node.block.category != "rotor" or "displacement" not in node.outputs:
            continue
        shape = node.outputs["displacement"].shape
        if len(shape) == 2 and "element_length" in node.values:
            return _finite_elements(name, node, shape[0])
        if shape == (2,):
            at = 0.35 if "tilt" in node.outputs else 0.5
            z = np.array([0.0, at, 1.0])
            return _Shaft(name, z, np.full(2, 0.016), ((1, 0.13, 0.05),), (0, 2), only=1)
    return None


def _finite_elements(name: str, node: Node, count: int) -> _Shaft:
    lengths = np.broadcast_to(node.values["element_length"], count - 1)
    z = np.concatenate([[0.0], np.cumsum(lengths)])
    span = float(z[-1])
    diameters = np.broadcast_to(node.values.get("outer_diameter", 0.02 * span), count - 1)
    radius = diameters / diameters.max() * 0.02 * span
    masses = np.atleast_1d(node.values.get("disc_mass", np.zeros(0)))
    nodes = [int(k) - 1 for k in getattr(node.block.option, "disc_nodes", ())]
    size = np.cbrt(masses / masses.max()) if masses.size and masses.max() > 0 else masses
    discs = tuple((k, 0.12 * span * float(s), 0.03 * span) for k, s in zip(nodes, size, strict=False) if s > 0)
    pinned = tuple(int(k) - 1 for k in getattr(node.block.option, "pinned_nodes", ()))
    return _Shaft(name, z, radius, discs, pinned)


def _draw_machine(axes: Axes, diagram: Diagram, shaft: _Shaft, recorded: Iterable[str]) -> None:
    span = float(shaft.z[-1] - shaft.z[0])
    for k, radius in enumerate(shaft.radius):
        z0, z1 = shaft.z[k : k + 2]
        axes.add_patch(Rectangle((z0, -radius), z1 - z0, 2 * radius, fc=STEEL, ec=INK, lw=0.8, zorder=2))
    for k, radius, width in shaft.discs:
        axes.add_patch(
            Rectangle((shaft.z[k] - width / 2, -radius), width, 2 * radius, fc=DISC, ec=INK, lw=0.9, zorder=3)
        )
    for k in shaft.pinned:
        _support(axes, float(shaft.z[k]), span)
    for k, names in _acting(diagram, shaft, "bearing").items():
        for number, name in enumerate(names):
            _magnet(axes, float(shaft.z[k]) + 0.05 * span * number, span, name, diagram.nodes[name])
    for k, names in _acting(diagram, shaft, "excitation").items():
        axes.annotate(", ".join(names), (shaft.z[k], -0.25 * span), ha="center", va="top", fontsize=7.5, color=GREY)
    for k in _probes(shaft, recorded):
        z = float(shaft.z[k]) - 0.035 * span
        axes.annotate(
            "", (z, 0.03 * span), (z, 0.19 * span), arrowprops={"arrowstyle": "-|>", "color": GREEN, "lw": 1.4}
        )
        axes.annotate("probe", (z, 0.2 * span), ha="center", va="bottom", fontsize=7.5, color=GREEN)
    if shaft.only is None:
        axes.plot(shaft.z, np.zeros(len(shaft.z)), "o", ms=3.5, color=INK, zorder=4)
        axes.set_xticks(shaft.z, [f"{k + 1}" for k in range(len(shaft.z))])
        axes.set_xlabel(f"node of {shaft.block}, {span:.3g} m from end to end")
    else:
        axes.set_xticks([shaft.z[1]], [shaft.block])
    axes.set_ylim(-0.33 * span, 0.3 * span)
    axes.set_xlim(-0.06 * span, 1.06 * span)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.spines["left"].set_visible(False)


def _support(axes: Axes, z: float, span: float) -> None:
    s = 0.03 * span
    points = [(z, -0.02 * span), (z - s, -0.02 * span - 1.7 * s), (z + s, -0.02 * span - 1.7 * s)]
    axes.add_patch(Polygon(points, closed=True, fc="white", ec=INK, lw=1.0, zorder=2))


def _magnet(axes: Axes, z: float, span: float, name: str, node: Node) -> None:
    """Draw a bearing: the poles of a magnet on both sides, or a spring to the ground."""
    if "current" in node.inputs:
        for sign in (-1, 1):
            low = 0.135 * span if sign > 0 else -0.185 * span
            axes.add_patch(
                FancyBboxPatch(
                    (z - 0.03 * span, low),
                    0.06 * span,
                    0.05 * span,
                    fc=MAGNET,
                    ec=INK,
                    lw=0.9,
                    boxstyle=f"round,pad=0,rounding_size={0.008 * span}",
                    zorder=4,
                )
            )
        axes.annotate(name, (z + 0.04 * span, 0.16 * span), ha="left", va="center", fontsize=8)
        return
    y = np.linspace(-0.02 * span, -0.15 * span, 9)
    x = z + 0.012 * span * np.array([0, 0, 1, -1, 1, -1, 1, 0, 0])
    axes.plot(x, y, color=INK, lw=1.0, zorder=2)
    axes.plot([z - 0.03 * span, z + 0.03 * span], [y[-1]] * 2, color=INK, lw=1.4)
    axes.annotate(name, (z, -0.165 * span), ha="center", va="top", fontsize=8)


def _acting(diagram: Diagram, shaft: _Shaft, category: str) -> dict[int, list[str]]:
    """Return node (from 0) -> blocks of a category whose force acts there."""
    found: dict[int, list[str]] = {}
    for wire in diagram.wires:
        source = diagram.nodes[wire.source.block]
        if wire.target.block == shaft.block and wire.target.port == "force" and source.block.category == category:
            k = shaft.node(wire.target.index)
            if k is not None and wire.source.block not in found.setdefault(k, []):
                found[k].append(wire.source.block)
    return found


def _probes(shaft: _Shaft, recorded: Iterable[str]) -> list[int]:
    found = set()
    for name in recorded:
        port, _, inside = name.partition("[")
        if port == f"{shaft.block}.displacement":
            numbers = inside.rstrip("]").split(",")
            k = shaft.node((int(numbers[0]) - 1,)) if len(numbers) > 1 or shaft.only is not None else None
            found |= {k} if k is not None and 0 <= k < len(shaft.z) else set()
    return sorted(found)


# -- probabilities -----------------------------------------------------------------------------------------------------


def _draw_bars(axes: Axes, shaft: _Shaft, places: Sequence[tuple[Spot, float]]) -> None:
    ports = list(dict.fromkeys(spot.port for spot, _ in places))
    span = float(shaft.z[-1] - shaft.z[0])
    width = min(0.05 * span, 0.6 * float(np.diff(shaft.z).min()) / max(len(ports), 1))
    for spot, probability in places:
        k = shaft.only if spot.node is None else spot.node - 1
        if k is None or not 0 <= k < len(shaft.z):
            continue
        number = ports.index(spot.port)
        colour, hatch = PORTS[number % len(PORTS)]
        z = float(shaft.z[k]) + width * (number - (len(ports) - 1) / 2)
        axes.bar(
            z, probability, width, color=colour, alpha=0.55, hatch=hatch, ec=colour, label=f"{shaft.block}.{spot.port}"
        )
        axes.annotate(f"{probability:.2f}", (z, probability), ha="center", va="bottom", fontsize=8)
    axes.set_ylim(0, 1.15)
    axes.set_yticks([0, 0.5, 1.0])
    axes.set_ylabel("probability")
    axes.tick_params(labelbottom=False)


def _draw_others(axes: Axes, places: Sequence[tuple[Spot, float]], title: str) -> None:
    names = [str(spot) for spot, _ in places]
    axes.barh(range(len(places)), [p for _, p in places], color=RED, alpha=0.55, height=0.6)
    for row, (_, probability) in enumerate(places):
        axes.annotate(f" {probability:.2f}", (probability, row), va="center", fontsize=8)
    axes.set_yticks(range(len(places)), names)
    axes.set_ylim(max(len(places), 2) - 0.4, -0.6)
    axes.set_xlim(0, 1.15)
    axes.set_xlabel("probability")
    axes.set_title(title, loc="left")


def block_diagram(diagram: Diagram, places: Sequence[tuple[Spot, float]], new: Iterable[str]) -> str:
    """Return the SVG of a diagram, its blocks framed by the probability that the fault acts there; new ones in blue."""
    probability: dict[str, float] = {}
    for spot, p in places:
        probability[spot.block] = max(probability.get(spot.block, 0.0), p)
    frames: Mapping[str, Any] = {
        block: next(colour for least, colour in SHADES if p >= least)
        for block, p in probability.items()
        if block in diagram.nodes
    }
    return draw_svg(diagram, {**frames, **{name: NEW for name in new if name in diagram.nodes}})
