"""Runs linearised about their simulation: what a signal added to any wire changes of all wires and of the outputs."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.equations import DrivenEquations, driven_equations
from rotorsim.identification.waveform.search import Evaluation, OutputErrorSearch
from rotorsim.identification.waveform.simulation import Simulation
from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler
from rotorsim.model.matrix_function import MatrixFunction

_C = """
#include <stdint.h>
#if defined(_WIN32)
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
/* x (N + 1, n, K): x_(k+1) = F_k x_k + G_k d_k, F (N, n, n), G (N, n, P), d (N, P, K); varying 0: F and G have one
 * sample. */
void rs_recursion(int64_t N, int64_t n, int64_t P, int64_t K, int64_t varying, const double *F, const double *G,
                  const double *d, double *x) {
  for (int64_t k = 0; k < N; ++k, x += n * K, d += P * K) {
    const double *f = F + varying * k * n * n, *g = G + varying * k * n * P;
    double *to = x + n * K;
    for (int64_t i = 0; i < n; ++i, to += K) {
      for (int64_t c = 0; c < K; ++c) to[c] = 0.0;
      for (int64_t j = 0; j < P; ++j)
        for (int64_t c = 0; c < K; ++c) to[c] += g[i * P + j] * d[j * K + c];
      for (int64_t j = 0; j < n; ++j)
        for (int64_t c = 0; c < K; ++c) to[c] += f[i * n + j] * x[j * K + c];
    }
  }
}
"""

TERMS = 18  # of the series of phi at a norm of 1: the next is 1/19! = 8e-18
CONSTANT = 1e-9  # relative: Jacobians that change less along all runs are those of a linear diagram


@cache
def _recursion() -> Any:
    """Return the recursion of the states in C, which takes a hundredth of the time of a loop here; None without."""
    if (compiler := find_compiler()) is None:
        return None
    try:
        function = compile_c(_C, compiler, "-O3")[0].rs_recursion
    except CompilerError:
        return None
    i64, ptr = ctypes.c_int64, ctypes.c_void_p
    function.argtypes, function.restype = [i64, i64, i64, i64, i64, ptr, ptr, ptr, ptr], None
    return function


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


def recursion(F: np.ndarray, G: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return x (N + 1, n, K) of x_(k+1) = F_k x_k + G_k d_k, x_0 = 0; F (N or 1, n, n), G (.., n, P), d (N, P, K)."""
    (N, P, K), n = d.shape, F.shape[1]
    states = np.zeros((N + 1, n, K))
    arrays = [np.ascontiguousarray(a, float) for a in (F, G, d)]
    if (run := _recursion()) is not None:
        run(N, n, P, K, int(len(F) > 1), *(a.ctypes.data for a in arrays), states.ctypes.data)
    else:
        for k in range(N):
            j = k if len(F) > 1 else 0
            states[k + 1] = F[j] @ states[k] + G[j] @ d[k]
    return states


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
        F, G = _sampled(A, B, np.full(1, run.dt) if run.steps is None else np.append(run.steps, run.dt))
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


def _sampled(A: np.ndarray, B: np.ndarray, dt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return F = exp(A dt) and G = int exp(A s) ds B for inputs that are held over a step.

    With M = A dt / 2^s: phi = sum M^k / (k + 1)!, exp M = 1 + M phi, and phi(2 M) = (1 + exp M) phi / 2, s times.
    SciPy's expm, the same to rounding, takes the matrices of all samples one by one.
    Source: Al-Mohy & Higham, SIAM J. Sci. Comput. 33 (2011) 488, 2; Van Loan, IEEE Trans. Autom. Control 23 (1978) 395.
    """
    M, one = A * dt[:, None, None], np.eye(A.shape[1])
    doublings = max(int(np.ceil(np.log2(max(np.abs(M).sum(axis=2).max(initial=0.0), 1e-300)))), 0)
    M = M / 2.0**doublings
    phi = np.broadcast_to(one, M.shape)
    for k in range(TERMS, 1, -1):
        phi = one + M @ phi / k
    F = one + M @ phi
    for _ in range(doublings):
        phi, F = (phi + F @ phi) / 2, F @ F
    return F, phi @ B * dt[:, None, None]
