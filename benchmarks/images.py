"""Pictures of the documents: small PNG files, the same bytes from the same versions of matplotlib and Pillow."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from rotorsim.report.style import styled

__all__ = ["save_png"]

COLOURS = 128  # lines, letters and what lies between them and white


def save_png(made: Figure, file: Path, dots: int = 100) -> None:
    """Write a figure with so many dots per inch, in a palette, without dates and versions."""
    drawn = io.BytesIO()
    with styled():
        made.savefig(drawn, format="png", dpi=dots)
    file.parent.mkdir(parents=True, exist_ok=True)
    with Image.open(drawn) as image:
        palette = image.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    palette.save(file, optimize=True)
