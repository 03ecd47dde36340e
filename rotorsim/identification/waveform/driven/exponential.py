"""Exponential Runge-Kutta steps of a turning shaft: what is linear in its states is exact, however stiff.

x' = A x + E q,   y = C x + D q,   q = q(t, x, v; p)

with matrices of parameters, speed and acceleration of the shaft alone. Where fast modes of a structure follow their
forces at once, matrices are those of all its modes, reduced as numbers; laws read z = X x + Y q then, from what was
computed before (`Level`). From v_0 over the middle v_m to v_1 in a step h

x_1 = exp(M) x_0 + h [(phi_1 - 3 phi_2 + 4 phi_3) E q_1 + (2 phi_2 - 4 phi_3) E (q_2 + q_3) + (4 phi_3 - phi_2) E q_4],

M = A h, with q_1 .. q_4 at the stages of Krogstad: order four, and where no q depends on x that of a parabola through
the forces. Matrices follow speed and acceleration from block to block of samples: they are interpolated between
Chebyshev points, where they are computed with their derivatives by the parameters.

Source: S. Krogstad, J. Comput. Phys. 203 (2005) 72, eq. (51); Hochbruck & Ostermann, Acta Numerica 19 (2010) 209, 2.3;
Berrut & Trefethen, SIAM Rev. 46 (2004) 501, eq. (4.2) and (5.4).
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from rotorsim.identification.waveform.driven.equations import DrivenEquations
from rotorsim.identification.waveform.driven.source import source_of
from rotorsim.identification.waveform.driven.split import Level, Split
from rotorsim.jobs.threads import compiled
from rotorsim.linear.sampled import MOST_DOUBLINGS, phi_functions
from rotorsim.model.called import connect, forget_failures, raise_failure
from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler

STEP_DIGITS = 12  # of a step: the rest is rounding
BLOCK_SAMPLES = 8  # in which speed and acceleration are those of their mean: what is left is of second order in time
INTERPOLATED = 1e-8  # relative error of interpolated matrices, far below what steps are good to
MOST_POINTS = 9  # of speed, and of acceleration, between which matrices are interpolated
TRIED_SPEEDS = (0.11, 0.37, 0.5, 0.83)  # of the range of speeds: where that error is looked at

_RUNTIME = r"""
#define RS_DRIVEN (RS_LAWS ? RS_K : RS_M) /* derivatives of q: by the start only where it depends on the states */

/* y += M x and its derivatives R, of which the first in S are not zero. M is that of a table column by column, and its
 * derivatives by the parameters that move it follow behind all matrices, entry by entry. */
static const int rs_moves[] = {RS_MOVING};

static inline void rs_apply(int exact, int rows, int cols, int first, const double *table, int at, const double *x,
                            const double *S, double *restrict y, double *restrict R) {
  const double *M = table + at, *D = table + RS_T + at * RS_MOVES;
  for (int j = 0; j < cols; ++j)
    for (int i = 0; i < rows; ++i) y[i] += M[j * rows + i] * x[j];
  if (!exact) return;
  for (int i = 0; i < rows; ++i) {
    double *restrict to = R + i * RS_K, moved[RS_MOVES + 1] = {0};
    for (int j = 0; j < cols; ++j) {
      const double a = M[j * rows + i], *restrict from = S + j * RS_K, *restrict slopes = D + (j * rows + i) * RS_MOVES;
      for (int k = 0; k < first; ++k) to[k] += a * from[k];
      for (int l = 0; l < RS_MOVES; ++l) moved[l] += slopes[l] * x[j];
    }
    for (int l = 0; l < RS_MOVES; ++l) to[rs_moves[l]] += moved[l];
  }
}

/* What a level reads: rows of z = X x + Y q, of which the first laws are known; with its derivatives behind. */
#define RS_READ(first, rows, at_x, at_q, known)                                                      \
  for (int j = 0; j < rows; ++j) z[first + j] = 0.0;                                                 \
  if (exact) for (int j = 0; j < (rows) * RS_K; ++j) z[RS_Z + (first) * RS_K + j] = 0.0;             \
  rs_apply(exact, rows, RS_N, RS_K, table, at_x, w, w + RS_N, z + first, z + RS_Z + (first) * RS_K); \
  rs_apply(exact, rows, known, RS_K, table, at_q, q, q + RS_Q, z + first, z + RS_Z + (first) * RS_K);

