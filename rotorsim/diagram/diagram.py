"""The validated diagram: blocks with resolved shapes and SI values, wires, solver, what to record."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import Any

import networkx as nx
import numpy as np

from rotorsim.block import Block, In, Out, Shape
from rotorsim.diagram.solver import Solver
from rotorsim.errors import Place, Problem, RotorsimError, near_miss

__all__ = ["Diagram", "Endpoint", "Free", "Node", "Port", "Solver", "Wire"]


@dataclass(frozen=True)
class Port:
    """A port of one block in one diagram, with its resolved shape."""

    block: str
    name: str
    shape: Shape
    unit: str | None
    declaration: In | Out

    def __str__(self) -> str:
        return f"{self.block}.{self.name}"

    @property
    def additive(self) -> bool:
        """Whether it is an input that adds up any number of wires."""
        return self.declaration.additive


@dataclass(frozen=True)
class Endpoint:
    """One end of a wire, or a recorded signal: a port, or the part of it that ``index`` selects.

    index: counted from 0 here, from 1 in JSON and on the screen; fewer entries than the port has
    dimensions select a row (``rotor.displacement[3]`` of shape (nodes, 2) has shape (2,)).
    """

    block: str
    port: str
    index: tuple[int, ...] = ()

    def __str__(self) -> str:
        inside = ",".join(str(i + 1) for i in self.index)
        return f"{self.block}.{self.port}" + (f"[{inside}]" if inside else "")


@dataclass(frozen=True)
class Wire:
    """A connection; ``place`` is where it is written."""

    source: Endpoint
    target: Endpoint
    place: Place = field(default_factory=Place)


@dataclass
class SubPorts:
    """What the ports of a sub-diagram stand for inside; follows: its parameters -> those outside that they follow."""

    inputs: dict[str, list[Endpoint]] = field(default_factory=dict)
    outputs: dict[str, Endpoint] = field(default_factory=dict)
    follows: dict[str, str] = field(default_factory=dict)


class _Values(dict[str, np.ndarray]):
    """Values by name that cannot be changed: what was compiled from them would not follow."""

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise RotorsimError(
            Problem(
                "the values of a diagram cannot be changed",
                hint='give them to the analysis: simulate(diagram, parameters={"speed": "1800 rpm"}),'
                ' or load the diagram with them: load("jeffcott", set={"speed": "1800 rpm"})',
            )
        )

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        return _Values, (dict(self),)


def _fixed(values: Mapping[str, np.ndarray]) -> _Values:
    """Return values, none of whose entries can be written."""
    for array in values.values():
        array.flags.writeable = False
    return values if isinstance(values, _Values) else _Values(values)


@dataclass(frozen=True)
class Node:
    """A block in a diagram.

    values: every parameter as an SI array of its resolved shape. references: parameter -> name of the
    diagram parameter it follows. inputs, outputs: every port, also unwired ones. state_shapes,
    random_shapes: of the active states and random draws.
    """

    name: str
    block: Block
    values: Mapping[str, np.ndarray]
    references: Mapping[str, str]
    inputs: Mapping[str, Port]
    outputs: Mapping[str, Port]
    state_shapes: Mapping[str, Shape]
    random_shapes: Mapping[str, Shape]
    place: Place = field(default_factory=Place)

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", _fixed(self.values))


@dataclass(frozen=True)
class Free:
    """A parameter that is estimated from recordings: ``name`` with its index, or a diagram parameter.

    base: the parameter without index; entry: which of its values, row-major. value: where the search starts
    (SI). low, high: physical bounds. prior_mean, prior_std: of a normal prior, None without one. scale: a typical size,
    0 where nothing says one. series: see `rotorsim.block.Param`.
    """

    name: str
    base: str
    entry: int
    value: float
    unit: str
    low: float
    high: float
    prior_mean: float | None = None
    prior_std: float | None = None
    scale: float = 0.0
    series: bool = False


@dataclass(frozen=True, eq=False)
class Diagram:
    """A validated diagram; made by `rotorsim.model.load`, never by hand.

    parameters: diagram parameters as SI arrays. cut: input ports cut by ``--without`` (they read zero).
    document: the JSON it came from, with ``set`` in it (for fmt, swap, diff and provenance). file: its name. folder: of
    the files that it names.
    warnings: what is odd but no mistake. free: what ``identify`` leaves to be estimated. measured: what a recording
    calls the first signal is the second one here, behind the model of a sensor. trusted: whether the code that it
    brings along may run (its FMUs). structural: diagram parameter -> an option that follows it, and is compiled in.
    sub_ports: sub-diagram by its flat name -> what its ports stand for inside. removed: blocks taken out by
    ``--without``, by flat name.
    """

    name: str
    parameters: Mapping[str, np.ndarray]
    parameter_units: Mapping[str, str]
    nodes: Mapping[str, Node]
    wires: tuple[Wire, ...]
    solver: Solver
    record: tuple[Endpoint, ...]
    solve_loops: bool = False
    cut: frozenset[tuple[str, str]] = frozenset()
    document: Mapping[str, Any] = field(default_factory=dict)
    file: str = ""
    folder: str | None = None
    warnings: tuple[Problem, ...] = ()
    free: tuple[Free, ...] = ()
    measured: Mapping[Endpoint, Endpoint] = field(default_factory=dict)
    trusted: bool = False
    structural: Mapping[str, str] = field(default_factory=dict)
    sub_ports: Mapping[str, SubPorts] = field(default_factory=dict)
    removed: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", _fixed(self.parameters))

    def __repr__(self) -> str:
        where = f", {self.file}" if self.file else ""
        return f"Diagram({self.name}: {len(self.nodes)} blocks, {len(self.wires)} wires{where})"

    def _repr_html_(self) -> str:
        # the picture is made above the data, and therefore named, not imported (as in `rotorsim._shown`)
        return str(import_module("rotorsim.diagram.draw").draw_svg(self))

    def as_measured(self, name: str) -> str:
        """Return the signal of this diagram that a recording means by a flat name ("rotor.displacement[3,1]")."""
        base, _, inside = name.partition("[")
        index = tuple(int(part) - 1 for part in inside.rstrip("]").split(",")) if inside else ()
        for said, meant in self.measured.items():
            if f"{said.block}.{said.port}" == base and index[: len(said.index)] == said.index:
                return str(Endpoint(meant.block, meant.port, (*meant.index, *index[len(said.index) :])))
        return name

    def unit_of_parameter(self, name: str) -> str | None:
        """Return the unit of a parameter of the diagram or of a block (``amb.k_i``), or of an entry of one.

        None without one, or unknown.
        """
        name = name.partition("[")[0]
        if name in self.parameters:
            return self.parameter_units.get(name)
        block, _, key = name.rpartition(".")
        node = self.nodes.get(block)
        declared = node.block.parameters.get(key) if node else None
        return declared.unit if declared else None

    @property
    def turns(self) -> bool:
        """Whether a shaft turns in it: a wire begins at a clock."""
        return any(self.nodes[wire.source.block].block.category == "clock" for wire in self.wires)

    @cached_property
    def sha256(self) -> str:
        """The hash of the document, by which a result says what was run."""
        text = json.dumps(self.document, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()

    @cached_property
    def graph(self) -> nx.MultiDiGraph:
        """The blocks and wires as a networkx graph; every edge carries its `Wire`."""
        graph = nx.MultiDiGraph()
        graph.add_nodes_from((name, {"node": node}) for name, node in self.nodes.items())
        graph.add_edges_from((w.source.block, w.target.block, {"wire": w}) for w in self.wires)
        return graph


def wrong_port(diagram: Diagram, name: str, *, inputs: bool = True) -> Problem:
    """Return what is wrong with a name that is no port, or no output port, of a diagram, and what was meant."""
    base, bracket, _ = name.partition("[")
    block, _, port = base.rpartition(".")
    node = diagram.nodes.get(block or base)
    if node is None:
        return Problem("no such block", block or base, hint=near_miss(block or base, diagram.nodes))
    known = [*(node.inputs if inputs else ()), *node.outputs]
    if not block:
        return Problem("is a block, not a port", name, hint=f"its ports: {', '.join(f'{base}.{one}' for one in known)}")
    if bracket and port in known:
        shape = (node.outputs.get(port) or node.inputs[port]).shape
        size = " x ".join(map(str, shape)) or "scalar"
        return Problem(f"no such entry; '{base}' has shape {size}, counted from 1", name, hint=f"name '{base}' for all")
    return Problem(f"no such {'port' if inputs else 'output port'}", name, hint=near_miss(port, known))
