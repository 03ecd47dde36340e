"""Kalman filters and smoothers in C, eight systems side by side.

What they return is said in `rotorsim.linear.kalman`; None without a compiler.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler

LANES = 8  # systems side by side, of which a vector of the processor holds two to eight


@cache
def _library() -> Any:
    """Return the functions in C; None without a compiler."""
    if (compiler := find_compiler()) is None:
        return None
    try:
        source = files("rotorsim.linear").joinpath("kalman.c").read_text("utf-8")
        library = compile_c(f"#define W {LANES}\n{source}", compiler, "-O3")[0]
    except CompilerError:
        return None
    i64, ptr = ctypes.c_int64, ctypes.c_void_p
    library.rs_filter.argtypes, library.rs_filter.restype = [*[i64] * 5, *[ptr] * 15], ctypes.c_int
    library.rs_smooth.argtypes, library.rs_smooth.restype = [*[i64] * 5, *[ptr] * 11], ctypes.c_int
    return library


Given = tuple[np.ndarray, ...]  # F, G, H, D, pole, Q of `rotorsim.linear.kalman.Systems`


class _Lanes:
    """Some of the systems, at most as many as there are lanes; the last fills those that are left."""

    def __init__(self, given: Given, P: np.ndarray, which: np.ndarray, y: np.ndarray) -> None:
        F, G, H, D, pole, Q = given
        self.count = len(which)
        which = np.append(which, np.repeat(which[-1:], LANES - len(which)))
        self.N, c, self.K = y.shape
        n = F.shape[1]
        arrays = F, G[:, :, which], H, D[:, :, which], pole[which]
        self.arrays = [np.ascontiguousarray(a, float) for a in arrays]
        self.Q, self.y = np.ascontiguousarray(Q[which].T, float), np.ascontiguousarray(y, float)
        self.P = np.array(np.moveaxis(P[which], 0, -1), float, order="C")
        self.sizes = self.N, n, c, self.K, int(len(F) > 1)
        own = self.N if len(F) > 1 else 1
        self.shapes = [(own, n + 1, n + 1), (own, n + 1, c), (own, c, c), (self.N, n + 1, self.K), (self.N, c, self.K)]

    def filter(self, kept: list[int]) -> tuple[np.ndarray, np.ndarray, dict[int, np.ndarray]]:
        """Return products, logarithms of variances, and what is kept, by its number in the arguments in C."""
        products, log_det = np.zeros((self.K, self.K, LANES)), np.zeros(LANES)
        parts = {k: np.empty((*self.shapes[k], LANES)) for k in kept}
        given = [*self.arrays, self.Q, self.P, self.y, products, log_det]
        pointers = [parts[k].ctypes.data if k in parts else None for k in range(len(self.shapes))]
        if _library().rs_filter(*self.sizes, *(a.ctypes.data for a in given), *pointers):
            raise MemoryError
        return np.moveaxis(products, -1, 0)[: self.count], log_det[: self.count], parts

    def smooth(self) -> tuple[np.ndarray, np.ndarray]:
        """Return x and d (N, B, n + 1, K) and the variance of d (N, B)."""
        *_, parts = self.filter([*range(len(self.shapes))])
        variances, gains, roots, x, v = parts.values()
        spread = np.empty((self.N, LANES))
        given = [*self.arrays, variances, gains, roots, x, v, spread]
        if _library().rs_smooth(*self.sizes, *(a.ctypes.data for a in given)):
            raise MemoryError
        return np.moveaxis(x, -1, 1)[:, : self.count], spread[:, : self.count]


def _blocks(given: Given, P: np.ndarray, y: np.ndarray) -> Iterator[_Lanes] | None:
    """Return the systems in blocks of lanes; None without a compiler, or where there are none."""
    if _library() is None or not len(P):
        return None
    return (_Lanes(given, P, np.arange(len(P))[k : k + LANES], y) for k in range(0, len(P), LANES))


def products(given: Given, P: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return what `Systems.products` does."""
    if (blocks := _blocks(given, P, y)) is None:
        return None
    every = [block.filter([])[:2] for block in blocks]
    return np.concatenate([one[0] for one in every]), np.concatenate([one[1] for one in every])


def gains(given: Given, P: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return what `Systems.gains` does."""
    if (blocks := _blocks(given, P, np.zeros((samples, given[2].shape[1], 0)))) is None:
        return None
    every = [(block.filter([1, 2]), block.count) for block in blocks]
    gain, root = (
        np.concatenate([np.moveaxis(parts[k], -1, 1)[:, :count] for (*_, parts), count in every], axis=1)
        for k in (1, 2)
    )
    return gain, root, np.concatenate([log_det for (_, log_det, _), _ in every])


def smoothed(given: Given, P: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return what `Systems.smoothed` does."""
    if (blocks := _blocks(given, P, y)) is None:
        return None
    every = [block.smooth() for block in blocks]
    return np.concatenate([one[0] for one in every], axis=1), np.concatenate([one[1] for one in every], axis=1)
