"""Linear equations x' = A x + B v from sample to sample, exactly, and the recursion of what follows.

With M = A h: phi_k = int_0^1 exp((1 - s) M) s^(k-1) / (k-1)! ds, exp M = 1 + M phi_1, phi_1 = 1 + M phi_2,
phi_2 = 1/2 + M phi_3, and for twice the step phi_1(2 M) = (exp M phi_1 + phi_1) / 2, phi_2(2 M) = (exp M phi_2 + phi_1
+ phi_2) / 4, phi_3(2 M) = (exp M phi_3 + phi_1 / 2 + phi_2 + phi_3) / 8. SciPy's expm, the same to rounding, takes
matrices one by one and gives neither phi nor derivatives.

Source: Al-Mohy & Higham, SIAM J. Sci. Comput. 33 (2011) 488, 2; Van Loan, IEEE Trans. Autom. Control 23 (1978) 395;
Skaflestad & Wright, Appl. Numer. Math. 59 (2009) 783 (doubling); Parlett & Reinsch, Numer. Math. 13 (1969) 293.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import matrix_balance

from rotorsim.jobs.threads import compiled
from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler

TERMS = 18  # of the series of phi_3 at a norm of 1: the next is 1/21! = 2e-20
MOST_DOUBLINGS = 30  # of a step: each may double the rounding of slow modes beside fast ones, 2^30 eps = 2.4e-7

_C = r"""
#include <stdint.h>
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define INLINE static inline __attribute__((always_inline))
/* w columns of to = A x + B d, A (m, n), B (m, P); of what has K columns in all. */
INLINE void rs_sum(int64_t m, int64_t n, int64_t P, int64_t K, int w, const double *A, const double *x, int64_t x_K,
                   const double *B, const double *d, double *to, int64_t to_K) {
  for (int64_t i = 0; i < m; ++i) {
    double sum[8] = {0};
    for (int64_t j = 0; j < P; ++j)
      for (int c = 0; c < w; ++c) sum[c] += B[i * P + j] * d[j * K + c];
    for (int64_t j = 0; j < n; ++j)
      for (int c = 0; c < w; ++c) sum[c] += A[i * n + j] * x[j * x_K + c];
    for (int c = 0; c < w; ++c) to[i * to_K + c] = sum[c];
  }
}
INLINE void rs_states(int64_t N, int64_t n, int64_t P, int64_t K, int w, int64_t varying, const double *F,
                      const double *G, const double *d, double *x) {
  for (int64_t k = 0; k < N; ++k, x += n * K, d += P * K, F += varying * n * n, G += varying * n * P)
    rs_sum(n, n, P, K, w, F, x, K, G, d, x + n * K, K);
}
INLINE void rs_shown(int64_t N, int64_t n, int64_t P, int64_t c, int64_t K, int w, int64_t varying, const double *F,
                     const double *G, const double *H, const double *D, const double *d, double *x, double *y) {
  double *next = x + n * 8;
  for (int64_t i = 0; i < n * 8; ++i) x[i] = 0.0;
  for (int64_t k = 0; k < N; ++k, d += P * K, y += c * K) {
    rs_sum(c, n, P, K, w, H + varying * k * c * n, x, 8, D + varying * k * c * P, d, y, K);
    rs_sum(n, n, P, K, w, F + varying * k * n * n, x, 8, G + varying * k * n * P, d, next, 8);
    double *last = x;
    x = next, next = last;
  }
}
/* call(w) for each eight columns from b on, with the number of columns known to the compiler. */
#define EACH_EIGHT(call) \
  for (int64_t b = 0; b < K; b += 8) switch (K - b) { \
    case 1: call(1); break; \
    case 2: call(2); break; \
    case 3: call(3); break; \
    case 4: call(4); break; \
    case 5: call(5); break; \
    case 6: call(6); break; \
    case 7: call(7); break; \
    default: call(8); \
    }
/* x (N + 1, n, K): x_(k+1) = F_k x_k + G_k d_k, F (N, n, n), G (N, n, P), d (N, P, K); varying 0: F and G have one
 * sample. */
