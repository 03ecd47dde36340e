"""Simulated measurements of loops: a sine sweep injected at ports of a diagram, as on a machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import pi
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.edit import add_signal
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.loop import RATE, SENSOR, injections
from rotorsim.recordings.injection import AFTER, BEFORE, TEST

SWEPT = 0.95  # of the window: what it leaves behind is recorded, too


@dataclass(frozen=True)
class Sweep:
    """A logarithmic sine sweep: frequencies [Hz], amplitude [SI, 0-peak] by port."""

    first: float
    last: float
    amplitude: dict[str, float]


@dataclass(frozen=True)
class Injected:
    """A document with sweeps at ports. signals: recorded ones -> port, role, unit; sources, shapes: of the ports.

    axes: entries of ports at which it is injected.
    """

    document: dict[str, Any]
    signals: dict[str, tuple[str, str, str]] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    shapes: dict[str, tuple[int, ...]] = field(default_factory=dict)
    axes: tuple[str, ...] = ()

    def cases(self, sweep: Sweep) -> list[tuple[str, dict[str, Any]]]:
        """Return the axes, and the parameters with which only each of them is injected at."""
        quiet = {f"{source}.amplitude": np.zeros(self.shapes[port]) for port, source in self.sources.items()}
        found = []
        for port, source in self.sources.items():
            for entry in np.ndindex(*self.shapes[port]):
                amplitude = np.zeros(self.shapes[port])
                amplitude[entry] = sweep.amplitude[port]
                index = ",".join(str(k + 1) for k in entry)
                name = f"{port}[{index}]" if index else port
                if name in self.axes:
                    found.append((name, {**quiet, f"{source}.amplitude": amplitude}))
        return found


def with_sweeps(diagram: Diagram, ports: Sequence[str], sweep: Sweep, window: tuple[float, float]) -> Injected:
    """Return the document of a diagram with a sweep within a window [s] at each of some ports.

    With the ``displacement`` of a controller its wired velocity is disturbed by the rate of the sweep.
    Raises RotorsimError for ports that do not exist or are not single signals, and for those within sub-diagrams.
    """
    axes = tuple(one.name for one in injections(diagram, ports) if one.rate_of is None)
    ports = list(dict.fromkeys(port.partition("[")[0] for port in ports))
    inside = [port for port in ports if "/" in port]
    if inside:
        hint = "record the sub-diagram alone"
        raise RotorsimError(*(Problem("a port within a sub-diagram", port, hint=hint) for port in inside))
    made = Injected(dict(diagram.document), axes=axes)
    for k, port in enumerate(ports, 1):
        name = f"injection{k}" if len(ports) > 1 else "injection"
        while any(taken.startswith(f"{name}_") for taken in diagram.nodes):
            name += "x"
        block, _, key = port.rpartition(".")
        node = diagram.nodes[block]
        is_output = key in node.outputs
        declared = (node.outputs if is_output else node.inputs)[key]
        shape, unit = declared.shape, declared.unit or "1"
        document = add_signal(made.document, port, f"{name}_test.output", name, is_output=is_output)
        document["blocks"][f"{name}_test"] = {
            "type": "chirp",
            "parameters": {
                "amplitude": np.zeros(shape).tolist(),
                "first": 2 * pi * sweep.first,
                "last": 2 * pi * sweep.last,
                "start": window[0],
                "duration": SWEPT * (window[1] - window[0]),
            },
        }
        fed = {f"{wire.target.block}.{wire.target.port}" for wire in diagram.wires}
        if key == SENSOR and f"{block}.{RATE}" in fed and not is_output:
            document = add_signal(document, f"{block}.{RATE}", f"{name}_test.rate", f"{name}_rate", is_output=False)
        signals = {f"{name}_{role}.output": (port, role, unit) for role in (TEST, BEFORE, AFTER)}
        made = Injected(
            document,
            {**made.signals, **signals},
            {**made.sources, port: f"{name}_test"},
            {**made.shapes, port: shape},
            axes,
        )
    return made
