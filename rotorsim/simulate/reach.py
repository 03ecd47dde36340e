"""How far inputs of blocks may go: beyond, their equations do not hold, and what was computed is no motion."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from rotorsim.compile import Model

__all__ = ["Reach", "beyond", "reaches_of"]


@dataclass(frozen=True)
class Reach:
    """An input of a block, the signal that is wired to it, and the magnitude below which the equations hold."""

    block: str
    port: str
    source: str
    limit: float
    unit: str


def reaches_of(model: Model, p: np.ndarray) -> list[Reach]:
    """Return what blocks say of how far their inputs may go at parameters p (n_p,)."""
    found = []
    for name, node in model.diagram.nodes.items():
        own = {key: model.parameters.get(f"{name}.{key}") for key in node.block.parameters}
        values = {key: p[part] if part is not None else node.values[key] for key, part in own.items()}
        scalars = {
            key: float(value[0]) if np.size(value) == 1 and np.ndim(value) else value for key, value in values.items()
        }
        for port, limit in node.block.holds_below(SimpleNamespace(**scalars)).items():
            for wire in model.diagram.wires:
                if (wire.target.block, wire.target.port) == (name, port):
                    unit = node.inputs[port].unit or ""
                    found.append(Reach(name, port, str(wire.source), float(limit), unit))
    return found


def beyond(model: Model, reaches: list[Reach], names: tuple[str, ...], time: np.ndarray, rows: np.ndarray) -> str:
    """Return which input went furthest beyond its limit, and since when; empty where none did. rows (n, n_y)."""
    worst: tuple[float, str] = (1.0, "")
    columns = _columns(model, names)
    for item in reaches:
        size = np.abs(rows[:, columns[item.source]]).max(axis=1, initial=0.0)
        share = float(size.max(initial=0.0)) / item.limit
        if share >= worst[0]:
            first = float(time[int(np.argmax(size >= item.limit))])
            text = (
                f"its equations hold below a {item.port} of {item.limit:.4g} {item.unit}; '{item.source}' passes it at "
                f"t = {first:.4g} s and reaches {size.max():.4g} {item.unit}"
            )
            worst = share, f"{item.block}: {text}"
    return worst[1]


def _columns(model: Model, names: tuple[str, ...]) -> dict[str, slice]:
    found, at = {}, 0
    for name in names:
        size = int(np.prod(model.shape_of(name), dtype=int))
        found[name] = slice(at, at + size)
        at += size
    return found
