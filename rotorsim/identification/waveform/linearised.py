"""Runs linearised about their simulation: what a signal added to any wire changes of all wires and of the outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.equations import DrivenEquations, driven_equations
from rotorsim.identification.waveform.search import Evaluation, OutputErrorSearch
from rotorsim.identification.waveform.simulation import Simulation
from rotorsim.linear.sampled import recursion, zero_order_hold
from rotorsim.model.matrix_function import MatrixFunction

CONSTANT = 1e-9  # relative: Jacobians that change less along all runs are those of a linear diagram


@dataclass(frozen=True, eq=False)
class LinearisedRun:
    """Deviations of a run of N samples from its simulation, sample by sample.

    x_(k+1) = F_k x_k + G_k d_k,   y_k = H_k x_k + D_k d_k,   w_k = W_k x_k + E_k d_k,   d held between samples

    F (N, n, n), G (N, n, P), H (N, c, n), D (N, c, P): P signals, each added at a `Place`; W (N, P, n), E (N, P, P):
    what the places carry, before anything is added. residual (N, c): measured less simulated; wires (N, P): simulated
    values at the places. by_output (N, c, m), by_wire (N, P, m): derivatives by the m free parameters.
    A linear diagram has one matrix for all even samples: N is 1 there. A sample that is missing has no H, D, residual.
    """

    F: np.ndarray
    G: np.ndarray
    H: np.ndarray
    D: np.ndarray
    W: np.ndarray
    E: np.ndarray
    residual: np.ndarray
    wires: np.ndarray
    by_output: np.ndarray
    by_wire: np.ndarray
    dt: float

    @property
    def constant(self) -> bool:
        """Whether the matrices are the same at all samples."""
        return len(self.F) == 1

    def responses(self, place: int, added: np.ndarray) -> np.ndarray:
        """Return the outputs (N, c, K) of signals (N, K) that are added to one wire."""
        states = recursion(self.F, self.G[:, :, [place]], added[:, None, :])
        return np.asarray(self.H @ states[:-1] + self.D[:, :, place, None] * added[:, None, :])


@dataclass(frozen=True)
class Place:
    """Where a signal may be added: at an output port, to what takes it (side ""), its "reading", or "both"."""

    port: str
    side: str = ""

    @property
    def taken(self) -> bool:
        """Whether the blocks behind the port see it."""
        return self.side != "reading"

    @property
    def recorded(self) -> bool:
        """Whether a recording of the port sees it."""
        return self.side != ""

    def __str__(self) -> str:
        return self.port


def places_of(diagram: Diagram, outputs: Sequence[str]) -> list[Place]:
    """Return every output port that is one number: where it is taken, where it is recorded, and both at once.

    outputs: flat names of what was recorded and is compared.
    """
    sources = {f"{wire.source.block}.{wire.source.port}" for wire in diagram.wires}
    ports = (port for node in diagram.nodes.values() for port in node.outputs.values())
    places = []
    for port in (str(port) for port in ports if port.shape == ()):
        taken, recorded = port in sources, port in outputs
        places += [Place(port)] if taken else []
        places += [Place(port, "reading")] if recorded else []
        places += [Place(port, "both")] if taken and recorded else []
    return places


def linearised(
    diagram: Diagram, search: OutputErrorSearch, evaluation: Evaluation, places: Sequence[Place]
) -> list[LinearisedRun]:
    """Return the runs of a fitted diagram, linearised about their simulation; P places.

    Raises RotorsimError for signals that the diagram does not have.
    """
    given = search.systems[0].equations
    c, m = len(given.outputs), search.m
    ports = list(dict.fromkeys(place.port for place in places))
    outputs = [*given.outputs, *ports]
    whole, unknowns = with_outputs(diagram, search, evaluation, outputs)
    taken = [port for port in ports if any(place.taken for place in places if place.port == port)]
    matrices = _Matrices.of(driven_equations(diagram, outputs, given.inputs, diagram.free, added=taken))
    column = [taken.index(place.port) if place.taken else len(taken) for place in places]  # the last is no input
    row = [c + ports.index(place.port) for place in places]
    reading = np.array([[place.recorded and place.port == name for place in places] for name in given.outputs], float)
    runs = []
    for r, run in enumerate(search.runs):
        y, by = whole.simulated(unknowns, 0, r, evaluation.sub)
        p = whole.systems[0].equations.parameters(search.p[r], unknowns[:m])
        A, B, C, D = matrices.at(run.time, y[:, len(outputs) :], run.inputs(given.inputs, 1)[:, 0], p)
        residual = evaluation.residuals[0][r]
        lost = ~np.isfinite(residual)
        if run.steps is not None or lost.any():
            A, B, C, D = (np.broadcast_to(M, (run.size, *M.shape[1:])).copy() for M in (A, B, C, D))
        F, G = zero_order_hold(A, B, np.full(1, run.dt) if run.steps is None else np.append(run.steps, run.dt))
        G, D = (np.concatenate([M, np.zeros_like(M[:, :, :1])], axis=2)[:, :, column] for M in (G, D))
        H, through, by_output = C[:, :c].copy(), D[:, :c] + reading, by[:, :c, :m].copy()
        if lost.any():
            H[lost], through[lost], by_output[lost] = 0.0, 0.0, 0.0
        runs.append(
            LinearisedRun(
                F=F,
                G=G,
                H=H,
                D=through,
                W=C[:, row],
                E=D[:, row],
                residual=np.where(lost, 0.0, residual),
                wires=y[:, row],
                by_output=by_output,
                by_wire=by[:, row, :m],
                dt=run.dt,
            )
        )
    return runs


def simulated_signals(
    diagram: Diagram, search: OutputErrorSearch, evaluation: Evaluation, names: Sequence[str]
) -> list[np.ndarray]:
    """Return signals (flat names) in each run of a fitted diagram, as simulated, (N, s)."""
    whole, unknowns = with_outputs(diagram, search, evaluation, names, sensitive=False)
    runs = range(len(search.runs))
    return [whole.simulated(unknowns, 0, r, evaluation.sub, sensitivities=False)[0][:, : len(names)] for r in runs]


def with_outputs(
    diagram: Diagram,
    search: OutputErrorSearch,
    evaluation: Evaluation,
    outputs: Sequence[str],
    *,
    sensitive: bool = True,
) -> tuple[OutputErrorSearch, np.ndarray]:
    """Return a search whose outputs are these signals, then the states; and its unknowns, those of a fit.

    outputs: flat names. Raises RotorsimError for signals that the diagram does not have.
    """
    given = search.systems[0].equations
    equations = driven_equations(diagram, outputs, given.inputs, diagram.free, fastest=given.fastest)
    states = replace(
        equations, outputs=(*outputs, *equations.state_names), g=ca.vertcat(equations.g, equations.arguments[1])
    )
    whole = replace(search, systems=(Simulation(states, sensitive=sensitive),))
    unknowns = whole.first(search.starts(evaluation.unknowns))
    unknowns[: search.m] = evaluation.unknowns[: search.m]
    return whole, unknowns


@dataclass(frozen=True, eq=False)
class _Matrices:
    """The Jacobians of f and g by states and added signals, as functions of t, x, v, p."""

    inputs: int
    added: int
    functions: Sequence[MatrixFunction]

    @classmethod
    def of(cls, equations: DrivenEquations) -> _Matrices:
        _, x, v, _ = equations.arguments
        d = v[len(equations.inputs) :]
        pairs = ((of, by) for of in (equations.f, equations.g) for by in (x, v))
        cut = len(equations.inputs)
        jacobians = [ca.jacobian(of, by) for of, by in pairs]
        jacobians[1], jacobians[3] = jacobians[1][:, cut:], jacobians[3][:, cut:]
        return cls(cut, d.numel(), [MatrixFunction(equations.arguments, jacobian) for jacobian in jacobians])

    def at(self, times: np.ndarray, x: np.ndarray, v: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
        """Return A, B, C, D at N instants, at one where they do not change; infinite slopes are left out."""
        v = np.concatenate([v, np.zeros((len(v), self.added))], axis=1)
        at = [np.nan_to_num(f(times[None], x.T, v.T, p[:, None]), posinf=0.0, neginf=0.0) for f in self.functions]
        changes = (np.abs(one - one[0]).max(initial=0.0) > CONSTANT * np.abs(one[0]).max(initial=0.0) for one in at)
        return at if any(changes) else [one[:1] for one in at]
