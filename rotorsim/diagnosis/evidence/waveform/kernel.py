"""Simulate traced equations over a sampled run, with the exact derivatives of every sample, in generated C.

The classical Runge-Kutta step is applied to x and S = dx/d(parameters, start) together, S' = f_x S + f_p, so that the
derivatives are those of the steps themselves. Without a C compiler CasADi's virtual machine does the same, slowly.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagnosis.evidence.waveform.equations import TimeEquations
from rotorsim.model.emit import program as ir
from rotorsim.model.emit.program import Program
from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler
from rotorsim.model.emit.writer import Writer, array_leaf

__all__ = ["TimeKernel"]

LARGE = 1e100  # a state beyond has diverged
SMALL = 1e-200  # a derivative below is zero
BLOCK = 256  # samples that the virtual machine takes at once

_RUNTIME = r"""
/* out += (sparse value) S, whose last rows are the unit vectors of the parameters; RS_K columns. */
#define RS_MULTIPLY(name, COUNT, rows, cols)                                              \
  static inline void name(const double *value, const double *S, double *out) {            \
    for (int e = 0; e < COUNT; ++e) {                                                     \
      double *restrict to = out + rows[e] * RS_K;                                         \
      const double a = value[e];                                                          \
      if (cols[e] < RS_N) {                                                               \
        const double *restrict from = S + cols[e] * RS_K;                                 \
        for (int k = 0; k < RS_K; ++k) to[k] += a * from[k];                              \
      } else {                                                                            \
        to[cols[e] - RS_N] += a;                                                          \
      }                                                                                   \
    }                                                                                     \
  }
RS_MULTIPLY(rs_multiply_f, RS_F_COUNT, rs_f_rows, rs_f_cols)
RS_MULTIPLY(rs_multiply_g, RS_G_COUNT, rs_g_rows, rs_g_cols)

/* w = [x, S]: state and its derivatives (S only with slopes). */
static inline void rs_rates(int slopes, double t, const double *w, const double *v, const double *p, const double *c,
                            double *dw, double *jac, double *work) {
  if (slopes) {
    rs_f_slopes(t, w, v, p, c, dw, jac, work);
    for (int j = RS_N; j < RS_N * (1 + RS_K); ++j) dw[j] = 0.0;
    rs_multiply_f(jac, w + RS_N, dw + RS_N);
  } else {
    rs_f(t, w, v, p, c, dw, work);
  }
}

static inline int64_t rs_simulate(int slopes, int size, int64_t N, int64_t sub, double t0, double dt, const double *v,
                                  const double *p, double *restrict w, double *y, double *dy, double *memory) {
  double *c = memory, *work = c + RS_NC, *jac = work + RS_WORK;
  double *restrict ws = jac + RS_JAC, *restrict k = ws + size, *restrict sum = k + size;
  const double h = dt / (double)sub;
  rs_constants(p, c, work);
  for (int64_t i = 0; i < N; ++i) {
    const double t = t0 + dt * (double)i;
    const double *vi = v + (2 * sub + 1) * i * RS_NV;
    double large = 0.0;
    for (int j = 0; j < RS_N; ++j) large += fabs(w[j]);
    if (!(large < RS_LARGE)) return i;
    for (int j = RS_N; j < size; ++j)
      if (fabs(w[j]) < RS_SMALL) w[j] = 0.0; /* a start long forgotten; denormal numbers are slow */
    if (slopes) {
      double *to = dy + i * RS_C * RS_K;
      rs_g_slopes(t, w, vi, p, c, y + i * RS_C, jac, work);
      for (int j = 0; j < RS_C * RS_K; ++j) to[j] = 0.0;
      rs_multiply_g(jac, w + RS_N, to);
    } else {
      rs_g(t, w, vi, p, c, y + i * RS_C, work);
    }
    if (i == N - 1) break;
    for (int64_t s = 0; s < sub; ++s) {
      const double ts = t + h * (double)s;
      const double *vs = vi + 2 * s * RS_NV;
      rs_rates(slopes, ts, w, vs, p, c, sum, jac, work);
      for (int j = 0; j < size; ++j) ws[j] = w[j] + 0.5 * h * sum[j];
      rs_rates(slopes, ts + 0.5 * h, ws, vs + RS_NV, p, c, k, jac, work);
      for (int j = 0; j < size; ++j) sum[j] += 2.0 * k[j], ws[j] = w[j] + 0.5 * h * k[j];
      rs_rates(slopes, ts + 0.5 * h, ws, vs + RS_NV, p, c, k, jac, work);
      for (int j = 0; j < size; ++j) sum[j] += 2.0 * k[j], ws[j] = w[j] + h * k[j];
      rs_rates(slopes, ts + h, ws, vs + 2 * RS_NV, p, c, k, jac, work);
      for (int j = 0; j < size; ++j) w[j] += h / 6.0 * (sum[j] + k[j]);
    }
  }
  return N;
}

