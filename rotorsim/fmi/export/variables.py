"""The variables of an FMU made from a part of a diagram: names, numbers, start values, what depends on what."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.block import Shape, size_of
from rotorsim.fmi.export.dependencies import Dependencies, find_dependencies
from rotorsim.fmi.export.nested import Nested, check_outputs, find_nested
from rotorsim.model.part import Part
from rotorsim.model.trace.diagram import Signal
from rotorsim.model.trace.order import block_traces
from rotorsim.simulation.result import flat_name
from rotorsim.units import parse_unit

PARAMETER, INPUT, OUTPUT, STATE = "parameter", "input", "output", "state"
DERIVATIVE, DISCRETE, EVENT = "derivative", "discrete", "event"


@dataclass(frozen=True)
class Variable:
    """A scalar or an array; its entries have the value references ``reference``, ``reference`` + 1, ...

    start: (size,) or None where it is calculated. variability, initial: as in modelDescription.xml.
    of: the reference of the state that a derivative belongs to. low, high: bounds; nominal: typical size.
    """

    name: str
    role: str
    reference: int
    shape: Shape = ()
    unit: str | None = None
    start: np.ndarray | None = None
    variability: str = "continuous"
    initial: str | None = None
    description: str = ""
    low: float = -np.inf
    high: float = np.inf
    nominal: float | None = None
    of: int | None = None

    @property
    def size(self) -> int:
        """The number of its entries."""
        return size_of(self.shape)

    def entries(self) -> Iterator[tuple[str, int, int]]:
        """Yield name, value reference and position of every entry."""
        rate = self.role == DERIVATIVE
        for k, index in enumerate(np.ndindex(self.shape)):
            name = f"der({flat_name(self.name[4:-1], index)})" if rate else flat_name(self.name, index)
            yield name, self.reference + k, k


@dataclass(frozen=True)
class Parameter:
    """What one entry of a parameter of the FMU sets: positions in p, and its range (open: low is excluded)."""

    follow: tuple[int, ...]
    low: float
    high: float
    open: bool
    fixed: bool


@dataclass(frozen=True, eq=False)
class Interface:
    """All variables of an FMU in the order of their value references.

    record: the signals that the kernel records, in the order of the outputs. parameters: one for every entry.
    events: names of the event indicators. dependencies: see `find_dependencies`. nested: FMUs among its blocks.
    """

    part: Part
    variables: tuple[Variable, ...]
    record: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    dependencies: Dependencies
    x_exact: np.ndarray
    z_exact: np.ndarray
    x0: np.ndarray
    z0: np.ndarray
    arrays: bool = False
    identifier: str = ""
    units: tuple[str, ...] = field(default=())
    nested: tuple[Nested, ...] = ()

    def of_role(self, *roles: str) -> list[Variable]:
        """Return the variables of some roles."""
        return [variable for variable in self.variables if variable.role in roles]

    def count(self, role: str) -> int:
        """Return the number of entries of a role."""
        return sum(variable.size for variable in self.of_role(role))

    def first(self, role: str) -> int:
        """Return the value reference at which a role begins."""
        order = (PARAMETER, INPUT, OUTPUT, STATE, DERIVATIVE, DISCRETE, EVENT)
        return 1 + sum(self.count(before) for before in order[: order.index(role)])

    @cached_property
    def names(self) -> list[str]:
        """The name of every scalar, by value reference."""
        return ["time", *(name for variable in self.variables for name, _, _ in variable.entries())]

    @cached_property
    def widths(self) -> list[int]:
        """How many entries the variable has that begins at a value reference; 0 inside an array."""
        widths = [1]
        for variable in self.variables:
            widths += [variable.size, *[0] * (variable.size - 1)] if self.arrays else [1] * variable.size
        return widths


def make_interface(
    part: Part, *, outputs: Sequence[str] | None = None, arrays: bool = False, fixed: bool = False
) -> Interface:
    """Name and number the variables of a part.

    outputs: signals; default: what the diagram records where the part is the whole diagram, else every output port
    of its blocks. arrays: arrays instead of scalars (FMI 3). fixed: no parameter can be changed after initialisation.
    Raises RotorsimError for signals that do not exist.
    """
    record = _without_parts_of_others(part.record_names(outputs) if outputs else _default_outputs(part))
    nested = find_nested(part)
    check_outputs(part, nested, record)
    collector = _Collector(part, nested)
    parameters = collector.add_parameters(fixed)
    for name, signal in part.inputs.items():
        collector.add_port(name, INPUT, signal.shape, signal.unit, start=np.zeros(size_of(signal.shape)))
    x_const, z_const = (_constant_entries(e) for e in (part.trace.x0, part.trace.z0))
    dependencies = find_dependencies(part, record, x_const, z_const, all(parameter.fixed for parameter in parameters))
    at = 0
    for name in record:
        shape, unit = part.shape_of(name), part.select(name)[0].unit
        moving = dependencies.moving.intersection(range(at, at + size_of(shape)))
        at += size_of(shape)
        kind = "continuous" if moving else "discrete"
        collector.add_port(name, OUTPUT, shape, unit, variability=kind, initial="calculated")
    x0, z0 = part.initial()
    own = part.n_z - sum(size_of(signal.shape) for signal in part.inputs.values())
    for state in collector.add_states(STATE, part.states, x0, x_const, "continuous", _nominals(part, nested)):
        collector.add(
            f"der({state.name})",
            DERIVATIVE,
            state.shape,
            None if state.unit is None else parse_unit(f"({state.unit})/s").si,
            initial="calculated",
            description=f"rate of {state.name}",
            of=state.reference,
        )
    collector.add_states(DISCRETE, part.trace.discrete_states, z0, z_const, "discrete")
    collector.add_events()
    return Interface(
        part=part,
        variables=tuple(collector.variables),
        record=tuple(record),
        parameters=tuple(parameters),
        dependencies=dependencies,
        x_exact=x_const,
        z_exact=z_const[:own],
        x0=x0,
        z0=z0[:own],
        arrays=arrays,
        identifier=_identifier(part),
        units=tuple(sorted({v.unit for v in collector.variables if v.unit})),
        nested=nested,
    )


def _default_outputs(part: Part) -> list[str]:
    if set(part.blocks) == set(part.diagram.nodes):
        return list(part.record_names())
    ports = [f"{block}.{port}" for block in part.blocks for port in part.diagram.nodes[block].outputs]
    return [name for name in ports if name in part.signals and size_of(part.signals[name].shape)]


def _without_parts_of_others(names: Iterable[str]) -> list[str]:
    """Drop repeated names, and parts of signals that are named as a whole."""
    given = list(dict.fromkeys(names))

    def contained(name: str) -> bool:
        wholes = [name.partition("[")[0], *(name[:k] + "]" for k, c in enumerate(name) if c == ",")]
        return any(whole in given for whole in wholes if whole != name)

    return [name for name in given if not contained(name)]


def _identifier(part: Part) -> str:
    """Return the model identifier: a C name made of the diagram's and, for a part, its blocks' names."""
    words = [part.diagram.name or "diagram"]
    if set(part.blocks) != set(part.diagram.nodes):
        words += part.blocks
    name = re.sub(r"\W", "_", "_".join(words), flags=re.ASCII)[:60]
    return name if re.match(r"[A-Za-z_]", name) else f"m_{name}"


def _constant_entries(expression: Any) -> np.ndarray:
    """Return which entries of a column are numbers."""
    column = ca.densify(expression)
    return np.array([column[k].is_constant() for k in range(column.numel())], bool)


class _Collector:
    """Adds variables one after the other, numbered, under names that do not clash."""

    def __init__(self, part: Part, nested: Sequence[Nested] = ()) -> None:
        self.part, self.nested = part, nested
        self.diagram = part.diagram
        self.variables: list[Variable] = []
        self.next = 1

    def add(self, name: str, role: str, shape: Shape, unit: str | None, **more: object) -> Variable:
        """Add a variable; blocks of sub-diagrams (``sub/gain``) become levels of its name (``sub.gain``)."""
        shown = unit if unit not in (None, "", "1") else None
        variable = Variable(name.replace("/", "."), role, self.next, tuple(shape), shown, **more)  # type: ignore[arg-type]
        self.variables.append(variable)
        self.next += variable.size
        return variable

    def add_port(self, name: str, role: str, shape: Shape, unit: str | None, **more: object) -> None:
        """Add a variable of a port, or of a part of it."""
        block, _, port = name.partition("[")[0].rpartition(".")
        node = self.diagram.nodes[block]
        found = node.outputs.get(port) or node.inputs.get(port)
        self.add(name, role, shape, unit, description=found.declaration.doc if found else "", **more)

    def add_states(
        self,
        role: str,
        signals: Mapping[str, Signal],
        start: np.ndarray,
        constant: np.ndarray,
        variability: str,
        nominals: Mapping[str, float] | None = None,
    ) -> list[Variable]:
        """Add states; those of constant start values are exact, which ``constant`` then says of all their entries."""
        return [
            self._add_state(
                name, role, signal, start, constant, variability=variability, nominal=(nominals or {}).get(name)
            )
            for name, signal in signals.items()
        ]

    def _add_state(
        self, name: str, role: str, signal: Signal, start: np.ndarray, constant: np.ndarray, **more: object
    ) -> Variable:
        """Add a state, under a name apart from a port or parameter of the same name."""
        block, _, state = name.rpartition(".")
        node = self.diagram.nodes[block]
        taken = state in node.outputs or state in node.inputs or state in node.values
        exact = constant[signal.part] = bool(constant[signal.part].all())
        return self.add(
            f"{name}_state" if taken else name,
            role,
            signal.shape,
            signal.unit,
            start=start[signal.part] if exact else None,
            initial="exact" if exact else "calculated",
            description=node.block.states[state].doc,
            **more,
        )

    def add_parameters(self, fixed: bool) -> list[Parameter]:
        """Add diagram parameters, then block parameters that follow none of them."""
        nodes = self.diagram.nodes
        held = set(range(self.part.n_p)) if fixed else self._stuck_positions()
        inside = [(name, key) for name in nodes if name in set(self.part.blocks) for key in nodes[name].values]
        following: dict[str, list[str]] = {name: [] for name in self.diagram.parameters}
        free: list[tuple[str, str]] = []
        for block, key in inside:
            source = nodes[block].references.get(key, "")
            if source in following:
                following[source].append(f"{block}.{key}")
            else:
                free.append((block, key))
        found: list[Parameter] = []
        for name, owners in following.items():
            unit = self.diagram.parameter_units.get(name)
            doc = "sets " + ", ".join(owners[:6]) + (", ..." if len(owners) > 6 else "")
            shown = f"{name}_parameter" if name == "time" else name
            if owners:
                found += self._add_parameter(shown, owners, self.diagram.parameters[name], unit, doc, held)
        for block, key in free:
            node, name = nodes[block], f"{block}.{key}"
            declared = node.block.parameters[key]
            shown = f"{name}_parameter" if key in node.outputs or key in node.inputs else name
            found += self._add_parameter(shown, [name], node.values[key], declared.unit, declared.doc, held)
        return found

    def _add_parameter(
        self, name: str, owners: list[str], value: Any, unit: str | None, doc: str, held: set[int]
    ) -> list[Parameter]:
        value = np.asarray(value, float)
        ends = [owner.rpartition(".") for owner in owners]
        declared = [self.diagram.nodes[block].block.parameters[key] for block, _, key in ends]
        high = min((d.high for d in declared if d.high is not None), default=np.inf)
        lows = [(d.low, False) for d in declared] + [(d.above, True) for d in declared]
        low, is_open = max(((float(low), above) for low, above in lows if low is not None), default=(-np.inf, False))
        places = [range(*self.part.parameters[owner].indices(self.part.n_p)) for owner in owners]
        follow = [tuple(chain(*places))] if value.size == 1 else list(zip(*places, strict=True))
        stuck = any(place in held for place in chain(*follow))
        self.add(
            name,
            PARAMETER,
            value.shape,
            unit,
            start=value.ravel(),
            variability="fixed" if stuck else "tunable",
            initial="exact",
            description=doc,
            low=low,
            high=high,
        )
        return [Parameter(positions, low, high, is_open, stuck) for positions in follow]

    def _stuck_positions(self) -> set[int]:
        """Return the places in p that act only at the start: sample times, seeds, and what only x0 and z0 use."""
        trace = self.part.trace
        stuck = {s.period for s in trace.samplers} | {s.seed for s in trace.samplers if s.seed is not None}
        for name in (name for one in self.nested for name in one.fixed if name in self.part.parameters):
            stuck.update(range(*self.part.parameters[name].indices(self.part.n_p)))
        start = ca.vertcat(trace.x0, trace.z0)
        if start.numel() == 0 or trace.p.numel() == 0:
            return stuck
        acting = ca.vertcat(trace.xdot, trace.z_next, *trace.signals.values(), trace.events)
        used = np.array(ca.which_depends(acting, trace.p, 1, False), bool) if acting.numel() else np.zeros(1, bool)
        initial = np.array(ca.which_depends(start, trace.p, 1, False), bool)
        return stuck | set(np.flatnonzero(initial & ~used).tolist())

    def add_events(self) -> None:
        """Add the zero crossings that blocks declare, then the event indicators of FMUs inside."""
        names = {variable.name for variable in self.variables}
        blocks = [name for name in self.diagram.nodes if name in self.part.blocks]
        traces = block_traces(self.diagram) if self.part.trace.event_blocks else {}
        events = [(f"{b}.{key}", e.shape[0]) for b in blocks if b in traces for key, e in traces[b].events.items()]
        events += [(f"{one.block}.event_indicators", one.n_events) for one in self.nested if one.n_events]
        for name, n in events:
            shown = f"{name}_event" if name.replace("/", ".") in names else name
            self.add(
                shown, EVENT, () if n == 1 else (n,), None, initial="calculated", description="crosses zero at an event"
            )


def _nominals(part: Part, nested: Sequence[Nested]) -> dict[str, float]:
    """Return the typical size of every state: vibrations of 10 um and 10 urad at 1000 rad/s; 1 for other quantities.

    An FMU inside says it itself.

    A state without a unit holds lengths and angles, or their rates where it is the derivative of another state.
    """
    owner = {k: name for name, signal in part.states.items() for k in range(signal.part.start, signal.part.stop)}
    number = {part.trace.x[k].element_hash(): k for k in range(part.n_x)}
    rate_of: dict[str, str] = {}
    for k, name in owner.items():
        rate = part.trace.xdot[k]
        if rate.is_symbolic() and rate.element_hash() in number:
            rate_of.setdefault(owner[number[rate.element_hash()]], name)
    found: dict[str, float] = {}
    for name in part.states:
        chain = [name]  # until a unit is known
        while part.states[chain[-1]].unit is None and rate_of.get(chain[-1], name) not in chain:
            chain.append(rate_of[chain[-1]])
        found[name] = _nominal(part.states[chain[-1]].unit) * 1e3 ** (len(chain) - 1)
    return found | {f"{one.block}.states": one.nominal for one in nested if f"{one.block}.states" in part.states}


def _nominal(unit: str | None) -> float:
    length, mass, time, current, kelvin, angle, *others = parse_unit(unit or "m").dimension
    if any((mass, current, kelvin, *others)) or length + angle != 1:
        return 1.0
    return float(10.0 ** (-5 - 3 * time))
