"""Simulate driven equations over a sampled run, with the exact sensitivities of every sample, in generated C.

A Runge-Kutta step is applied to x and S = dx/d(parameters, start) together, S' = f_x S + f_p, so that the sensitivities
are those of the steps themselves. Without a C compiler CasADi's virtual machine does the same, slowly.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import linear_sum_assignment

from rotorsim.identification.waveform.driven.equations import DrivenEquations
from rotorsim.identification.waveform.driven.exponential import ExponentialSteps
from rotorsim.identification.waveform.driven.source import source_of
from rotorsim.identification.waveform.driven.split import Split
from rotorsim.jobs.threads import compiled
from rotorsim.linear.sampled import LARGE, Tangent, first_order_hold, response
from rotorsim.model.called import connect, forget_failures, raise_failure
from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler
from rotorsim.model.runge_kutta import RK4

LONG = 1_000_000  # characters: of a shaft of finite elements -O3 takes five times as long, for code 15 % faster

_RUNTIME = r"""
/* w = [x, S]: state and its sensitivities (S only with exact). */
static inline void rs_rates(int exact, double t, const double *w, const double *v, const double *p, const double *c,
                            double *dw, double *jac, double *work) {
  if (exact) {
    rs_f_jacobian(t, w, v, p, c, dw, jac, work);
    for (int j = RS_N; j < RS_N * (1 + RS_K); ++j) dw[j] = 0.0;
    rs_multiply_f(jac, w + RS_N, dw + RS_N);
  } else {
    rs_f(t, w, v, p, c, dw, work);
  }
}

static inline int64_t rs_simulate(int exact, int size, int64_t N, int64_t sub, const double *times,
                                  const double *steps, const double *v, const double *p, double *restrict w, double *y,
                                  double *dy, double *memory) {
  double *c = memory, *work = c + RS_NC, *jac = work + RS_WORK;
  double *restrict ws = jac + RS_JAC, *restrict k = ws + size;
  rs_constants(p, c, work);
  for (int64_t i = 0; i < N; ++i) {
    const double t = times[i], h = steps[i] / (double)sub;
    const double *vi = v + (2 * sub + 1) * i * RS_NV;
    double large = 0.0;
    for (int j = 0; j < RS_N; ++j) large += fabs(w[j]);
    if (!(large < RS_LARGE)) return i;
    for (int j = RS_N; j < size; ++j)
      if (fabs(w[j]) < RS_SMALL) w[j] = 0.0; /* a start long forgotten */
    if (exact) {
      double *to = dy + i * RS_C * RS_K;
      rs_g_jacobian(t, w, vi, p, c, y + i * RS_C, jac, work);
      for (int j = 0; j < RS_C * RS_K; ++j) to[j] = 0.0;
      rs_multiply_g(jac, w + RS_N, to);
    } else {
      rs_g(t, w, vi, p, c, y + i * RS_C, work);
    }
    if (i == N - 1) break;
    for (int64_t s = 0; s < sub; ++s) {
      const double ts = t + h * (double)s;
      const double *vs = vi + 2 * s * RS_NV;
      RS_STEP
    }
  }
  return N;
}

/* N samples at times (N), steps (N) from one to the next in sub parts; v (N, 2 sub + 1, n_v): inputs at the ends and
 * middles of the parts.
 * w: x (n), then S (n, K), at the first sample; y (N, c), dy (N, c, K). memory: beside what is fixed, as often w as a
 * step has stages, and once more. Returns the number of samples computed before it diverged. */