/* Its laws, of what `from` holds, with their derivatives behind. */
#define RS_LEVEL(name, first, count, from, S)                                             \
  if (exact) {                                                                            \
    double *to = q + RS_Q + (first) * RS_K;                                               \
    rs_##name##_jacobian(t, from, v, p, c, q + first, jac, work);                         \
    for (int j = 0; j < (count) * RS_K; ++j) to[j] = 0.0;                                 \
    rs_multiply_##name(jac, S, to);                                                       \
  } else {                                                                                \
    rs_##name(t, from, v, p, c, q + first, work);                                         \
  }

/* q at a stage w = [x, S], with its derivatives behind. */
static inline void rs_forces(int exact, double t, const double *w, const double *v, const double *p, const double *c,
                             const double *table, double *z, double *q, double *jac, double *work) {
  RS_LEVELS
}

#define RS_MOVED(M, w, to) rs_apply(exact, RS_N, RS_N, RS_K, table, M, w, w + RS_N, to, to + RS_N)
#define RS_FORCED(M, q, to) rs_apply(exact, RS_N, RS_Q, RS_DRIVEN, table, M, q, q + RS_Q, to, to + RS_N)
#define RS_ZERO(to) for (int j = 0; j < size; ++j) to[j] = 0.0;

static inline int64_t rs_simulate(int exact, int64_t N, int64_t sub, int64_t block, int64_t nodes, double t0, double dt,
                                  const double *v, const double *p, const double *tables, const double *weights,
                                  double *w, double *y, double *dy, double *memory) {
  const int size = exact ? RS_N * (1 + RS_K) : RS_N, wide = exact ? RS_Q * (1 + RS_K) : RS_Q;
  const int entries = exact ? RS_T * (1 + RS_MOVES) : RS_T;
  const double h = dt / (double)sub;
  double *c = memory, *work = c + RS_NC, *jac = work + RS_WORK, *table = jac + RS_JAC, *next = table + entries;
  double *stage = next + size, *q1 = stage + size, *q2 = q1 + wide, *q3 = q2 + wide, *q4 = q3 + wide, *z = q4 + wide;
  rs_constants(p, c, work);
  for (int64_t i = 0; i < N; ++i) {
    if (i % block == 0) {
      const double *weight = weights + i / block * nodes;
      for (int j = 0; j < entries; ++j) table[j] = 0.0;
      for (int64_t n = 0; n < nodes; ++n)
        for (int j = 0; j < entries; ++j) table[j] += weight[n] * tables[n * entries + j];
    }
    const double t = t0 + dt * (double)i, *vi = v + (2 * sub + 1) * i * RS_NV;
    double large = 0.0;
    for (int j = 0; j < RS_N; ++j) large += fabs(w[j]);
    if (!(large < RS_LARGE)) return i;
    for (int j = RS_N; j < size; ++j)
      if (fabs(w[j]) < RS_SMALL) w[j] = 0.0; /* a start long forgotten */
    rs_forces(exact, t, w, vi, p, c, table, z, q1, jac, work);
    double *yi = y + i * RS_C, *di = dy + i * RS_C * RS_K;
    for (int j = 0; j < RS_C; ++j) yi[j] = 0.0;
    if (exact)
      for (int j = 0; j < RS_C * RS_K; ++j) di[j] = 0.0;
    rs_apply(exact, RS_C, RS_N, RS_K, table, RS_AT_C, w, w + RS_N, yi, di);
    rs_apply(exact, RS_C, RS_Q, RS_DRIVEN, table, RS_AT_D, q1, q1 + RS_Q, yi, di);
    if (i == N - 1) break;
    for (int64_t s = 0; s < sub; ++s) {
      const double ts = t + h * (double)s, *vs = vi + 2 * s * RS_NV;
      if (s) rs_forces(exact, ts, w, vs, p, c, table, z, q1, jac, work);
      RS_ZERO(next)
      RS_MOVED(RS_AT_F, w, next);
#if RS_LAWS
      RS_ZERO(stage)
      RS_MOVED(RS_AT_HALF, w, stage);
      RS_FORCED(RS_AT_21, q1, stage);
      rs_forces(exact, ts + h / 2, stage, vs + RS_NV, p, c, table, z, q2, jac, work);
      RS_ZERO(stage)
      RS_MOVED(RS_AT_HALF, w, stage);
      RS_FORCED(RS_AT_31, q1, stage);
      RS_FORCED(RS_AT_32, q2, stage);
      rs_forces(exact, ts + h / 2, stage, vs + RS_NV, p, c, table, z, q3, jac, work);
      for (int j = 0; j < size; ++j) stage[j] = next[j];
      RS_FORCED(RS_AT_41, q1, stage);
      RS_FORCED(RS_AT_43, q3, stage);
      for (int j = 0; j < wide; ++j) q2[j] = 0.5 * (q2[j] + q3[j]);
      rs_forces(exact, ts + h, stage, vs + 2 * RS_NV, p, c, table, z, q4, jac, work);
#else
      rs_forces(exact, ts + h / 2, w, vs + RS_NV, p, c, table, z, q2, jac, work);
      rs_forces(exact, ts + h, w, vs + 2 * RS_NV, p, c, table, z, q4, jac, work);
#endif
      RS_FORCED(RS_AT_W0, q1, next);
      RS_FORCED(RS_AT_WM, q2, next);
      RS_FORCED(RS_AT_W1, q4, next);
      for (int j = 0; j < size; ++j) w[j] = next[j];
    }
  }
  return N;
}