/* N samples, sub steps after each; v (N, 2 sub + 1, n_v): inputs at the ends and middles of the steps.
 * w: x (n), then S (n, K), at the first sample; y (N, c), dy (N, c, K). memory: 3 times w beside what is fixed.
 * Returns the number of samples computed before it diverged. */
RS_EXPORT int64_t rs_run(int slopes, int64_t N, int64_t sub, double t0, double dt, const double *v, const double *p,
                         double *w, double *y, double *dy, double *memory) {
  return slopes ? rs_simulate(1, RS_N * (1 + RS_K), N, sub, t0, dt, v, p, w, y, dy, memory)
                : rs_simulate(0, RS_N, N, sub, t0, dt, v, p, w, y, dy, memory);
}
"""


class TimeKernel:
    """The simulation of one set of `TimeEquations`. compiler: which one made it, "" without."""

    def __init__(self, equations: TimeEquations, use_compiler: bool = True) -> None:
        self.equations = equations
        compiler = find_compiler() if use_compiler else None
        self.compiler = compiler.name if compiler else ""
        self._steps: dict[tuple[int, int, bool], Any] = {}
        if compiler:
            source, self._size = _source(equations)
            try:
                library, _ = compile_c(source, compiler, "-O3")
            except CompilerError as failure:
                self.compiler = ""
                failure.warn("the fit runs on CasADi's virtual machine: the same numbers, several times slower")
                return
            self._run = library.rs_run
            i64, f64, ptr = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
            self._run.argtypes = [ctypes.c_int, i64, i64, f64, f64, *[ptr] * 6]
            self._run.restype = i64

    def simulate(
        self, p: np.ndarray, x0: np.ndarray, v: np.ndarray, dt: float, *, t0: float = 0.0, slopes: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return y (N, c) and its derivatives (N, c, m + n) by free parameters and start; NaN once it has diverged.

        p (n_p,), x0 (n,), v (N, 2 sub + 1, n_v): inputs at ends and middles of the ``sub`` steps that follow a sample.
        dt: between samples [s].
        """
        eq = self.equations
        count, sub = len(v), (v.shape[1] - 1) // 2
        K = eq.m + eq.n if slopes else 0
        state = np.zeros(eq.n * (1 + K))
        state[: eq.n] = x0
        if slopes:
            state[eq.n :].reshape(eq.n, K)[:, eq.m :] = np.eye(eq.n)
        y, dy = np.empty((count, eq.c)), np.empty((count, eq.c, K))
        v, p = np.ascontiguousarray(v, float), np.ascontiguousarray(p, float)
        if self.compiler:
            memory = np.zeros(self._size + 3 * len(state))
            arrays = [array.ctypes.data for array in (v, p, state, y, dy, memory)]
            done = self._run(int(slopes), count, sub, t0, dt, *arrays)
        else:
            done = self._interpreted(count, sub, t0, dt, v, p, state, y, dy)
        y[done:], dy[done:] = np.nan, np.nan
        return y, dy

    def _interpreted(
        self,
        count: int,
        sub: int,
        t0: float,
        dt: float,
        v: np.ndarray,
        p: np.ndarray,
        state: np.ndarray,
        y: np.ndarray,
        dy: np.ndarray,
    ) -> int:
        eq, K = self.equations, dy.shape[2]
        step, read = self._step(sub, BLOCK, K > 0)
        for first in range(0, count, BLOCK):
            size = min(BLOCK, count - first)
            times = t0 + dt * (first + np.arange(BLOCK))
            inputs = v[np.minimum(first + np.arange(BLOCK), count - 1)].reshape(BLOCK, -1).T
            later = np.array(step(state, times[None], inputs, p, dt))
            states = np.column_stack([state, later[:, :-1]])
            good = np.isfinite(states).all(axis=0) & (np.abs(states[: eq.n]).sum(axis=0) < LARGE)
            kept = size if good[:size].all() else int(np.argmin(good[:size]))
            rows = np.array(read(states, times[None], inputs[: eq.n_v], p)).T[:kept]
            y[first : first + kept] = rows[:, : eq.c]
            dy[first : first + kept] = rows[:, eq.c :].reshape(kept, eq.c, K)
            if kept < size:
                return first + kept
            state = later[:, -1]
        return count

    def _step(self, sub: int, block: int, slopes: bool) -> Any:
        """Return CasADi functions that take ``block`` samples at once: later states, and what is measured."""
        key = (sub, block, slopes)
        if key not in self._steps:
            eq = self.equations
            t, x, v, p = (eq.arguments[name] for name in ("t", "x", "v", "p"))
            K = eq.m + eq.n if slopes else 0
            S = ca.SX.sym("S", K, eq.n)  # column-major: the rows of S one after another, as in memory
            rates = ca.vertcat(eq.f, _moved(eq.f_slopes, eq.f_nonzeros, S, eq.n, eq.n) if K else ca.SX(0, 1))
            state = ca.vertcat(x, ca.vec(S))
            f = ca.Function("f", [t, state, v, p], [ca.densify(rates)])
            dt, t0, w, inputs = ca.SX.sym("dt"), ca.SX.sym("t"), state, ca.SX.sym("v", eq.n_v, 2 * sub + 1)
            h = dt / sub
            for s in range(sub):
                at = [inputs[:, 2 * s + k] for k in range(3)]
                k1 = f(t0 + h * s, w, at[0], p)
                k2 = f(t0 + h * (s + 0.5), w + h / 2 * k1, at[1], p)
                k3 = f(t0 + h * (s + 0.5), w + h / 2 * k2, at[1], p)
                k4 = f(t0 + h * (s + 1), w + h * k3, at[2], p)
                w = w + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            one = ca.Function("step", [state, t0, ca.vec(inputs), p, dt], [w])
            g = ca.vertcat(eq.g, _moved(eq.g_slopes, eq.g_nonzeros, S, eq.n, eq.c) if K else ca.SX(0, 1))
            read = ca.Function("read", [state, t, v, p], [ca.densify(g)])
            repeated = one.mapaccum("steps", block, [0], [0])
            self._steps[key] = repeated, read.map("reads", "serial", block, [3], [])
        return self._steps[key]


