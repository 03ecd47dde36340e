"""One look for all figures: colours that colour-blind readers can tell apart, display units."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe & Ito (2008), "Color universal design"
BLUE, ORANGE, GREEN, RED, PURPLE, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#6b6b6b"
INK = "#222222"
MEASURED_MARK: dict[str, Any] = {"marker": "D", "ms": 4.5, "mfc": "none", "ls": "none"}
LINE_STYLES = ("-", "--", ":", "-.")  # of curves that may lie on each other
ZERO_SHARE = 1e-9  # of the largest: linear solutions are good to 1e-12, and a sensor resolves 1e-6 of its range
SHOWN_HARMONIC = 2.0  # times the noise level: a harmonic that is worth showing

_STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "savefig.dpi": 150,
    "axes.prop_cycle": cycler(color=[BLUE, ORANGE, GREEN, RED, PURPLE, GREY]),
}
_DISPLAY = {"m": (1e6, "um"), "rad": (1e6, "urad"), "m/s": (1e3, "mm/s"), "rad/s": (1.0, "rad/s")}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the style of rotorsim, leaving the user's matplotlib settings alone."""
    with mpl.rc_context(_STYLE):
        yield


@dataclass(frozen=True)
class Look:
    """What a diagram, or a set of runs, is called in figures and tables, and how it is drawn."""

    label: str
    colour: str
    marker: str = "o"
    line: str = "-"
    size: float = 7.0


def figure(width: float, height: float, title: str) -> Figure:
    """Return an empty figure with a title folded to its width; it belongs to no window and no global state."""
    made = Figure(figsize=(width, height), layout="constrained")
    lines = [part for line in title.splitlines() for part in wrap(line, int(9.5 * width))]
    if lines:
        made.suptitle("\n".join(lines), fontsize=11, fontweight="bold")
    return made


def legend_below(made: Figure, axes: Axes, most: int = 6) -> None:
    """Put the legend of some axes below the whole figure, every entry once, in ``most`` columns at most."""
    handles, labels = axes.get_legend_handles_labels()
    entries = dict(zip(labels, handles, strict=True))
    columns = min(len(entries), most if len(entries) != 7 else min(4, most))
    made.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=columns)


def display(values: Any, unit: str) -> tuple[np.ndarray, str]:
    """Return values and unit as shown: metres in um, tilts in urad."""
    factor, shown = _DISPLAY.get(unit, (1.0, unit or "1"))
    return np.asarray(values) * factor, shown


def order_axis(axes: Axes, low: int, high: int) -> None:
    """Mark the orders of the running speed from low to high, all or odd ones or every fourth, and zero."""
    step = 1 if high - low < 18 else 2 if high - low < 30 else 4
    ticks = [k for k in range(low, high + 1) if k % step == (1 if step > 1 else 0) or k == 0]
    axes.set_xticks(ticks, [f"{k}X" if k else "0" for k in ticks])
    axes.set_xlim(low - 0.6, high + 0.6)


def phase_line(speeds: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return speeds and phases [deg, -180..180] of complex values (n,), with a gap (NaN) where the phase wraps."""
    angle = np.degrees(np.angle(values))
    angle[~np.isfinite(values)] = np.nan
    wraps = np.flatnonzero(np.abs(np.diff(angle)) > 180) + 1
    return np.insert(np.asarray(speeds, float), wraps, np.nan), np.insert(angle, wraps, np.nan)
