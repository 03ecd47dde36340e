"""FMUs for Co-Simulation inside an exported diagram: sampled blocks, whose hits are the steps of the diagram.

At each hit the FMU takes the inputs of that moment, steps from the hit before to it, and its outputs are held until the
next one: Gauss-Seidel with held inputs, the rest of the diagram first. Where its inputs follow its outputs at once,
those of the hit before are taken: Jacobi.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.block import Block, DiscreteState, Equations, Param, concatenate, unflatten, zeros
from rotorsim.diagram.diagram import Diagram
from rotorsim.fmi.description.model import FLOATS
from rotorsim.fmi.functions import digest_of, moving_inputs, texts_of
from rotorsim.fmi.instances import Values
from rotorsim.fmi.ports import FmuPort, symbol_shape, unfed
from rotorsim.model.trace.order import block_traces, evaluation_groups, feedthrough_graph

NAMES = "communication_step", "held", "taken"  # of a parameter and two states that are added
NO_OUTPUT = 1e300  # of an output: no number of a machine


def is_stepped(block: Any) -> bool:
    """Return whether a block is an FMU for Co-Simulation, as `with_steps` puts it."""
    return hasattr(block, "fmu_steps")


def is_late(block: Any) -> bool:
    """Return whether it takes the inputs of the hit before."""
    return block.fmu_steps[2] in block.states


def fed_inputs(block: Any) -> dict[str, FmuPort]:
    """Return the inputs that an FMU for Co-Simulation gets at every hit; the others are set once."""
    moving = moving_inputs(block)
    return {name: port for name, port in block.fmu_inputs.items() if name in moving or name in block.wired}


def set_inputs(block: Any) -> dict[str, FmuPort]:
    """Return the other inputs."""
    fed = fed_inputs(block)
    return {name: port for name, port in block.fmu_inputs.items() if name not in fed}


def with_steps(diagram: Diagram, blocks: Iterable[str]) -> Diagram:
    """Return a diagram with these FMUs for Co-Simulation as blocks that act at its steps."""
    stepped = list(blocks)
    made = _with_steps(diagram, dict.fromkeys(stepped, False))
    late = _in_loops(made) if stepped else set()
    return _with_steps(diagram, {name: name in late for name in stepped}) if late else made


def _with_steps(diagram: Diagram, blocks: Mapping[str, bool]) -> Diagram:
    """Return a diagram with blocks that act at its steps; with True those that take inputs of the hit before."""
    nodes, h = dict(diagram.nodes), diagram.solver.step
    for name, late in blocks.items():
        node = nodes[name]
        taken = sum(len(port.entries) for port in fed_inputs(node.block).values()) if late else 0
        made: Any = _stepped(type(node.block), h, taken)  # type: ignore[arg-type]
        block = made(vars(node.block.option), node.block.wired)
        shapes = {key: state.shape for key, state in made.states.items()}
        nodes[name] = replace(
            node, block=block, values={**node.values, made.fmu_steps[0]: np.array(h)}, state_shapes=shapes
        )
    return replace(diagram, nodes=nodes)


def _in_loops(diagram: Diagram) -> set[str]:
    """Return the blocks whose outputs behind a hit follow one another."""
    through = {name: trace.hit_feedthrough for name, trace in block_traces(diagram, called=True).items()}
    graph = feedthrough_graph(diagram, through)
    groups = evaluation_groups(graph)
    return {block for group in groups if len(group) > 1 or graph.has_edge(group[0], group[0]) for block, _ in group}


@lru_cache(maxsize=64)
def _stepped(kind: type[Block], h: float, taken: int) -> type[Block]:
    """Return the class of a block that acts at steps h [s]; taken: how many inputs it keeps from the hit before."""
    of: Any = kind
    told = sum(len(names) for names in _told(of).values())
    known = {*of.parameters, *of.options, *of.inputs, *of.outputs}
    step, held, inputs = (_free(name, known) for name in NAMES)
    states = [DiscreteState(name=held, shape=(told,), unit=None, doc="outputs of the FMU, SI")]
    if taken:
        doc = "inputs of the FMU at the last hit, SI"
        states.append(DiscreteState(name=inputs, shape=(taken,), unit=None, doc=doc))
    doc = "of which the FMU is told [s]; that of the diagram"
    body: dict[str, Any] = {
        "__doc__": kind.__doc__,
        "type_name": "fmu",
        "category": "fmu",
        "fmu_steps": (step, held, inputs),
        "sample_time": step,
        "_step": Param(h, name=step, unit="s", low=h, high=h, doc=doc),
        "_states": tuple(states),
        "equations": _equations,
        "linear_equations": lambda self, p, u, x, t: None,
        "starts": _starts,
        "untraced": lambda self: ("", ""),
        "mode": lambda self, p: None,
    }
    made: Any = type("Fmu", (kind,), body)
    made.states = {state.name: state for state in states}
    found: type[Block] = made
    return found


def _free(name: str, known: Collection[str]) -> str:
    """Return a name that nothing has."""
    while name in known:
        name += "_"
    return name


def _told(block: Any) -> dict[str, list[str]]:
    """Return the entries of the output ports that are Float64."""
    description = block.fmu_description
    kinds = {name: description.resolve(port.entries) for name, port in block.fmu_outputs.items()}
    every = block.fmu_outputs.items()
    return {name: port.entries for name, port in every if all(e.variable.type == FLOATS[0] for e in kinds[name])}


def _equations(self: Block, p: Any, u: Any, x: Any, t: Any) -> Equations:
    """Return the outputs of the last hit, and those of the next one."""
    block: Any = self
    _, held, taken = block.fmu_steps
    last = getattr(x, held)
    fed = [getattr(u, name) + unfed(block, p, name, port) for name, port in fed_inputs(block).items()]
    own = [getattr(p, name) for name in block.fmu_parameters]
    once = [unfed(block, p, name, port) for name, port in set_inputs(block).items()]
    now, late = concatenate([ca.SX(0, 1), *fed]), is_late(block)
    given = ca.SX(0, 1), getattr(x, taken) if late else now, concatenate([ca.SX(0, 1), *own, *once])
    # t, as a function of a state: what follows time and parameters alone is evaluated beside hits, too
    time = ca.fmax(t, ca.if_else(last[0] > NO_OUTPUT, last[0], t)) if last.numel() else t
    update = {held: steps_of(block).function(time, *given)} | ({taken: now} if late else {})
    outputs, at, told = {}, 0, _told(block)
    for name, port in block.fmu_outputs.items():
        size, shape = len(port.entries) if name in told else 0, symbol_shape(port.shape)
        outputs[name] = unflatten(last[at : at + size], shape) if size else zeros(*shape)
        at += size
    return Equations(outputs, update=update)


def _starts(self: Block, p: Any) -> dict[str, Any]:
    """Return the inputs with which an FMU begins that takes those of the hit before."""
    block: Any = self
    if not is_late(block):
        return {}
    fed = fed_inputs(block).items()
    return {block.fmu_steps[2]: concatenate([unfed(block, p, name, port, start=True) for name, port in fed])}


class _Step(ca.Callback):
    """The function that exported C calls at a hit: outputs by time, inputs and parameters. Here nothing calls it."""

    rows: range
    groups = (True, False, True, True)

    def __init__(self, name: str, sizes: Sequence[int], n_y: int) -> None:
        ca.Callback.__init__(self)
        self.sizes, self.rows = tuple(sizes), range(n_y)
        self.construct(name, {"never_inline": True})

    def get_n_in(self) -> int:
        return len(self.sizes)

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, k: int) -> Any:
        return ca.Sparsity.dense(self.sizes[k], 1)

    def get_sparsity_out(self, k: int) -> Any:
        return ca.Sparsity.dense(len(self.rows), 1)

    def eval(self, _: Sequence[Any]) -> list[Any]:
        return [ca.DM.zeros(len(self.rows), 1)]


@dataclass(frozen=True, eq=False)
class Given:
    """What an FMU is given before it begins. texts: values of variables that are no numbers."""

    parameters: Values
    inputs: Values
    texts: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Steps:
    """What exported C knows of an FMU for Co-Simulation, named as of one for Model Exchange (`FmuEquations`)."""

    function: _Step
    instances: Given
    u_names: list[str]
    y_names: list[str]
    u_scales: np.ndarray
    y_scales: np.ndarray
    idle: np.ndarray
    n_x = 0

    @property
    def native_row(self) -> dict[int, int]:
        """Where each row of y is among those that C reads."""
        return {k: k for k in range(len(self.y_names))}

    @property
    def equations(self) -> Steps:
        """Itself."""
        return self

    def named(self) -> dict[str, _Step]:
        """Return the function, by name."""
        return {self.function.name(): self.function}


_known: dict[str, Steps] = {}


def steps_of(block: Any) -> Steps:
    """Return what is known of the FMU of a block; the same for the same block and file, with equal options."""
    texts, told = texts_of(block), _told(block)
    fed, once = fed_inputs(block), set_inputs(block)
    u, y = Values([*fed.values()]), Values([block.fmu_outputs[name] for name in told])
    p = Values([*block.fmu_parameters.values(), *once.values()])
    about = [(part.names, part.scales.tolist(), part.starts.tolist()) for part in (u, y, p)]
    file = str(block.fmu_path), digest_of(block.fmu_path)
    identity = repr((block.fmu_block, file, sorted(texts.items(), key=str), about))
    if identity not in _known:
        name = f"fmu_steps_{hashlib.sha256(identity.encode()).hexdigest()[:16]}"
        function = _Step(name, (1, 0, len(u), len(p)), len(y))
        idle = np.nan_to_num(u.starts)
        _known[identity] = Steps(function, Given(p, u, texts), u.names, y.names, u.scales, y.scales, idle)
    return _known[identity]