def _moved(value: Any, places: Sequence[np.ndarray], S: Any, n: int, count: int) -> Any:
    """Return d(of)/d(parameters, start) (count, K), row by row in one column, from sparse slopes of it."""
    rows, cols = places
    out = [ca.SX.zeros(S.shape[0], 1) for _ in range(count)]
    for e, (i, j) in enumerate(zip(rows.tolist(), cols.tolist(), strict=True)):
        if j < n:
            out[i] = out[i] + value[e] * S[:, j]
        else:
            out[i][j - n] = out[i][j - n] + value[e]
    return ca.vertcat(*out)


def _source(eq: TimeEquations) -> tuple[str, int]:
    """Return the C source of a simulation, and the size of its memory beside the states."""
    arguments = [eq.arguments[name] for name in ("t", "x", "v", "p")]
    function = ca.Function("f", arguments, [eq.f, ca.densify(eq.f_slopes), eq.g, ca.densify(eq.g_slopes)])
    program = Program()
    f, f_slopes, g, g_slopes = program.load(function, ("t", "x", "v", "p"))
    every = [*f, *f_slopes, *g, *g_slopes]
    level = ir.LEVEL_PARAMETER
    constants = [
        k for k in program.boundary(every, level) if program.levels[k] == level and program.nodes[k][0] != ir.INPUT
    ]
    given = {node: f"c[{k}]" for k, node in enumerate(constants)}
    state = "double t, const double *x, const double *v, const double *p, const double *c"
    parts = [
        Writer(program, {}, array_leaf).text(
            "rs_constants",
            "const double *p, double *c, double *work",
            "p, c, work",
            [(f"c[{k}]", node) for k, node in enumerate(constants)],
        )
    ]
    for name, nodes, slopes in (("rs_f", f, f_slopes), ("rs_g", g, g_slopes)):
        plain = [(f"out[{k}]", node) for k, node in enumerate(nodes)]
        more = [(f"jac[{k}]", node) for k, node in enumerate(slopes)]
        writer = Writer(program, given, array_leaf)
        parts.append(writer.text(name, f"{state}, double *out, double *work", "t, x, v, p, c, out, work", plain))
        parts.append(
            writer.text(
                f"{name}_slopes",
                f"{state}, double *out, double *jac, double *work",
                "t, x, v, p, c, out, jac, work",
                [*plain, *more],
            )
        )
    work = max(size for _, size in parts)
    jac = max(len(f_slopes), len(g_slopes))
    sizes = {
        "RS_N": eq.n,
        "RS_K": eq.m + eq.n,
        "RS_C": eq.c,
        "RS_NV": eq.n_v,
        "RS_NC": len(constants),
        "RS_WORK": work,
        "RS_JAC": jac,
        "RS_F_COUNT": len(f_slopes),
        "RS_G_COUNT": len(g_slopes),
        "RS_LARGE": LARGE,
        "RS_SMALL": SMALL,
    }
    head = ["#include <math.h>", "#include <stdint.h>", "#include <string.h>"]
    head += [f"#define {name} {value}" for name, value in sizes.items()]
    head += ["#if defined(_WIN32)", "#define RS_EXPORT __declspec(dllexport)", "#else"]
    head += ['#define RS_EXPORT __attribute__((visibility("default")))', "#endif"]
    for name, (rows, cols) in (("f", eq.f_nonzeros), ("g", eq.g_nonzeros)):
        for key, values in (("rows", rows), ("cols", cols)):
            listed = ", ".join(map(str, values.tolist())) or "0"
            head.append(f"static const int rs_{name}_{key}[] = {{{listed}}};")
    return "\n".join([*head, *(text for text, _ in parts), _RUNTIME]), len(constants) + work + jac
