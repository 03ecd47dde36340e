"""Figure of a root locus."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from rotorsim.report.style import GREY, INK, RED, figure, styled

if TYPE_CHECKING:
    from rotorsim.linear.control.root_locus import RootLocus

HIGHEST_SHOWN = 2000.0  # Hz
RATIOS = (0.05, 0.1, 0.2, 0.4, 0.7)  # damping ratios whose lines are drawn


@styled()
def root_locus_figure(found: RootLocus, title: str = "") -> Figure:
    """Return the poles over a parameter, its value in colour: real part, and frequency; those that grow stand right.

    Crosses are the first value, squares the last; lines are damping ratios. Poles to 2 kHz that force may bring to
    resonance, and those that grow. Hollow: with samplers, poles whose frequency may as well be that of another image.
    """
    made = figure(7.5, 5.4, title or str(found.provenance.get("diagram", "")))
    axes = made.add_subplot()
    hz = found.poles.imag / (2 * np.pi)
    with np.errstate(invalid="ignore"):
        shown = (found.resonant | (found.poles.real > 0)) & (hz <= HIGHEST_SHOWN)
    colour = np.broadcast_to(found.values[:, None], found.poles.shape)
    folded = np.isfinite(found.modulo)
    sure, unsure = shown & ~folded, shown & folded
    low, high = float(found.values.min()), float(found.values.max())
    dots = axes.scatter(
        found.poles.real[sure], hz[sure], c=colour[sure], s=9, cmap="viridis", lw=0, vmin=low, vmax=high
    )
    if unsure.any():
        name = f"frequency modulo {np.nanmax(found.modulo):.6g} Hz"
        axes.scatter(
            found.poles.real[unsure],
            hz[unsure],
            s=14,
            facecolors="none",
            edgecolors=dots.to_rgba(colour[unsure]).tolist(),
            lw=0.7,
            label=name,
        )
    for row, marker, name in ((0, "x", "first value"), (-1, "s", "last value")):
        own = shown[row]
        axes.plot(found.poles.real[row, own], hz[row, own], marker, mec=INK, mfc="none", ms=5, ls="", label=name)
    axes.axvline(0.0, color=RED, lw=0.9)
    low, high = axes.get_xlim()
    top = max(float(hz[shown].max(initial=1.0)) * 1.08, 1.0)
    low = min(low, 0.0)
    for ratio in RATIOS:
        slope = np.sqrt(1 - ratio**2) / ratio / (2 * np.pi)
        end = min(-low, top / slope)
        label = "damping ratio" if ratio == RATIOS[0] else None
        axes.plot([0.0, -end], [0.0, end * slope], color=GREY, lw=0.5, ls=":", label=label)
        axes.annotate(f"{ratio:g}", (-end, end * slope), fontsize=7, color=GREY)
    axes.set(xlabel="real part [1/s]", ylabel="frequency [Hz]", xlim=(low, max(high, -0.03 * low)), ylim=(0.0, top))
    unit = "" if found.unit == "1" else f" [{found.unit}]"
    made.colorbar(dots, ax=axes, label=f"{found.parameter}{unit}")
    axes.legend(loc="best")
    return made
