"""The ways in which a diagram is compared with runs: as a whole, and each controller with its measured inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from rotorsim.diagnosis.evidence.waveform.data import RATE, Channels
from rotorsim.diagnosis.evidence.waveform.equations import (
    ForceMap,
    TimeEquations,
    driven_parameters,
    measured_expression,
    rate_of,
)
from rotorsim.diagnosis.evidence.waveform.kernel import TimeKernel
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.compiled import Model, compile_diagram

__all__ = ["WHOLE", "View", "views_of"]

WHOLE = ""  # name of the view of the whole diagram
CONTROLLER = "controller"
ALIKE = 1e-9  # relative, of two expressions at points of chance
POINTS = 3


@dataclass(frozen=True, eq=False)
class View:
    """What is predicted from what. name: `WHOLE`, or the controller that is tested with its measured inputs."""

    name: str
    equations: TimeEquations
    use_compiler: bool = True

    @cached_property
    def kernel(self) -> TimeKernel:
        """The simulation of the equations."""
        return TimeKernel(self.equations, self.use_compiler)

    @cached_property
    def measured_states(self) -> Mapping[int, tuple[str, float]]:
        """State -> output and factor, where an output is a constant times one state and nothing else."""
        eq, found = self.equations, {}
        for c, name in enumerate(eq.outputs):
            slope = ca.jacobian(eq.g[c], eq.arguments["x"])
            places = slope.sparsity().get_triplet()[1]
            if len(places) == 1 and slope.nz[0].is_constant() and name not in eq.inputs:
                factor = float(slope.nz[0])
                if (eq.g[c] - factor * eq.arguments["x"][places[0]]).is_zero() and factor != 0:
                    found[places[0]] = name, factor
        return found

    @property
    def outputs(self) -> tuple[str, ...]:
        """The flat names of what is predicted."""
        return self.equations.outputs


def views_of(
    diagram: Diagram, channels: Channels, *, force: ForceMap | None = None, expected: Sequence[str] | None = None
) -> list[View]:
    """Return the view of the whole diagram, and of every controller whose inputs and output were measured.

    A controller's output is predicted from the measured motion, so that what is wrong elsewhere in the loop does not
    touch it, nor its faults the rest. expected: names of the views that there must be.
    Raises RotorsimError for signals that the diagram does not have, and if another view is found than expected.
    """
    views = [View(WHOLE, TimeEquations(diagram, channels.outputs, channels.inputs, diagram.free, force=force))]
    controllers = {
        name: [o for o in channels.outputs if _source(diagram, o) == name]
        for name, node in diagram.nodes.items()
        if node.block.category == CONTROLLER
    }
    if any(controllers.values()):
        plain = compile_diagram(diagram)
        for name, outputs in controllers.items():
            if outputs:
                view = _cell(diagram, plain, channels, name, outputs)
                views += [view] if view else []
    names = [view.name for view in views]
    if expected is not None and names != list(expected):
        what = "its controllers can no longer be told from the rest by what was measured"
        raise RotorsimError(Problem(what, diagram.name))
    return views


def _source(diagram: Diagram, name: str) -> str:
    """Return the block that a recorded output is recorded at."""
    return name.partition("[")[0].rpartition(".")[0]


def _cell(diagram: Diagram, plain: Model, channels: Channels, name: str, outputs: Sequence[str]) -> View | None:
    """Return the view of a controller; None where what was measured does not cut it from the rest."""
    others = [o for o in channels.outputs if o not in outputs]
    cut = _measured_ports(plain, others, set(driven_parameters(diagram)) | {o.partition("[")[0] for o in outputs})
    if not cut:
        return None
    given = [*channels.inputs, *dict.fromkeys(n for names in cut.values() for n in names)]
    equations = TimeEquations(diagram, outputs, given, diagram.free, cut=cut)
    owners = {state.rpartition(".")[0] for state in equations.state_names}
    moving = [owner for owner in owners if diagram.nodes[owner].block.category == "rotor"]
    return None if moving else View(name, equations)


def _measured_ports(model: Model, outputs: Sequence[str], passed: set[str]) -> dict[str, list[str]]:
    """Return the output ports of which every entry was measured, or is the rate of what was, with names for v."""
    known: list[tuple[str, ca.SX]] = []
    for name in outputs:
        expression = measured_expression(model, name)
        known += [(name, expression), (RATE + name, rate_of(model, expression))]
    entries: list[tuple[str, int, int]] = []
    column: list[ca.SX] = []
    for port in model.signals:
        if port not in passed and port.partition(".")[2] in model.diagram.nodes[port.partition(".")[0]].outputs:
            value = model.trace.signals[port]
            entries.append((port, len(column), value.shape[0]))
            column += ca.vertsplit(value) if value.shape[0] > 1 else [value]
    values = _at_random(model, [*column, *(expression for _, expression in known)])
    wanted = values[len(column) :]
    found: dict[str, list[str]] = {}
    for port, at, size in entries:
        names = []
        for k in range(at, at + size):
            close = np.abs(wanted - values[k]).max(axis=1) <= ALIKE * max(np.abs(values[k]).max(), 1e-300)
            if close.any() and np.abs(values[k]).max() > 0:
                names.append(known[int(np.argmax(close))][0])
        if len(names) == size:
            found[port] = names
    return found


def _at_random(model: Model, expressions: Sequence[ca.SX]) -> np.ndarray:
    """Return expressions (k,) at points of chance, (k, POINTS)."""
    trace = model.trace
    function = ca.Function("f", [trace.t, trace.x, trace.p, trace.z], [ca.densify(ca.vertcat(*expressions))])
    random = np.random.default_rng(1)
    p = model.p0 * random.uniform(0.9, 1.1, (POINTS, model.n_p)) + 1e-3 * random.uniform(0.5, 1.0, (POINTS, model.n_p))
    x = random.normal(size=(POINTS, model.n_x))
    z = np.zeros((POINTS, model.n_z))
    return np.array([np.array(function(0.3 * k, x[k], p[k], z[k])).ravel() for k in range(POINTS)]).T


def starts_by_name(view: View, starts: np.ndarray) -> Mapping[str, list[float]]:
    """Return the states at the first sample of every run by name."""
    return {f"{view.name}:{name}": starts[:, k].tolist() for k, name in enumerate(view.equations.state_names)}