EXPORT void rs_recursion(int64_t N, int64_t n, int64_t P, int64_t K, int64_t varying, const double *F, const double *G,
                         const double *d, double *x) {
#define STATES(w) rs_states(N, n, P, K, w, varying, F, G, d + b, x + b)
  EACH_EIGHT(STATES)
}
/* y (N, c, K): y_k = H_k x_k + D_k d_k of that recursion, H (N, c, n), D (N, c, P); x: room for 16 n. */
EXPORT void rs_outputs(int64_t N, int64_t n, int64_t P, int64_t c, int64_t K, int64_t varying, const double *F,
                       const double *G, const double *H, const double *D, const double *d, double *x, double *y) {
#define SHOWN(w) rs_shown(N, n, P, c, K, w, varying, F, G, H, D, d + b, x, y + b)
  EACH_EIGHT(SHOWN)
}
"""

_RESPONSE = """
#include <math.h>
#include <stdint.h>
#if defined(_WIN32)
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
/* x_(k+1) = F x_k + E [v_k; 1; w_k; 1], y_k = C x_k + D [v_k; 1], and their derivatives S (n, K), dy (N, c, K) by m
 * parameters, of which those of [F E] and [C D] are given, and by states at first. u (N, U) is [v; 1; w; 1].
 * FE (n + U, n), by_FE (n + U, n, M), CD (c, n + U / 2), by_CD (n + U / 2, c, M). Returns the number of samples before
 * it diverged. */
int64_t rs_response(int64_t N, const double *FE, const double *by_FE, const double *CD, const double *by_CD,
                    const double *u, double *x, double *S, double *y, double *dy) {
  for (int64_t k = 0; k < N; ++k, u += RS_U, y += RS_C, dy += RS_C * RS_K) {
    double z[RS_N + RS_U], next[RS_N], after[RS_N * RS_K + 1], large = 0.0;
    for (int i = 0; i < RS_N; ++i) large += fabs(z[i] = x[i]);
    if (!(large < RS_LARGE)) return k;
    for (int i = 0; i < RS_U; ++i) z[RS_N + i] = u[i];
    for (int c = 0; c < RS_C; ++c) {
      y[c] = 0.0;
      for (int i = 0; i < RS_N + RS_U / 2; ++i) y[c] += CD[c * (RS_N + RS_U / 2) + i] * z[i];
      double *restrict to = dy + c * RS_K;
      for (int j = 0; j < RS_K; ++j) to[j] = 0.0;
      for (int i = 0; i < RS_N; ++i)
        for (int j = 0; j < RS_K; ++j) to[j] += CD[c * (RS_N + RS_U / 2) + i] * S[i * RS_K + j];
      for (int i = 0; i < RS_N + RS_U / 2; ++i)
        for (int j = 0; j < RS_M; ++j) to[j] += by_CD[(i * RS_C + c) * RS_M + j] * z[i];
    }
    for (int i = 0; i < RS_N; ++i) {
      double *restrict to = after + i * RS_K;
      for (int j = 0; j < RS_K; ++j) to[j] = 0.0;
      for (int l = 0; l < RS_N; ++l)
        for (int j = 0; j < RS_K; ++j) to[j] += FE[l * RS_N + i] * S[l * RS_K + j];
      for (int l = 0; l < RS_N + RS_U; ++l)
        for (int j = 0; j < RS_M; ++j) to[j] += by_FE[(l * RS_N + i) * RS_M + j] * z[l];
      next[i] = 0.0;
    }
    for (int l = 0; l < RS_N + RS_U; ++l)
      for (int i = 0; i < RS_N; ++i) next[i] += FE[l * RS_N + i] * z[l];
    for (int i = 0; i < RS_N; ++i) x[i] = next[i];
    for (int j = 0; j < RS_N * RS_K; ++j) S[j] = fabs(after[j]) < RS_SMALL ? 0.0 : after[j]; /* long forgotten */
  }
  return N;
}
"""
LARGE = 1e100  # a state beyond has diverged
SMALL = 1e-200  # a derivative below is zero: denormal numbers are slow


@cache
def _recursion() -> Any:
    """Return the recursion in C, which takes a hundredth of the time of a loop here; None without a compiler."""
    if (compiler := find_compiler()) is None:
        return None
    try:
        library = compile_c(_C, compiler, "-O3")[0]
    except CompilerError:
        return None
    i64, ptr = ctypes.c_int64, ctypes.c_void_p
    library.rs_recursion.argtypes, library.rs_recursion.restype = [*[i64] * 5, *[ptr] * 4], None
    library.rs_outputs.argtypes, library.rs_outputs.restype = [*[i64] * 6, *[ptr] * 7], None
    return library


def recursion(F: np.ndarray, G: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return x (N + 1, n, K) of x_(k+1) = F_k x_k + G_k d_k, x_0 = 0; F (N or 1, n, n), G (.., n, P), d (N, P, K)."""
    (N, P, K), n = d.shape, F.shape[1]
    states = np.zeros((N + 1, n, K))
    arrays = [np.ascontiguousarray(a, float) for a in (F, G, d)]
    if (library := _recursion()) is not None:
        library.rs_recursion(N, n, P, K, int(len(F) > 1), *(a.ctypes.data for a in arrays), states.ctypes.data)
    else:
        for k in range(N):
            j = k if len(F) > 1 else 0
            states[k + 1] = F[j] @ states[k] + G[j] @ d[k]
    return states


