"""Drawings of how data flow: boxes on a grid, joined by arrows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from rotorsim.report.style import BLUE, GREEN, GREY, INK, ORANGE, styled

__all__ = ["diagnosis_flow", "engine_flow"]

FILE, ROOM, RESULT, CHOICE = ("#f2f2f2", GREY), ("#e3eff7", BLUE), ("#e2f3ed", GREEN), ("#fcf1dc", ORANGE)
WIDE, HIGH = 2.15, 0.78


@dataclass(frozen=True)
class Box:
    """A box about (x, y): a title, what it holds in small letters, and its kind by colour."""

    x: float
    y: float
    title: str
    text: str = ""
    look: tuple[str, str] = ROOM
    width: float = WIDE
    height: float = HIGH


@dataclass(frozen=True)
class Arrow:
    """An arrow from a side of one box to a side of another (n, e, s, w), with words beside it; by way of a corner."""

    start: str
    end: str
    sides: str = "ew"
    text: str = ""
    dashed: bool = False


def engine_flow() -> Figure:
    """Return how a diagram becomes results."""
    boxes = {
        "json": Box(0, 0, "diagram.json", "blocks, wires,\nparameters", FILE, width=1.7),
        "blocks": Box(2.45, 1.2, "blocks/*.py", "ports, parameters,\nequations, once", FILE),
        "parse": Box(2.45, 0, "diagram.parse", "document: JSON with\nplaces, checked, flat"),
        "resolve": Box(5.05, 0, "diagram.resolve", "Diagram: classes,\nshapes, SI values, wires"),
        "trace": Box(7.65, 0, "model.trace", "expressions (CasADi):\nrates, outputs, Jacobians"),
        "emit": Box(10.25, 0, "model.emit", "one RK4 step as C;\nlibrary in the cache"),
        "run": Box(12.85, 0, "simulation", "Result: signals, status,\nunits, provenance"),
        "linear": Box(6.4, -1.5, "linear", "A, B, C, D: modes,\nCampbell, response"),
        "settled": Box(8.9, -1.5, "settled", "harmonics at each\nspeed, sensitivities"),
        "fmi": Box(11.4, -1.5, "fmi.export", "FMU: the same C,\nexact derivatives"),
        "out": Box(15.3, 0, "signals, report", "spectra, orders,\nfigures", RESULT, width=1.8),
        "files": Box(15.3, -1.5, "files", ".csv .h5 .npz\n.fmu", RESULT, width=1.8),
    }
    arrows = [
        Arrow("json", "parse"),
        Arrow("blocks", "resolve", "en"),
        Arrow("parse", "resolve"),
        Arrow("resolve", "trace"),
        Arrow("trace", "emit"),
        Arrow("emit", "run"),
        Arrow("trace", "linear", "sn"),
        Arrow("trace", "settled", "sn"),
        Arrow("emit", "fmi", "sn"),
        Arrow("run", "out"),
        Arrow("run", "files", "sn"),
        Arrow("fmi", "files"),
    ]
    return _drawn(boxes, arrows, "From a diagram to results")


def diagnosis_flow() -> Figure:
    """Return how a diagram and a recording become a diagnosis."""
    boxes = {
        "recording": Box(0, 0, "recording", "runs, channels,\npulses", FILE, width=1.7),
        "diagram": Box(0, -1.5, "diagram", "with free\nparameters", FILE, width=1.7),
        "signals": Box(2.45, 0, "signals", "shaft angle, harmonics\nwith covariance, noise"),
        "evidence": Box(
            5.2, -0.75, "diagnosis.evidence", "harmonics, samples in time\nor resonances: residual", width=2.4
        ),
        "base": Box(8.05, -0.75, "base fit", "free parameters refitted:\nis the residual noise?", CHOICE, width=2.3),
        "catalogue": Box(8.05, -2.3, "diagnosis.catalogue", "every fault at every\nplace where it fits", width=2.3),
        "search": Box(10.8, -2.3, "diagnosis.search", "refit each; forward\nselection by criterion"),
        "hold": Box(13.5, -2.3, "hold-out runs", "does the repair predict\nwhat it has not seen?", CHOICE, width=2.3),
        "consistent": Box(10.8, 0.35, "consistent", "smallest detectable\nsize of each fault", RESULT),
        "conclude": Box(
            13.5, -0.75, "diagnosis.conclude", "verdict, class, places,\nunknown force, next run", width=2.3
        ),
        "result": Box(16.2, -0.75, "diagnosis.json", "diagram.json repaired,\nreport.html", RESULT),
    }
    arrows = [
        Arrow("recording", "signals"),
        Arrow("signals", "evidence", "en"),
        Arrow("diagram", "evidence", "es"),
        Arrow("evidence", "base"),
        Arrow("base", "consistent", "nw", "yes"),
        Arrow("base", "catalogue", "sn", "no"),
        Arrow("catalogue", "search"),
        Arrow("search", "hold"),
        Arrow("hold", "conclude", "ns"),
        Arrow("hold", "search", "ss", "another effect", dashed=True),
        Arrow("consistent", "conclude", "en"),
        Arrow("conclude", "result"),
    ]
    return _drawn(boxes, arrows, "From a diagram and a recording to a diagnosis")


def _drawn(boxes: dict[str, Box], arrows: Sequence[Arrow], title: str) -> Figure:
    left, right = (min(b.x - b.width / 2 for b in boxes.values()), max(b.x + b.width / 2 for b in boxes.values()))
    low, high = (min(b.y for b in boxes.values()) - 0.95, max(b.y for b in boxes.values()) + 0.55)
    with styled():
        made = Figure(figsize=((right - left + 0.2) * 0.66, (high - low + 0.35) * 0.9))
        axes = made.add_axes((0, 0, 1, 1))
        axes.set(xlim=(left - 0.1, right + 0.1), ylim=(low, high + 0.35))
        axes.axis("off")
        axes.text(left, high + 0.22, title, fontsize=10.5, fontweight="bold", color=INK, va="center")
        for box in boxes.values():
            _box(axes, box)
        for arrow in arrows:
            _arrow(axes, boxes[arrow.start], boxes[arrow.end], arrow)
    return made


def _box(axes: Axes, box: Box) -> None:
    fill, edge = box.look
    corner = (box.x - box.width / 2, box.y - box.height / 2)
    style = "round,pad=0,rounding_size=0.08"
    axes.add_patch(FancyBboxPatch(corner, box.width, box.height, boxstyle=style, fc=fill, ec=edge, lw=1.0))
    axes.text(box.x, box.y + 0.2, box.title, fontsize=8.5, fontweight="bold", ha="center", va="center", color=INK)
    axes.text(box.x, box.y - 0.12, box.text, fontsize=7.3, ha="center", va="center", color=INK, linespacing=1.15)


def _side(box: Box, side: str) -> tuple[float, float]:
    across, along = {"e": (0.5, 0), "w": (-0.5, 0), "n": (0, 0.5), "s": (0, -0.5)}[side]
    return box.x + across * box.width, box.y + along * box.height


def _arrow(axes: Axes, start: Box, end: Box, arrow: Arrow) -> None:
    (x0, y0), (x1, y1) = _side(start, arrow.sides[0]), _side(end, arrow.sides[1])
    if arrow.sides == "ss":  # back, below both
        under = min(y0, y1) - 0.28
        path = [(x0, y0), (x0, under), (x1, under), (x1, y1)]
    elif arrow.sides[0] in "ew" and arrow.sides[1] in "ns":
        path = [(x0, y0), (x1, y0), (x1, y1)]
    elif arrow.sides[0] in "ns" and arrow.sides[1] in "ew":
        path = [(x0, y0), (x0, y1), (x1, y1)]
    elif arrow.sides == "sn" and abs(x1 - x0) > 0.05:
        middle = (y0 + y1) / 2
        path = [(x0, y0), (x0, middle), (x1, middle), (x1, y1)]
    else:
        path = [(x0, y0), (x1, y1)]
    line = "--" if arrow.dashed else "-"
    axes.plot(*zip(*path, strict=True), color=INK, lw=1.0, ls=line, solid_capstyle="butt")
    axes.annotate(
        "", path[-1], path[-2], arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.0, "shrinkA": 0, "shrinkB": 0}
    )
    if arrow.text:
        (a, b), (c, d) = path[-3:-1] if len(path) > 2 else path
        at = ((a + c) / 2, (b + d) / 2)
        offset = (0, -7) if arrow.sides == "ss" else (4, 0)
        place = {"ha": "center", "va": "top"} if arrow.sides == "ss" else {"ha": "left", "va": "center"}
        axes.annotate(arrow.text, at, offset, textcoords="offset points", fontsize=7.5, color=INK, **place)
