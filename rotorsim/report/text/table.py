"""Tables of text, and the units in which values stand in them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any


def table(header: Sequence[str], lines: Iterable[Sequence[str]], *, left: Collection[int] = (0,)) -> str:
    """Return columns aligned: some to the left, the others to the right."""
    rows = [header, *lines]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    sides = [str.ljust if k in left else str.rjust for k in range(len(widths))]
    text = ([to(cell, width) for to, cell, width in zip(sides, row, widths, strict=True)] for row in rows)
    return "\n".join("  ".join(cells).rstrip() for cells in text)


def counted(number: int, word: str) -> str:
    """Return ``1 run`` or ``2 runs``."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def display_unit(unit: str) -> tuple[str, float]:
    """Return the unit to show and the factor from SI: micrometres for metres, else as it is."""
    return ("um", 1e6) if unit == "m" else (unit or "1", 1.0)


def parameter_unit(unit: str) -> tuple[str, float]:
    """Return the unit in which a parameter is shown and the factor from SI: micrometres, degrees, else as it is."""
    return {"m": ("um", 1e6), "rad": ("deg", 180 / math.pi)}.get(unit, (unit, 1.0))


def percent(share: float | None) -> str:
    """Return a share in percent, "-" for none."""
    return "-" if share is None or not math.isfinite(share) else f"{100 * share:.3g} %"


def rpm(speed: Any) -> Any:
    """Return a speed [rad/s], or an array of them, in rpm."""
    return speed * 30 / math.pi


def degrees(value: complex) -> float:
    """Return the phase of a complex amplitude in degrees."""
    return math.degrees(math.atan2(value.imag, value.real))
