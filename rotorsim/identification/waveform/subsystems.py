"""What is compared with runs: the diagram as a whole, and each controller with its measured inputs."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.driven.equations import (
    DrivenEquations,
    ForceMap,
    driven_equations,
    driven_parameters,
    measured_expression,
    rate_of,
)
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.recorded.data import RATE_PREFIX, Channels
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.model.matrix_function import MatrixFunction

WHOLE_DIAGRAM = ""  # name of the whole diagram
ALIKE = 1e-9  # relative, of two expressions at points of chance: rounding
POINTS = 3


def subsystems_of(diagram: Diagram, channels: Channels, *, force: ForceMap | None = None) -> tuple[Simulation, ...]:
    """Return the whole diagram, and every controller whose inputs and output were measured.

    A controller's output is predicted from the measured motion, so that what is wrong elsewhere in the loop does not
    touch it, nor its faults the rest. force: acts in the whole diagram.
    Raises RotorsimError for signals that the diagram does not have.
    """
    systems = [
        Simulation(
            driven_equations(
                diagram, channels.outputs, channels.inputs, diagram.free, force=force, fastest=channels.fastest
            ),
            WHOLE_DIAGRAM,
        )
    ]
    controllers = {
        name: [output for output in channels.outputs if output.partition("[")[0].rpartition(".")[0] == name]
        for name, node in diagram.nodes.items()
        if "controller" in node.block.roles
    }
    for name, outputs in controllers.items():
        equations = _controller(diagram, channels, outputs) if outputs else None
        systems += [Simulation(equations, name)] if equations else []
    return tuple(systems)


def _controller(diagram: Diagram, channels: Channels, outputs: Sequence[str]) -> DrivenEquations | None:
    """Return the equations of a controller; None where what was measured does not cut it from the rest."""
    others = [output for output in channels.outputs if output not in outputs and output not in channels.gappy]
    passed = {*driven_parameters(diagram), *(output.partition("[")[0] for output in outputs)}
    cut = _measured_ports(compile_diagram(diagram), others, passed)
    if not cut:
        return None
    given = [*channels.inputs, *dict.fromkeys(name for names in cut.values() for name in names)]
    equations = driven_equations(diagram, outputs, given, diagram.free, cut=cut)
    holders = {state.rpartition(".")[0] for state in equations.state_names}
    return None if any("rotor" in diagram.nodes[name].block.roles for name in holders) else equations


def _measured_ports(model: Model, outputs: Sequence[str], passed: set[str]) -> dict[str, list[str]]:
    """Return the output ports of which every entry was measured, or is the rate of what was, with names for v."""
    known: dict[str, ca.SX] = {}
    for name in outputs:
        known[name] = measured_expression(model, name)
        known[RATE_PREFIX + name] = rate_of(model, known[name])
    own = {f"{name}.{port}" for name, node in model.diagram.nodes.items() for port in node.outputs}
    ports = {port: model.trace.signals[port] for port in model.signals if port in own - passed}
    values = _at_random(model, [*ports.values(), *known.values()])
    names, measured = [*known], np.concatenate([np.zeros((POINTS, 0)), *values[len(ports) :]], axis=1)
    cut: dict[str, list[str]] = {}
    for port, entries in zip(ports, values, strict=False):
        apart = np.abs(measured[:, None] - entries[:, :, None]).max(axis=0)
        close = apart <= ALIKE * np.abs(entries).max(axis=0)[:, None]
        if close.any(axis=1).all() and entries.any(axis=0).all():
            cut[port] = [names[k] for k in close.argmax(axis=1)]
    return cut


def _at_random(model: Model, expressions: Sequence[ca.SX]) -> list[np.ndarray]:
    """Return expressions (size,) at points of chance, each (POINTS, size)."""
    trace, random = model.trace, np.random.default_rng(1)
    p = model.p0 * random.uniform(0.9, 1.1, (POINTS, model.n_p)) + 1e-3 * random.uniform(0.5, 1.0, (POINTS, model.n_p))
    x, t = random.normal(size=(POINTS, model.n_x)), 0.3 * np.arange(POINTS)
    function = MatrixFunction([trace.t, trace.x, trace.p, trace.z], ca.vertcat(*expressions))
    ends = np.cumsum([expression.numel() for expression in expressions])[:-1]
    return np.split(function(t[None], x.T, p.T, np.zeros((model.n_z, POINTS)))[:, :, 0], ends, axis=1)
