"""Linearised runs: what a signal that is added to any wire changes of all wires and of the outputs.

About the simulation, or, of a nonlinear diagram that is far from what was measured, about the motion that was: that of
an extended Kalman smoother whose states are all driven (Jazwinski, Stochastic Processes and Filtering Theory (1970),
8.3). What the diagram itself does not make of that motion, w_k = X_(k+1) - f(X_k), is taken away from it again:

x_(k+1) = F_k x_k - w_k,   residual = measured - g(X_k) - H_k x_k
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram, Node, Wire
from rotorsim.identification.waveform.driven.equations import DrivenEquations, driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.linear.sampled import outputs, recursion, zero_order_hold
from rotorsim.model.linearity import jacobian
from rotorsim.model.matrix_function import MatrixFunction

CONSTANT = 1e-9  # relative: Jacobians that change less along all runs are those of a linear diagram


@dataclass(frozen=True, eq=False)
class LinearisedRun:
    """Deviations of a run of N samples from the motion that the diagram makes of itself, sample by sample.

    x_(k+1) = F_k x_k + G_k d_k,   y_k = H_k x_k + D_k d_k,   w_k = W_k x_k + E_k d_k,   d held between samples

    F (N, n, n), G (N, n, P), H (N, c, n), D (N, c, P): P signals, each added at a `Place`; W (N, P, n), E (N, P, P):
    what the places carry, before anything is added. residual (N, c): measured less that motion; states (N, n) and wires
    (N, P): of it, the latter at the places; carried (N, P): in the motion that it is linearised about. by_output
    (N, c, m), by_wire (N, P, m): derivatives by the m free parameters.
    A linear diagram has one matrix for all even samples: N is 1 there. A sample that is missing has no H, D, residual.
    """

    F: np.ndarray
    G: np.ndarray
    H: np.ndarray
    D: np.ndarray
    W: np.ndarray
    E: np.ndarray
    residual: np.ndarray
    states: np.ndarray
    wires: np.ndarray
    carried: np.ndarray
    by_output: np.ndarray
    by_wire: np.ndarray
    dt: float

    @property
    def constant(self) -> bool:
        """Whether the matrices are the same at all samples."""
        return len(self.F) == 1

    def responses(self, place: int, added: np.ndarray) -> np.ndarray:
        """Return the outputs (N, c, K) of signals (N, K) that are added to one wire."""
        G, D = self._entering
        return outputs(self.F, G[place], self.H, D[place], added[:, None, :])

    @cached_property
    def _entering(self) -> tuple[np.ndarray, np.ndarray]:
        """G (P, N or 1, n, 1) and D (P, N or 1, c, 1), those of one place side by side."""
        G, D = (np.moveaxis(M, 2, 0)[..., None].copy() for M in (self.G, self.D))
        return G, D


@dataclass(frozen=True)
class Place:
    """Where a signal may be added: at an output port, to what takes it (side ""), its "reading", or "both".

    into: an input that alone sees it, of several that take the output (side "branch").
    """

    port: str
    side: str = ""
    into: str = ""

    @property
    def entry(self) -> str:
        """The port that it is added to."""
        return self.into or self.port

    @property
    def taken(self) -> bool:
        """Whether blocks behind the port see it."""
        return self.side != "reading"

    @property
    def recorded(self) -> bool:
        """Whether a recording of the port sees it."""
        return self.side in ("reading", "both")

    def __str__(self) -> str:
        return self.entry


def places_of(diagram: Diagram, outputs: Sequence[str]) -> list[Place]:
    """Return every output port that is one number: where it is taken, where it is recorded, both at once, its branches.

    outputs: flat names of what was recorded and is compared.
    """
    sources = {f"{wire.source.block}.{wire.source.port}" for wire in diagram.wires}
    branches = branches_of(diagram)
    ports = (port for node in diagram.nodes.values() for port in node.outputs.values())
    places = []
    for port in (str(port) for port in ports if port.shape == ()):
        taken, recorded = port in sources, port in outputs
        places += [Place(port)] if taken else []
        places += [Place(port, "reading")] if recorded else []
        places += [Place(port, "both")] if taken and recorded else []
        places += [Place(port, "branch", str(wire.target)) for wire in branches.get(port, ())]
    return places


def branches_of(diagram: Diagram) -> dict[str, list[Wire]]:
    """Return the wires from scalar outputs that several wires take, each a place of its own.

    Without those into a gain: what is wrong there is wrong behind it, in proportion; nor into a port that shares its
    name with an output of the block.
    """
    wires: dict[str, list[Wire]] = {}
    for wire in diagram.wires:
        wires.setdefault(str(wire.source), []).append(wire)
    found: dict[str, list[Wire]] = {}
    for source, several in wires.items():
        if len(several) > 1 and diagram.nodes[several[0].source.block].outputs[several[0].source.port].shape == ():
            found[source] = [wire for wire in several if _is_place(diagram.nodes[wire.target.block], wire)]
    return found


def _is_place(node: Node, wire: Wire) -> bool:
    port = wire.target.port
    return node.block.type_name != "gain" and node.inputs[port].shape == () and port not in node.outputs


def linearised(
    diagram: Diagram,
    search: OutputErrorSearch,
    evaluation: Evaluation,
    places: Sequence[Place],
    motion: Sequence[np.ndarray] | None = None,
) -> list[LinearisedRun]:
    """Return the runs of a fitted diagram, linearised about their simulation; P places.

    motion: states (N, n) in each run to linearise about instead. Raises RotorsimError for signals that the diagram does
    not have.
    """
    given = search.systems[0].equations
    c, m = len(given.outputs), search.m
    ports = list(dict.fromkeys(place.port for place in places))
    outputs = [*given.outputs, *ports]
    whole, unknowns = with_outputs(diagram, search, evaluation, outputs)
    taken = list(dict.fromkeys(place.entry for place in places if place.taken))
    pushed = driven_equations(diagram, outputs, given.inputs, diagram.free, added=taken, fastest=given.fastest)
    about = _About(pushed, len(given.inputs))
    column = [taken.index(place.entry) if place.taken else len(taken) for place in places]  # the last is no input
    row = [c + ports.index(place.port) for place in places]
    reading = np.array([[place.recorded and place.port == name for place in places] for name in given.outputs], float)
    runs = []
    for r, run in enumerate(search.runs):
        y, by = whole.simulated(unknowns, 0, r, evaluation.sub)
        y, x, by = y[:, : len(outputs)], y[:, len(outputs) :], by[:, :, :m]
        p, v = whole.systems[0].equations.parameters(search.p[r], unknowns[:m]), run.inputs(given.inputs, 1)[:, 0]
        steps = np.full(1, run.dt) if run.steps is None else np.append(run.steps, run.dt)
        residual, carried = evaluation.residuals[0][r], y
        A, B, C, D = about.matrices(run.time, x if motion is None else motion[r], v, p)
        lost = ~np.isfinite(residual)
        if motion is not None:
            left = about.left(run.time, x, v, p, steps)
            moved, carried, by = about.moved(run.time, motion[r], v, p, steps, left)
            beside = carried + (C @ moved[:, :, None])[:, :, 0]
            residual = residual + y[:, :c] - beside[:, :c]
            y, x = beside, motion[r] + moved
        if run.steps is not None or lost.any():
            A, B, C, D = (np.broadcast_to(M, (run.size, *M.shape[1:])).copy() for M in (A, B, C, D))
        F, G = zero_order_hold(A, B, steps)
        G, D = (np.concatenate([M, np.zeros_like(M[:, :, :1])], axis=2)[:, :, column] for M in (G, D))
        H, through, by_output = C[:, :c].copy(), D[:, :c] + reading, by[:, :c].copy()
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
                states=x,
                wires=y[:, row],
                carried=carried[:, row],
                by_output=by_output,
                by_wire=by[:, row],
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


def simulated_states(
    diagram: Diagram, search: OutputErrorSearch, evaluation: Evaluation
) -> list[dict[str, np.ndarray]]:
    """Return the states (N,) of each run of a fitted diagram, as simulated, by name."""
    given = search.systems[0].equations.outputs
    whole, unknowns = with_outputs(diagram, search, evaluation, given, sensitive=False)
    names, runs = whole.systems[0].equations.state_names, range(len(search.runs))
    values = (whole.simulated(unknowns, 0, r, evaluation.sub, sensitivities=False)[0] for r in runs)
    return [dict(zip(names, of_run[:, len(given) :].T, strict=True)) for of_run in values]


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
    whole = replace(search, systems=(Simulation(equations.with_states(outputs), sensitive=sensitive),))
    unknowns = whole.first(search.starts(evaluation.unknowns))
    unknowns[: search.m] = evaluation.unknowns[: search.m]
    return whole, unknowns


class _About:
    """Equations about a motion: states x (N, n), inputs v (N, n_v), parameters p, at N instants.

    given: how many inputs they are driven by; the others are signals that are added, and zero.
    """

    def __init__(self, equations: DrivenEquations, given: int) -> None:
        _, x, v, _ = arguments = equations.arguments
        self.added, self.n = v.numel() - given, x.numel()
        pairs = ((of, by) for of in (equations.f, equations.g) for by in (x, v[given:]))
        self._jacobians = [MatrixFunction(arguments, jacobian(of, by)) for of, by in pairs]
        self._motion = [  # f or g, then its derivatives by x and by the parameters
            MatrixFunction(arguments, ca.horzcat(of, equations.jacobian(of))) for of in (equations.f, equations.g)
        ]

    def _at(
        self, functions: Sequence[MatrixFunction], times: np.ndarray, x: np.ndarray, v: np.ndarray, p: np.ndarray
    ) -> list[np.ndarray]:
        """Return functions at N instants; infinite slopes are left out."""
        v = np.concatenate([v, np.zeros((len(v), self.added))], axis=1)
        return [np.nan_to_num(f(times[None], x.T, v.T, p[:, None]), posinf=0.0, neginf=0.0) for f in functions]

    def matrices(self, times: np.ndarray, x: np.ndarray, v: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
        """Return the Jacobians A, B, C, D at N instants, at one where they do not change."""
        at = self._at(self._jacobians, times, x, v, p)
        changes = (np.abs(one - one[0]).max(initial=0.0) > CONSTANT * np.abs(one[0]).max(initial=0.0) for one in at)
        return at if any(changes) else [one[:1] for one in at]

    def left(self, times: np.ndarray, x: np.ndarray, v: np.ndarray, p: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return what a motion has beside the equations from each sample to the next, (N - 1, n): w of the module.

        Inputs and slopes are held over steps.
        """
        [given] = self._at(self._motion[:1], times, x, v, p)
        _, moved = zero_order_hold(given[:, :, 1 : self.n + 1], given[:, :, :1], steps)
        return np.asarray(np.diff(x, axis=0) - moved[:-1, :, 0])

    def moved(
        self, times: np.ndarray, x: np.ndarray, v: np.ndarray, p: np.ndarray, steps: np.ndarray, known: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return how far the diagram of itself is from a motion (N, n), the outputs (N, c) there, and their derivatives
        (N, c, m) by the parameters; known: what holding inputs gets wrong (`left` of a simulation)."""
        [f, g] = self._at(self._motion, times, x, v, p)
        F, moved = zero_order_hold(f[:, :, 1 : self.n + 1], f[:, :, self.n + 1 :], steps)
        beside = np.append(self.left(times, x, v, p, steps) - known, np.zeros((1, self.n)), axis=0)
        driven = np.concatenate([-beside[:, :, None], moved], axis=2)  # of each column the response
        states = recursion(F, np.eye(self.n)[None].repeat(len(F), axis=0), driven)[:-1]
        by = g[:, :, 1 : self.n + 1] @ states[:, :, 1:] + g[:, :, self.n + 1 :]
        return states[:, :, 0], g[:, :, 0], by