def outputs(F: np.ndarray, G: np.ndarray, H: np.ndarray, D: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return y (N, c, K) of y_k = H_k x_k + D_k d_k of the same recursion; H (N or 1, c, n), D (N or 1, c, P)."""
    if (library := _recursion()) is None:
        return np.asarray(H @ recursion(F, G, d)[:-1] + D @ d)
    (N, P, K), n, c = d.shape, F.shape[1], H.shape[1]
    y, x = np.empty((N, c, K)), np.empty(16 * n)
    arrays = [np.ascontiguousarray(a, float) for a in (F, G, H, D, d)]
    library.rs_outputs(N, n, P, c, K, int(len(F) > 1), *(a.ctypes.data for a in (*arrays, x, y)))
    return y


@cache
def _response(n: int, U: int, c: int, m: int, K: int) -> Any:
    """Return the response in C for some sizes; None without a compiler."""
    if (compiler := find_compiler()) is None:
        return None
    sizes = {"N": n, "U": U, "C": c, "M": m, "K": K, "LARGE": LARGE, "SMALL": SMALL}
    head = "".join(f"#define RS_{name} {value}\n" for name, value in sizes.items())
    try:
        function = compile_c(head + _RESPONSE, compiler, "-O3")[0].rs_response
    except CompilerError:
        return None
    i64, ptr = ctypes.c_int64, ctypes.c_void_p
    function.argtypes, function.restype = [i64, *[ptr] * 9], i64
    return function


def response(
    FE: np.ndarray, CD: np.ndarray, x0: np.ndarray, u: np.ndarray, K: int, *, use_compiler: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Return y (N, c) of x_(k+1) = F x_k + E u_k, y_k = C x_k + D u_k and derivatives (N, c, K); NaN once it diverged.

    FE (1 + m, n, n + U): [F E] and its derivatives by m parameters; CD (1 + m, c, n + U / 2): of the first half of u.
    u (N, U). K: m, or m + n with those by the states at first x0 (n,), or 0 with m = 0.
    """
    (N, U), n, c, m = u.shape, len(x0), CD.shape[1], len(FE) - 1
    x, S = np.array(x0, float), np.eye(n, K, m)
    y, dy = np.full((N, c), np.nan), np.full((N, c, K), np.nan)
    columns, slopes = FE[0].T, np.moveaxis(FE[1:], 0, 2).swapaxes(0, 1)
    reads, by = CD[0], np.moveaxis(CD[1:], 0, 2).swapaxes(0, 1)
    if (run := _response(n, U, c, m, K) if use_compiler else None) is not None:
        given = [np.ascontiguousarray(a, float) for a in (columns, slopes, reads, by, u)]
        addresses = [a.ctypes.data for a in (*given, x, S, y, dy)]
        with compiled():
            done = run(N, *addresses)
        y[done:], dy[done:] = np.nan, np.nan
        return y, dy
    for k in range(N):
        if not np.abs(x).sum() < LARGE:
            break
        z, more = np.concatenate([x, u[k]]), np.zeros((n, K))
        seen = z[: n + U // 2]
        y[k], dy[k] = reads @ seen, reads[:, :n] @ S
        dy[k, :, :m] += np.tensordot(seen, by, 1)
        more[:, :m] = np.tensordot(z, slopes, 1)
        x, S = z @ columns, FE[0, :, :n] @ S + more
    return y, dy


@dataclass(frozen=True, eq=False)
class Tangent:
    """Matrices (.., n, k) and their derivatives by m parameters, (m, .., n, k); m may be 0."""

    value: np.ndarray
    slopes: np.ndarray
    __array_ufunc__ = None  # M @ tangent is asked of the tangent

    def __matmul__(self, other: Tangent | np.ndarray) -> Tangent:
        if isinstance(other, np.ndarray):
            return Tangent(self.value @ other, self.slopes @ other)
        return Tangent(self.value @ other.value, self.slopes @ other.value + self.value @ other.slopes)

    def __rmatmul__(self, other: np.ndarray) -> Tangent:
        return Tangent(other @ self.value, other @ self.slopes)

    def __add__(self, other: Tangent | np.ndarray) -> Tangent:
        if isinstance(other, np.ndarray):
            return Tangent(self.value + other, self.slopes)
        return Tangent(self.value + other.value, self.slopes + other.slopes)

    def part(self, rows: slice | list[int] = slice(None), columns: slice | list[int] = slice(None)) -> Tangent:
        """Return some rows and columns."""
        return Tangent(*(of[..., rows, :][..., columns] for of in (self.value, self.slopes)))

    def times(self, factor: float | np.ndarray) -> Tangent:
        """Return a multiple."""
        return Tangent(self.value * factor, self.slopes * factor)

    def plus(self, factor: float = 1.0) -> Tangent:
        """Return it plus a multiple of the unit matrix."""
        return Tangent(self.value + factor * np.eye(self.value.shape[-1]), self.slopes)


@dataclass(frozen=True, eq=False)
class Phi:
    """exp M, phi_1, phi_2 and phi_3 of matrices M (.., n, n), with their derivatives."""

    exp: Tangent
    one: Tangent
    two: Tangent
    three: Tangent

    def doubled(self) -> Phi:
        """Return those of 2 M."""
        F, one, two, three = self.exp, self.one, self.two, self.three
        return Phi(
            F @ F,
            (F @ one + one).times(1 / 2),
            (F @ two + one + two).times(1 / 4),
            (F @ three + one.times(1 / 2) + two + three).times(1 / 8),
        )

    def times(self, factor: float | np.ndarray) -> Phi:
        """Return all of them times a factor."""
        return Phi(*(part.times(factor) for part in (self.exp, self.one, self.two, self.three)))


@np.errstate(over="ignore", invalid="ignore")
def phi_functions(M: Tangent, most: float = np.inf) -> Phi:
    """Return exp M, phi_1, phi_2 and phi_3 of matrices (.., n, n), with their derivatives.

    M is balanced first, since states have units of any size. NaN where so many doublings are not enough.
    """
    n = M.value.shape[-1]
    size = np.abs(M.value).max(axis=tuple(range(M.value.ndim - 2)), initial=0.0)
    scale = matrix_balance(size, permute=False, separate=True)[1][0] if n and np.isfinite(size).all() else np.ones(n)
    unscaled = scale[:, None] / scale
    M = M.times(1 / unscaled)
    norm = float(np.abs(M.value).sum(axis=-1).max(initial=0.0))
    doublings = max(int(np.ceil(np.log2(max(norm, 1e-300)))), 0) if np.isfinite(norm) else 0
    if doublings > most:
        nothing = M.times(np.nan)
        return Phi(nothing, nothing, nothing, nothing)
    M = M.times(0.5**doublings)
    series = Tangent(np.broadcast_to(np.eye(n), M.value.shape), np.zeros_like(M.slopes))
    for k in range(TERMS, 3, -1):
        series = (M @ series).times(1 / k).plus()
    three = series.times(1 / 6)
    two = (M @ three).plus(1 / 2)
    one = (M @ two).plus()
    found = Phi((M @ one).plus(), one, two, three)
    for _ in range(doublings):
        found = found.doubled()
    return found.times(unscaled)


def zero_order_hold(A: np.ndarray, B: np.ndarray, dt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return F = exp(A dt) and G = int exp(A s) ds B (N, n, ..) for inputs that are held over steps dt (N,)."""
    M = A * dt[:, None, None]
    phi = phi_functions(Tangent(M, np.zeros((0, *M.shape))))
    return phi.exp.value, phi.one.value @ B * dt[:, None, None]


def first_order_hold(A: Tangent, B: Tangent, dt: float) -> tuple[Tangent, Tangent, Tangent]:
    """Return F, G and H of x_(k+1) = F x_k + G v_k + H w_k where inputs go straight from v to w within a step.

    NaN where A dt is larger than 2^MOST_DOUBLINGS.
    """
    phi = phi_functions(A.times(dt), MOST_DOUBLINGS)
    H = (phi.two @ B).times(dt)
    return phi.exp, (phi.one @ B).times(dt) + H.times(-1.0), H
