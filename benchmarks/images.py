"""Pictures of the documents: small PNG files, the same bytes from the same versions of matplotlib and Pillow."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import cKDTree

from rotorsim.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, styled

__all__ = ["save_png", "shrink_png"]

COLOURS = 256  # of a palette: the most frequent ones, and those of lines, which may be rare
LINES = (BLUE, ORANGE, GREEN, RED, PURPLE, GREY, INK)
WIDEST = 1100  # pixels


def save_png(made: Figure, file: Path, dots: int = 100) -> None:
    """Write a figure with so many dots per inch, in a palette, without dates and versions."""
    drawn = io.BytesIO()
    with styled():
        made.savefig(drawn, format="png", dpi=dots)
    drawn.seek(0)
    _write(Image.open(drawn), file)


def shrink_png(drawn: Path, file: Path) -> None:
    """Write a picture that a command drew in a palette, and no wider than a page shows it."""
    with Image.open(drawn) as image:
        size = (WIDEST, round(image.height * WIDEST / image.width))
        _write(image.convert("RGB").resize(size, Image.Resampling.LANCZOS) if image.width > WIDEST else image, file)


def _write(image: Image.Image, file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.asarray(image.convert("RGB"))
    colours, place, counts = np.unique(pixels.reshape(-1, 3), axis=0, return_inverse=True, return_counts=True)
    kept = np.array([[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in LINES])
    frequent = colours[np.argsort(-counts, kind="stable")[: COLOURS - len(kept)]]
    palette = np.vstack([frequent, kept])
    _, nearest = cKDTree(palette).query(colours)
    indexed = Image.fromarray(nearest[place.ravel()].reshape(pixels.shape[:2]).astype(np.uint8), mode="P")
    indexed.putpalette(palette.astype(np.uint8).tobytes())
    indexed.save(file, optimize=True)