RS_EXPORT int64_t rs_run(int exact, int64_t N, int64_t sub, const double *times, const double *steps, const double *v,
                         const double *p, double *w, double *y, double *dy, double *memory) {
  return exact ? rs_simulate(1, RS_N * (1 + RS_K), N, sub, times, steps, v, p, w, y, dy, memory)
               : rs_simulate(0, RS_N, N, sub, times, steps, v, p, w, y, dy, memory);
}
"""


@dataclass(frozen=True, eq=False)
class Simulation:
    """Driven equations, ready to be simulated over runs.

    name: "" for those of the whole diagram, else the controller that they are of. by_start: whether derivatives are
    by the states at the first sample, too. sensitive: whether there are any: of many outputs they are most of the code.
    """

    equations: DrivenEquations
    name: str = ""
    use_compiler: bool = True
    by_start: bool = True
    sensitive: bool = True

    @cached_property
    def _known(self) -> dict[tuple[Any, ...], tuple[np.ndarray, np.ndarray]]:
        return {}

    @property
    def signals(self) -> list[tuple[str, str]]:
        """What stands for the outputs where there are several simulations: (name, output)."""
        return [(self.name, output) for output in self.equations.outputs]

    @property
    def columns(self) -> int:
        """The number of derivatives of an output."""
        if not self.sensitive:
            return 0
        return self.equations.m + (self.equations.n if self.by_start else 0)

    @cached_property
    def _library(self) -> tuple[Any, int] | None:
        """The compiled function and the size of its fixed memory; None without a compiler."""
        compiler = find_compiler() if self.use_compiler else None
        if compiler is None:
            return None
        source, size, called = _source(self.equations, self.columns)
        try:
            library = compile_c(source, compiler, "-O3" if len(source) < LONG else "-O1")[0]
            connect(library, called)
            run = library.rs_run
        except CompilerError as failure:
            failure.warn("the fit runs on CasADi's virtual machine: the same numbers, several times slower")
            return None
        i64, ptr = ctypes.c_int64, ctypes.c_void_p
        run.argtypes, run.restype = [ctypes.c_int, i64, i64, *[ptr] * 8], i64
        return run, size

    @cached_property
    def _exponential(self) -> ExponentialSteps | None:
        split = Split.of(self.equations) if self.use_compiler and find_compiler() else None
        return None if split is None else ExponentialSteps(self.equations, split, self.columns)

    def exponential(self, p: np.ndarray, dt: float, ranges: Mapping[str, tuple[float, float]]) -> Split | None:
        """Return what steps of dt are exact for; None where they are of Runge-Kutta; ranges: of inputs."""
        steps = self._exponential
        return steps.split if steps is not None and steps.covers(p, dt, ranges) else None

    def fastest_eigenvalue(
        self, t: np.ndarray, x: np.ndarray, v: np.ndarray, p: np.ndarray, split: Split | None
    ) -> np.ndarray:
        """Return the size [rad/s] of the eigenvalue that limits steps, (N,); NaN where there is none.

        At times (1, N), states (n, N), inputs (n_v, N), parameters (n_p, N): the largest of df/dx, or, of steps that
        are exact for what is linear (split), that by which laws move one most.
        """
        if split is None:
            A = self.equations.matrices[0](t, x, v, p)
            found, good = np.full(len(A), np.nan), np.isfinite(A).all(axis=(1, 2))
            found[good] = np.abs(np.linalg.eigvals(A[good])).max(axis=1, initial=0.0)
            return found
        pairs = zip(*np.broadcast_arrays(*split.jacobians(t, x, v, p)), strict=True)
        return np.array([_moved(A, laws) for A, laws in pairs])

    def in_exponential_steps(
        self,
        p: np.ndarray,
        x0: np.ndarray,
        v: np.ndarray,
        dt: float,
        *,
        t0: float = 0.0,
        sensitivities: bool = True,
        ranges: Mapping[str, tuple[float, float]] | None = None,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return what `simulate` does of a shaft that turns, its linear part exactly; None where that cannot be.

        ranges: of inputs, in all runs that are simulated.
        """
        steps = self._exponential
        return None if steps is None else steps.simulate(p, x0, v, dt, t0, sensitivities, ranges or {})

    def simulate(
        self,
        p: np.ndarray,
        x0: np.ndarray,
        v: np.ndarray,
        dt: float | np.ndarray,
        *,
        t0: float = 0.0,
        sensitivities: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return y (N, c) and its derivatives (N, c, columns) by free parameters and start; NaN once it has diverged.

        p (n_p,), x0 (n,), v (N, 2 sub + 1, n_v): inputs at ends and middles of the ``sub`` steps that follow a sample.
        dt: between samples [s], one for all or (N - 1,). t0: time of the first [s].
        Without sensitivities the derivatives are (N, c, 0).
        """
        eq, N = self.equations, len(v)
        K = self.columns if sensitivities else 0
        state = np.concatenate([x0, np.eye(eq.n, K, eq.m).ravel()])
        v, p = np.ascontiguousarray(v, float), np.ascontiguousarray(p, float)
        steps, times = np.zeros(N), np.full(N, t0)
        steps[:-1] = dt
        times[1:] = t0 + (np.cumsum(steps[:-1]) if np.ndim(dt) else dt * np.arange(1, N))
        if self._library is None:
            return self._interpreted(p, state, v, times, steps)
        run, size = self._library
        y, dy = np.empty((N, len(eq.outputs))), np.empty((N, len(eq.outputs), K))
        memory = np.zeros(size + (1 + len(RK4.b)) * len(state))
        arrays = [array.ctypes.data for array in (times, steps, v, p, state, y, dy, memory)]
        forget_failures()
        with compiled():
            done = run(int(sensitivities), N, v.shape[1] // 2, *arrays)
        raise_failure()
        y[done:], dy[done:] = np.nan, np.nan
        return y, dy

    def exact(
        self, p: np.ndarray, x0: np.ndarray, v: np.ndarray, dt: float, *, sensitivities: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return what `simulate` does for linear equations, exactly, whose inputs are held or straight between samples.

        v (N, 2, n_v): inputs at a sample and at the end of the step that follows.
        """
        columns = self.columns if sensitivities else 0
        FE, CD = self._matrices(p, dt, self.equations.m if columns else 0)
        u = np.concatenate([v, np.ones((len(v), 2, 1))], axis=2).reshape(len(v), -1)
        return response(FE, CD, x0, u, columns, use_compiler=self.use_compiler)

    def _matrices(self, p: np.ndarray, dt: float, m: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrices of `response` with m derivatives; those of the run before, where they are the same."""
        key = (p.tobytes(), dt, m)
        if key not in self._known:
            n, linear = self.equations.n, self.equations.linear
            if linear is None:
                raise ValueError("the equations are not linear")
            L = linear(p)[0].reshape(n + len(self.equations.outputs), 1 + self.equations.m, -1).swapaxes(0, 1)[: 1 + m]
            A, B = (Tangent(part[0], part[1:]) for part in (L[:, :n, :n], L[:, :n, n:]))
            parts = [np.concatenate([part.value[None], part.slopes]) for part in first_order_hold(A, B, dt)]
            self._known.clear()
            self._known[key] = np.concatenate(parts, axis=2), L[:, n:]
        return self._known[key]

    def _interpreted(
        self, p: np.ndarray, state: np.ndarray, v: np.ndarray, times: np.ndarray, dt: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        eq, N, c = self.equations, len(v), len(self.equations.outputs)
        K = len(state) // eq.n - 1 if eq.n else 0
        steps, read = _interpreter(eq, N, v.shape[1] // 2, K)
        inputs = v.reshape(N, -1).T
        states = np.column_stack([state, np.array(steps(state, times[None], inputs, p, dt[None]))])[:, :N]
        rows = np.array(read(states, times[None], inputs[: len(eq.inputs)], p)).T
        good = np.isfinite(states).all(axis=0) & (np.abs(states[: eq.n]).sum(axis=0) < LARGE)
        rows[np.cumsum(~good) > 0] = np.nan
        return rows[:, :c], rows[:, c:].reshape(N, c, K)


def _moved(A: np.ndarray, laws: np.ndarray) -> float:
    """Return by how much laws move an eigenvalue of A, the one that they move most; NaN where that is not finite.

    In A + laws a mode is at that of A which is nearest to it, all together.
    """
    if not (np.isfinite(A).all() and np.isfinite(laws).all()):
        return np.nan
    apart = np.abs(np.linalg.eigvals(A)[:, None] - np.linalg.eigvals(A + laws))
    return float(apart[linear_sum_assignment(apart)].max())


@lru_cache(maxsize=8)
def _interpreter(eq: DrivenEquations, N: int, sub: int, K: int) -> tuple[Any, Any]:
    """Return CasADi functions of all N samples: states after each, and outputs; both with K sensitivities behind."""
    t, x, v, p = eq.arguments
    S = ca.SX.sym("S", K, eq.n)  # column-major: the rows of S one after another, as in memory
    state, inputs, dt = ca.vertcat(x, ca.vec(S)), ca.SX.sym("v", len(eq.inputs), 2 * sub + 1), ca.SX.sym("dt")

    def with_sensitivities(of: Any) -> Any:
        if not K:
            return ca.densify(of)
        jacobian = eq.jacobian(of)
        by_parameters = ca.horzcat(jacobian[:, eq.n :], ca.SX(of.shape[0], K - eq.m))
        return ca.densify(ca.vertcat(of, ca.vec(S @ jacobian[:, : eq.n].T + by_parameters.T)))

    f, h, w = ca.Function("f", [x, t, v, p], [eq.f]), dt / sub, x
    for s in range(sub):
        k: list[Any] = []
        for c, row in zip(RK4.c, RK4.a, strict=True):
            at = w + h * sum((a * stage for a, stage in zip(row, k, strict=True)), ca.SX(0))
            k.append(f(at, t + h * (s + c), inputs[:, 2 * s + round(2 * c)], p))
        w = w + h * sum((b * stage for b, stage in zip(RK4.b, k, strict=True)), ca.SX(0))
    step = ca.Function("step", [state, t, ca.vec(inputs), p, dt], [with_sensitivities(w)])
    read = ca.Function("read", [state, t, v, p], [with_sensitivities(eq.g)])
    return step.mapaccum("steps", N, [0], [0]), read.map("reads", "serial", N, [3], [])


def _source(eq: DrivenEquations, columns: int) -> tuple[str, int, dict[str, Any]]:
    """Return `source_of` Runge-Kutta steps with as many sensitivities."""
    return source_of(eq, {"f": eq.f, "g": eq.g}, columns, _RUNTIME.replace("RS_STEP", _step_in_c()), {})


def _step_in_c() -> str:
    """Return a step of w by h in C: stages k (s, size), of which those of `RK4` are at ends and middles of a step."""

    def moved(target: str, weights: Sequence[float]) -> str:
        terms = " + ".join(f"{weight!r} * k[{i} * size + j]" for i, weight in enumerate(weights) if weight)
        return f"for (int j = 0; j < size; ++j) {target}[j] = w[j] + h * ({terms});"

    lines = []
    for i, (c, row) in enumerate(zip(RK4.c, RK4.a, strict=True)):
        at = "ws" if any(row) else "w"
        lines += [moved(at, row)] if any(row) else []
        given = f"ts + {c!r} * h, {at}, vs + {round(2 * c)} * RS_NV, p, c"
        lines.append(f"rs_rates(exact, {given}, k + {i} * size, jac, work);")
    return "\n      ".join([*lines, moved("w", RK4.b)])
