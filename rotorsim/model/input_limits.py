"""Limits of inputs: beyond, the equations of a block do not hold, and what was computed is no motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from rotorsim.block import Block
from rotorsim.diagram.diagram import Diagram, Endpoint


@dataclass(frozen=True)
class InputLimit:
    """An input of a block, the signal that is wired to it, and the magnitude below which the equations hold."""

    block: str
    port: str
    source: Endpoint
    limit: float
    unit: str


def input_limits(diagram: Diagram, given: Mapping[str, np.ndarray] | None = None) -> list[InputLimit]:
    """Return the limits that blocks state of their inputs (`rotorsim.block.Block.holds_below`).

    given: values of parameters by name ("amb.bias_current"), flat.
    """
    known, limits = given or {}, []
    for name, node in diagram.nodes.items():
        if type(node.block).holds_below is Block.holds_below:
            continue
        values = {key: known.get(f"{name}.{key}", node.values[key]) for key in node.block.parameters}
        single = {key: float(np.ravel(value)[0]) if np.size(value) == 1 else value for key, value in values.items()}
        for port, limit in node.block.holds_below(SimpleNamespace(**single)).items():
            sources = [w.source for w in diagram.wires if (w.target.block, w.target.port) == (name, port)]
            limits += [InputLimit(name, port, end, float(limit), node.inputs[port].unit or "") for end in sources]
    return limits


def passed_limit(limits: Sequence[InputLimit], time: np.ndarray, signals: Mapping[str, np.ndarray]) -> str:
    """Return which input went furthest beyond its limit, and since when; empty where none did. signals: (n, ...)."""
    worst: tuple[float, str] = (1.0, "")
    for item in limits:
        values = _values(item.source, signals)
        if values is None:
            continue
        size = np.abs(values).reshape(len(time), -1).max(axis=1, initial=0.0)
        share = float(size.max(initial=0.0)) / item.limit
        if share >= worst[0]:
            first = float(time[int(np.argmax(size >= item.limit))])
            text = (
                f"its equations hold below a {item.port} of {item.limit:.4g} {item.unit}; '{item.source}' passes it at "
                f"t = {first:.4g} s and reaches {size.max():.4g} {item.unit}"
            )
            worst = share, f"{item.block}: {text}"
    return worst[1]


def _values(source: Endpoint, signals: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Return a signal, or the part of it that is wired, from signals that may hold the whole."""
    whole = signals.get(f"{source.block}.{source.port}")
    if whole is None:
        return signals.get(str(source))
    return np.asarray(np.moveaxis(whole, 0, -1)[source.index]).T
