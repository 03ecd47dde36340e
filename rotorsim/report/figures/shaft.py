"""A rotor from the side, to scale, with what is wired to it: magnets, probes, unbalance, cracks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle, Wedge
from matplotlib.patheffects import withStroke

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, figure, styled

STEEL, DISC, SLEEVE, BORE = "#9fb4c4", "#5f7d95", "#b9a68c", "white"
MARK_COLOURS = {
    "magnet": ORANGE,
    "bearing": BLUE,
    "probe": GREEN,
    "reading": GREY,
    "unbalance": RED,
    "crack": PURPLE,
    "force": INK,
    "pin": INK,
}
ABOVE = ("magnet", "bearing", "unbalance", "crack", "force")  # what acts; what sees is labelled below
FACES = ("controller", "bearing", "rotor", "casing")  # blocks at which the way of a signal ends
LABEL_CLEAR = {ORANGE: 0.036, GREEN: 0.025, GREY: 0.025, INK: 0.05}  # of the length: where the line to a label begins
WIDTH = 9.0  # in
CHARACTER = 0.068  # in: of a label


@dataclass(frozen=True)
class Mark:
    """Something at a row (from 0) of the ports of a rotor: its kind, one of `MARK_COLOURS`, and the block."""

    row: int
    kind: str
    block: str


def shaft_of(diagram: Diagram, block: str = "") -> tuple[str, Any]:
    """Return the name and the `Drawing` of a rotor, the first one that has a shaft unless it is named.

    Raises RotorsimError where there is none.
    """
    if block and block not in diagram.nodes:
        raise RotorsimError(Problem(f"no block '{block}'", block, hint=near_miss(block, diagram.nodes)))
    for name, node in diagram.nodes.items():
        drawing = getattr(node.block, "drawing", None)
        if drawing is not None and name == (block or name):
            return name, drawing(node.values)
    what = f"'{block}' has no shaft to draw" if block else "no rotor with a shaft to draw"
    raise RotorsimError(Problem(what, diagram.name, hint="rotor_drawing and rotor_fe have one"))


def marks_of(diagram: Diagram, rotor: str) -> tuple[Mark, ...]:
    """Return what acts at the rows of a rotor and what is seen there.

    A magnet is a bearing with a current, found through the wires of its force; a probe is where a controller reads.
    """
    found: dict[Mark, None] = {}
    for wire in diagram.wires:
        if wire.target.block == rotor and wire.target.port in ("force", "moment") and wire.target.index:
            for kind, name in _acting(diagram, wire.source.block):
                found[Mark(wire.target.index[0], kind, name)] = None
        if wire.source.block == rotor and wire.source.port in ("displacement", "velocity") and wire.source.index:
            reached = [*_reached(diagram, wire.target.block)]
            seeing = [name for name in reached if diagram.nodes[name].block.category == "controller"]
            for name in seeing if wire.source.port == "displacement" else ():
                found[Mark(wire.source.index[0], "probe", name)] = None
    probes = {mark.row for mark in found if mark.kind == "probe"}
    for end in diagram.record:
        if end.block == rotor and end.port == "displacement" and end.index and end.index[0] not in probes:
            found[Mark(end.index[0], "reading", "recorded")] = None
    return tuple(found)


def _reached(diagram: Diagram, block: str) -> Iterator[str]:
    """Yield a block and those behind it, up to controllers, bearings and rotors."""
    waiting, seen = [block], {block}
    while waiting:
        at = waiting.pop(0)
        yield at
        if diagram.nodes[at].block.category in FACES:
            continue
        after = [wire.target.block for wire in diagram.wires if wire.source.block == at]
        waiting += [name for name in dict.fromkeys(after) if name not in seen]
        seen.update(after)


def _acting(diagram: Diagram, block: str) -> list[tuple[str, str]]:
    """Return kind and name of what makes a force: the block itself, or the bearing before sums and gains."""
    node = diagram.nodes[block]
    kind = node.block.type_name
    if node.block.category == "bearing" or "bearing" in node.block.roles:
        return [("magnet" if "current" in node.inputs else "bearing", block)]
    if node.block.category != "elementary":
        kinds = [word for word in ("unbalance", "crack") if word in kind]
        return [(kinds[0] if kinds else "force", block)]
    before = [wire.source.block for wire in diagram.wires if wire.target.block == block]
    bearings = [name for name in dict.fromkeys(before) if "bearing" in diagram.nodes[name].block.roles]
    return [one for name in bearings for one in _acting(diagram, name)] or [("force", block)]


@styled()
def shaft_figure(diagram: Diagram, title: str = "", *, block: str = "") -> Figure:
    """Return a rotor from the side, both axes in mm to one scale, with what is wired to its stations or nodes.

    block: of several rotors. Discs given by mass and inertias are drawn as the solid cylinder that has these, dashed.
    Magnets and probes stand where they are along the axis; their size is a symbol. Raises RotorsimError.
    """
    name, shaft = shaft_of(diagram, block)
    marks = marks_of(diagram, name)
    length = 1e3 * shaft.length
    outer = [value for one in (*shaft.sections, *shaft.sleeves) for value in one.diameters[0]]
    radius = 500.0 * max(*outer, *(disc.outer for disc in shaft.discs))
    reach = max(radius, 0.11 * length)
    centre = 1e3 * shaft.centre_of_gravity
    handles = _legend(shaft, marks, centre)
    rows = -(-len(handles) // 4)
    height = (WIDTH - 0.7) * (2 * reach + 0.24 * length) / (1.12 * length) + 0.95 + 0.22 * rows
    text = title or f"{diagram.name}: {name}, {length:.4g} mm, {shaft.mass:.4g} kg"
    made = figure(WIDTH, min(height, 9.0), text)
    axes = made.add_subplot()
    axes.set_aspect("equal")
    axes.grid(visible=False)
    _draw_shaft(axes, shaft)
    _draw_marks(axes, shaft, marks, length)
    tags = _tags(shaft, marks)
    for side in (1, -1):
        _draw_tags(axes, [tag for tag in tags if tag[0] == side], side * (reach + 0.05 * length), length)
    _draw_centre(axes, centre, 0.011 * length)
    axes.set(
        xlabel="along the shaft [mm]",
        ylabel="[mm]",
        xlim=(-0.06 * length, 1.06 * length),
        ylim=(-reach - 0.12 * length, reach + 0.12 * length),
    )
    made.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))
    return made


def _draw_shaft(axes: Axes, shaft: Any) -> None:
    edge: dict[str, Any] = {"ec": INK, "lw": 0.8}
    for one in shaft.sections:
        outer, inner = ([500 * value for value in pair] for pair in one.diameters)
        wall = _piece(one, outer, [-r for r in outer])
        axes.add_patch(Polygon(wall, fc=STEEL, alpha=0.55, zorder=2))
        axes.add_patch(Polygon(wall, fill=False, zorder=3, **edge))
        if max(inner) > 0:
            bore = _piece(one, inner, [-r for r in inner])
            axes.add_patch(Polygon(bore, fc=BORE, ec=INK, lw=0.6, ls=(0, (4, 2)), zorder=2.5))
    for one in shaft.sleeves:
        outer, inner = ([500 * value for value in pair] for pair in one.diameters)
        for sign in (1, -1):
            both = _piece(one, [sign * r for r in outer], [sign * r for r in inner])
            axes.add_patch(Polygon(both, fc=SLEEVE, alpha=0.6, zorder=2.2, **edge))
    for disc in shaft.discs:
        begin, width, outer = 1e3 * (disc.position - disc.width / 2), 1e3 * disc.width, 500 * disc.outer
        look: dict[str, Any] = {"fc": DISC, "alpha": 0.6, "zorder": 2.2} if disc.drawn else {"fill": False, "zorder": 3}
        frame: dict[str, Any] = edge if disc.drawn else {**edge, "ls": "--"}
        inner = 500 * disc.inner
        if not disc.outer:  # a mass without inertia has no size
            axes.plot(1e3 * disc.position, 0, "|", ms=26, mew=2.5, color=INK, zorder=3)
            continue
        for bottom, high in ((inner, outer - inner), (-outer, outer - inner)) if inner else ((-outer, 2 * outer),):
            axes.add_patch(Rectangle((begin, bottom), width, high, **{**frame, **look}))
    axes.plot(
        [-0.02e3 * shaft.length, 1.02e3 * shaft.length], [0, 0], color=GREY, lw=0.7, ls=(0, (9, 2, 2, 2)), zorder=3
    )
    ticks = [1e3 * z for z in shaft.stations]
    axes.plot(ticks, [0.0] * len(ticks), "o", ms=2.6, color=INK, zorder=4)
    outline: Any = {"path_effects": [withStroke(linewidth=2, foreground="white", alpha=0.8)]}
    for k, z in enumerate(ticks, start=1):
        axes.annotate(
            f"{k}", (z, 0), (0, 2.2), textcoords="offset points", ha="center", fontsize=6.5, zorder=6, **outline
        )


def _piece(one: Any, above: list[float], below: list[float]) -> list[tuple[float, float]]:
    """Return the corners [mm] of a section between two lines, each given at both of its ends."""
    begin, end = 1e3 * one.begin, 1e3 * one.end
    return [(begin, above[0]), (end, above[1]), (end, below[1]), (begin, below[0])]


def _surface(shaft: Any, z: float, discs: bool = False) -> float:
    """Return the radius [mm] of the shaft at z, of a disc that covers it where these count."""
    here = [one for one in (*shaft.sections, *shaft.sleeves) if one.begin - 1e-9 <= z <= one.end + 1e-9]
    found = [float(np.interp(z, (one.begin, one.end), one.diameters[0])) for one in here]
    if discs:
        found += [one.outer for one in shaft.discs if abs(one.position - z) <= one.width / 2 + 1e-9]
    return 500.0 * max(found, default=0.0)


def _draw_marks(axes: Axes, shaft: Any, marks: tuple[Mark, ...], length: float) -> None:
    for one in marks:
        z = shaft.stations[one.row]
        at, on, colour = 1e3 * z, _surface(shaft, z), MARK_COLOURS[one.kind]
        if one.kind == "magnet":
            for low in (on + 0.005 * length, -on - 0.035 * length):
                axes.add_patch(
                    Rectangle(
                        (at - 0.01 * length, low), 0.02 * length, 0.03 * length, fc=colour, ec=INK, lw=0.6, zorder=4
                    )
                )
        elif one.kind == "bearing":
            _spring(axes, at, -on, length)
        elif one.kind in ("probe", "reading"):
            tip = on + 0.004 * length
            points = [(at, tip), (at - 0.006 * length, tip + 0.02 * length), (at + 0.006 * length, tip + 0.02 * length)]
            for sign in (1, -1):
                shape = [(x, sign * y) for x, y in points]
                axes.add_patch(Polygon(shape, fc=colour, ec=INK, lw=0.5, zorder=4.5))
        elif one.kind == "unbalance":
            far = _surface(shaft, z, discs=True)
            axes.plot(at, 0.86 * far, "o", ms=5, color=colour, mec=INK, mew=0.5, zorder=5)
        elif one.kind == "crack":
            x = [at + 0.004 * length * (-1) ** k for k in range(6)]
            axes.plot(x, [1.15 * on - 0.23 * on * k for k in range(6)], color=colour, lw=1.8, zorder=5)
        else:
            axes.annotate("", (at, on), (at, on + 0.05 * length), arrowprops={"arrowstyle": "-|>", "color": colour})
    for z in shaft.pinned:
        axes.plot(1e3 * z, -_surface(shaft, z), "^", ms=9, mfc="white", mec=INK, zorder=4)


def _spring(axes: Axes, at: float, top: float, length: float) -> None:
    """Draw a spring from the shaft down to the ground."""
    step, side = 0.008 * length, 0.006 * length
    x = [at, at, *(at + side * (-1) ** k for k in range(4)), at, at]
    y = [top - step * k / 1.3 for k in range(len(x))]
    axes.plot(x, y, color=MARK_COLOURS["bearing"], lw=1.4, zorder=4)
    axes.plot([at - 2 * side, at + 2 * side], [y[-1], y[-1]], color=INK, lw=1.4, zorder=4)


def _draw_centre(axes: Axes, at: float, radius: float) -> None:
    axes.add_patch(Circle((at, 0), radius, fc="white", ec=INK, lw=0.8, zorder=5))
    for begin in (0, 180):
        axes.add_patch(Wedge((at, 0), radius, begin, begin + 90, fc=INK, zorder=5.1))


def _tags(shaft: Any, marks: tuple[Mark, ...]) -> list[tuple[int, float, float, str, str]]:
    """Return side (1 above), position [mm], where its line begins [mm], colour and text of every label."""
    tags = []
    for row, above in sorted({(mark.row, mark.kind in ABOVE) for mark in marks}):
        here = [mark for mark in marks if mark.row == row and (mark.kind in ABOVE) == above]
        z = shaft.stations[row]
        own = shaft.names[row] if shaft.names else ""
        names = list(dict.fromkeys(mark.block for mark in here))
        lines = [*([own] if own else []), *(name for name in names if name != own), f"{1e3 * z:.4g} mm"]
        is_unbalance = any(mark.kind == "unbalance" for mark in here)
        on = 0.86 * _surface(shaft, z, discs=True) if is_unbalance else _surface(shaft, z)
        tags.append((1 if above else -1, 1e3 * z, on, MARK_COLOURS[here[0].kind], "\n".join(lines)))
    return tags


def _draw_tags(axes: Axes, tags: list[tuple[int, float, float, str, str]], level: float, length: float) -> None:
    """Write labels in one row, moved apart where they would lie on each other, each with a line to its place."""
    scale = 1.12 * length / (WIDTH - 0.7)  # mm an inch
    widths = [CHARACTER * scale * max(map(len, text.split("\n"))) for *_, text in tags]
    at = spread([tag[1] for tag in tags], widths)
    for (side, z, on, colour, text), x in zip(tags, at, strict=True):
        clear = on + LABEL_CLEAR.get(colour, 0.0) * length
        knee = side * max(clear, abs(level) - 0.03 * length)
        axes.plot([z, z, x], [side * clear, knee, level], color=colour, lw=0.8, zorder=3.5)
        vertical = "bottom" if side > 0 else "top"
        axes.annotate(text, (x, level), ha="center", va=vertical, fontsize=7.5, color=INK, linespacing=1.15)


def spread(wanted: list[float], widths: list[float]) -> list[float]:
    """Return places in the same order, as near to those wanted as labels of these widths allow (pooled means)."""
    groups: list[tuple[list[int], float]] = []  # members, sum of where each would have the first one stand
    offsets, total = [], 0.0
    for k, width in enumerate(widths):
        total += (widths[k - 1] + width) / 2 if k else 0.0
        offsets.append(total)
    for k in sorted(range(len(wanted))):
        groups.append(([k], wanted[k] - offsets[k]))
        while len(groups) > 1 and groups[-2][1] / len(groups[-2][0]) > groups[-1][1] / len(groups[-1][0]):
            members, moved = groups.pop()
            groups[-1] = groups[-1][0] + members, groups[-1][1] + moved
    return [moved / len(members) + offsets[k] for members, moved in groups for k in members]


def _legend(shaft: Any, marks: tuple[Mark, ...], centre: float) -> list[Any]:
    handles: list[Any] = [Patch(fc=STEEL, alpha=0.55, ec=INK, label="shaft")]
    if any(max(one.diameters[1]) > 0 for one in shaft.sections):
        handles.append(Patch(fc=BORE, ec=INK, ls="--", lw=0.6, label="bore"))
    if shaft.sleeves:
        handles.append(Patch(fc=SLEEVE, alpha=0.6, ec=INK, label="sleeve"))
    if any(disc.drawn for disc in shaft.discs):
        handles.append(Patch(fc=DISC, alpha=0.6, ec=INK, label="disc"))
    if any(not disc.drawn for disc in shaft.discs):
        handles.append(Patch(fill=False, ec=INK, ls="--", label="disc of this mass and inertia"))
    shapes = {
        "magnet": "s",
        "bearing": "$\\wr$",
        "probe": "v",
        "reading": "v",
        "unbalance": "o",
        "crack": "|",
        "force": "$\\downarrow$",
    }
    words = {"bearing": "bearing", "magnet": "magnet (symbol)", "probe": "probe (symbol)", "reading": "recorded"}
    for kind in dict.fromkeys(mark.kind for mark in marks):
        look: dict[str, Any] = {"marker": shapes[kind], "color": MARK_COLOURS[kind], "ls": "", "ms": 7}
        handles.append(Line2D([], [], label=words.get(kind, kind), **look))
    if shaft.pinned:
        handles.append(Line2D([], [], marker="^", mfc="white", mec=INK, ls="", ms=8, label="pin"))
    handles.append(Line2D([], [], marker="o", color=INK, ls="", ms=3, label=f"{shaft.station} (row of the ports)"))
    handles.append(
        Line2D(
            [],
            [],
            marker="o",
            mfc="white",
            mec=INK,
            ls="",
            ms=8,
            fillstyle="top",
            markerfacecoloralt=INK,
            label=f"centre of gravity, {centre:.4g} mm",
        )
    )
    return handles