/* N samples dt apart; v (N, 2 sub + 1, n_v): inputs at the ends and middles of the sub steps after each. tables
 * (nodes, RS_T (1 + RS_MOVES)), weights (blocks, nodes): of each block of samples. w: x (n), then S (n, K), at the
 * first sample; y (N, c), dy (N, c, K). Returns the number of samples computed before it diverged. */
RS_EXPORT int64_t rs_run(int exact, int64_t N, int64_t sub, int64_t block, int64_t nodes, double t0, double dt,
                         const double *v, const double *p, const double *tables, const double *weights, double *w,
                         double *y, double *dy, double *memory) {
  return exact ? rs_simulate(1, N, sub, block, nodes, t0, dt, v, p, tables, weights, w, y, dy, memory)
               : rs_simulate(0, N, sub, block, nodes, t0, dt, v, p, tables, weights, w, y, dy, memory);
}
"""


class ExponentialSteps:
    """Exponential steps of equations in C, with so many sensitivities: by the m parameters, then by the start."""

    def __init__(self, equations: DrivenEquations, split: Split, columns: int) -> None:
        self.equations, self.split, self.columns = equations, split, columns
        self.n, self.c, self.r = equations.n, len(equations.outputs), split.r
        self._points: dict[tuple[Any, ...], list[np.ndarray]] = {}
        self._known: dict[tuple[Any, ...], np.ndarray] = {}  # those of the run before, if they are the same

    @property
    def _moves(self) -> int:
        """The number of parameters that matrices depend on."""
        return len(self.split.whole.moves)

    @property
    def _shapes(self) -> dict[str, tuple[int, int]]:
        """The matrices of a step, in their order in the tables."""
        n, c, r = self.n, self.c, self.r
        shapes = {"F": (n, n), "W0": (n, r), "WM": (n, r), "W1": (n, r), "C": (c, n), "D": (c, r)}
        stages = {"HALF": (n, n)} | dict.fromkeys(("21", "31", "32", "41", "43"), (n, r))
        for k, level in self._reading:
            stages |= {f"X{k}": (len(level.rows), n), f"Y{k}": (len(level.rows), level.before)}
        return shapes | (stages if self.split.laws else {})

    @property
    def _reading(self) -> list[tuple[int, Level]]:
        """The levels whose laws read z, with their numbers."""
        return [(k, level) for k, level in enumerate(self.split.levels) if level.rows]

    def _levels(self) -> str:
        """Return how q follows in C, level by level."""
        lines, first, reading = [], 0, dict(self._reading)
        source, slopes = ("z", "z + RS_Z") if self.equations.structure else ("w", "w + RS_N")
        for k, level in enumerate(self.split.levels):
            count = level.q.numel()
            if k in reading:
                tables = f"RS_AT_X{k}, RS_AT_Y{k}, {level.before}"
                lines.append(f"RS_READ({level.rows.start}, {len(level.rows)}, {tables})")
            lines.append(f"RS_LEVEL(q{k}, {first}, {count}, {source}, {slopes})")
            first += count
        return " ".join(lines)

    @cached_property
    def _library(self) -> tuple[Any, int] | None:
        compiler = find_compiler()
        if compiler is None:
            return None
        sizes = {key: rows * cols for key, (rows, cols) in self._shapes.items()}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        macros = {f"RS_AT_{key}": at for key, at in zip(sizes, ends, strict=False)}
        macros |= {"RS_T": ends[-1], "RS_M": self.equations.m, "RS_Q": self.r, "RS_LAWS": self.split.laws}
        macros |= {"RS_Z": self.split.read}
        macros |= {"RS_MOVES": self._moves, "RS_MOVING": ", ".join(map(str, self.split.whole.moves)) or "0"}
        laws = {f"q{k}": level.q for k, level in enumerate(self.split.levels)}
        runtime = _RUNTIME.replace("RS_LEVELS", self._levels())
        source, size, called = source_of(self.equations, laws, self.columns, runtime, macros, self.split.arguments[1])
        try:
            library = compile_c(source, compiler, "-O3")[0]
            connect(library, called)
            run = library.rs_run
        except CompilerError:
            return None
        i64, ptr, number = ctypes.c_int64, ctypes.c_void_p, ctypes.c_double
        run.argtypes, run.restype = [ctypes.c_int, i64, i64, i64, i64, number, number, *[ptr] * 8], i64
        return run, size + ends[-1] * (1 + self._moves)

    def simulate(
        self,
        p: np.ndarray,
        x0: np.ndarray,
        v: np.ndarray,
        dt: float,
        t0: float,
        sensitivities: bool,
        ranges: Mapping[str, tuple[float, float]],
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return y (N, c) and its derivatives (N, c, columns), as `Simulation.simulate`; None where it cannot.

        ranges: of inputs in all runs, whose matrices are then computed once; default those of this one.
        """
        sub, K = v.shape[1] // 2, self.columns if sensitivities else 0
        h = _digits(dt / sub)  # parts of one run have the same matrices
        slow = v[:, sub, self.split.slow]  # in the middle of what follows each sample
        names = [self.equations.inputs[k] for k in self.split.slow]
        own = zip(names, slow.min(axis=0, initial=np.inf), slow.max(axis=0, initial=-np.inf), strict=True)
        points = self._points_of([ranges.get(name, (low, high)) for name, low, high in own], p, h)
        if self._library is None or points is None:
            return None
        run, size = self._library
        N, block = len(v), BLOCK_SAMPLES if self.split.slow else len(v)
        means = np.add.reduceat(slow, np.arange(0, N, block)) / np.minimum(block, N - np.arange(0, N, block))[:, None]
        weights = _weights(points, means)
        m = self._moves if K else 0
        key = (p.tobytes(), h, m, *(one.tobytes() for one in points))
        if key not in self._known:
            self._known = {key: self._tables(points, p, h, m)}
        tables = self._known[key]
        state = np.concatenate([x0, np.eye(self.n, K, self.equations.m).ravel()])
        y, dy = np.empty((N, self.c)), np.empty((N, self.c, K))
        memory = np.zeros(size + (2 * self.n + 4 * self.r + self.split.read) * (1 + K))
        given = [np.ascontiguousarray(a, float) for a in (v, p, tables, weights)]
        arrays = [array.ctypes.data for array in (*given, state, y, dy, memory)]
        forget_failures()
        with compiled():
            done = run(int(K > 0), N, sub, block, len(tables), t0, dt, *arrays)
        raise_failure()
        y[done:], dy[done:] = np.nan, np.nan
        return y, dy

    def covers(self, p: np.ndarray, dt: float, ranges: Mapping[str, tuple[float, float]]) -> bool:
        """Return whether there are matrices for steps of dt over ranges of inputs, and a compiler."""
        names = [self.equations.inputs[k] for k in self.split.slow]
        known = [ranges[name] for name in names if name in ranges]
        complete = len(known) == len(names) and self._library is not None
        return complete and self._points_of(known, p, _digits(dt)) is not None

    def _points_of(self, ranges: list[tuple[float, float]], p: np.ndarray, h: float) -> list[np.ndarray] | None:
        """Return the points of speed and of acceleration for their ranges; None where MOST_POINTS are too few."""
        key = (*ranges, h)
        if key not in self._points:
            middle = [np.array([(a + b) / 2]) for a, b in ranges]
            found = list(middle)
            for k, (a, b) in enumerate(ranges):
                at = [*middle[:k], a + (b - a) * np.array(TRIED_SPEEDS), *middle[k + 1 :]]
                exact = self._tables(at, p, h, 0)
                for count in range(1 if a == b else 2, MOST_POINTS + 1):
                    found[k] = _chebyshev(a, b, count)
                    if self._error([*middle[:k], found[k], *middle[k + 1 :]], at, exact, p, h) < INTERPOLATED:
                        break
                else:
                    return None
            self._points[key] = found
        return self._points[key]

    def _error(
        self, points: list[np.ndarray], at: list[np.ndarray], exact: np.ndarray, p: np.ndarray, h: float
    ) -> float:
        """Return the relative error of interpolated matrices at other speeds, where they are known exactly."""
        near = _weights(points, np.array([*product(*at)])) @ self._tables(points, p, h, 0)
        ends = np.cumsum([rows * cols for rows, cols in self._shapes.values()])[:-1]
        pairs = zip(np.split(exact, ends, axis=1), np.split(near, ends, axis=1), strict=True)
        return max(float(np.abs(b - a).max(initial=0.0) / max(np.abs(a).max(initial=0.0), 1e-300)) for a, b in pairs)

    def _tables(self, points: Sequence[np.ndarray], p: np.ndarray, h: float, m: int) -> np.ndarray:
        """Return the matrices of a step at all points, then m derivatives of each entry, (nodes, RS_T (1 + m))."""
        nodes = np.array([*product(*points)])
        v = np.zeros((len(self.equations.inputs), len(nodes)))
        v[list(self.split.slow)] = nodes.T
        linear = self.split.matrices(v, p, m > 0)
        A, E, C, D = (linear[key] for key in "AECD")
        half = phi_functions(A.times(h / 2), MOST_DOUBLINGS)
        phi = half.doubled()
        one, two, three = ((part @ E).times(h) for part in (phi.one, phi.two, phi.three))
        parts = {
            "F": phi.exp,
            "W0": one + two.times(-3.0) + three.times(4.0),
            "WM": two.times(4.0) + three.times(-8.0),
            "W1": three.times(4.0) + two.times(-1.0),
            "C": C,
            "D": D,
        }
        if self.split.laws:
            first, second = ((part @ E).times(h) for part in (half.one, half.two))
            parts |= {
                "HALF": half.exp,
                "21": first.times(0.5),
                "31": first.times(0.5) + second.times(-1.0),
                "32": second,
                "41": one + two.times(-2.0),
                "43": two.times(2.0),
            }
        flat = []
        for key, (rows, columns) in self._shapes.items():
            part = parts.get(key) or linear[key]
            every = np.concatenate([part.value[None], part.slopes])
            every = np.broadcast_to(every, (1 + m, len(nodes), rows, columns))
            flat.append(every.transpose(1, 3, 2, 0).reshape(len(nodes), -1, 1 + m))
        whole = np.concatenate(flat, axis=1)
        return np.concatenate([whole[:, :, 0], whole[:, :, 1:].reshape(len(nodes), -1)], axis=1)


def _digits(step: float) -> float:
    """Return a step without the digits that are rounding."""
    return float(f"{step:.{STEP_DIGITS}g}")


def _chebyshev(low: float, high: float, count: int) -> np.ndarray:
    """Return points of the second kind, their middle where there is one."""
    angles = np.pi * np.arange(count) / max(count - 1, 1) if count > 1 else np.array([np.pi / 2])
    return np.asarray((low + high) / 2 - (high - low) / 2 * np.cos(angles))


def _weights(points: Sequence[np.ndarray], at: np.ndarray) -> np.ndarray:
    """Return the weights of all points in the interpolation at some values (B, k), (B, nodes)."""
    out = np.ones((len(at), 1))
    for own, x in zip(points, at.T, strict=True):
        sign = (-1.0) ** np.arange(len(own))
        sign[[0, -1]] *= 0.5
        apart = x[:, None] - own
        there = apart == 0
        ratio = sign / np.where(there, 1.0, apart)
        along = np.where(there.any(axis=1)[:, None], there, ratio / ratio.sum(axis=1, keepdims=True))
        out = (out[:, :, None] * along[:, None, :]).reshape(len(at), -1)
    return out
