"""Figures that are made and not drawn, for tests of words."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

__all__ = ["undrawn"]


def _leave_empty(figure: Figure, target: Any, **options: Any) -> None:
    if isinstance(target, str | Path):
        Path(target).touch()


@contextmanager
def undrawn() -> Iterator[None]:
    """Let nothing be drawn where a figure is saved: that takes most of the time of a report."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", _leave_empty)
        patch.setattr(FigureCanvasAgg, "print_png", lambda canvas, target: None)
        yield
