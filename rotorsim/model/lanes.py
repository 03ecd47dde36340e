"""Runs of one diagram side by side, in the lanes of vectors: what differs are parameters, states, lengths of steps."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import casadi as ca
import numpy as np

from rotorsim.model.compiled import Model
from rotorsim.model.emit.emit import build_kernel, emit_c
from rotorsim.model.emit.toolchain import Compiler, compile_c, compiler_error

ALIGNMENT = 64  # bytes, of the longest vectors


@dataclass(eq=False)
class Reduction:
    """What is kept of the recorded rows (n_y numbers each) of a few runs; see ``rs_reduction`` of lanes.c.

    ends: the row behind each segment of rows. window: first row, and the one behind the last, of all that follows.
    orders: multiples of the angle, -1 for none; angle: columns of its cosine, its sine and itself. n_points: most of
    the rows where the angle passes whole turns. history: whether the rows of the window are kept.
    """

    n_y: int
    ends: np.ndarray
    window: tuple[int, int] = (0, 0)
    orders: int = -1
    angle: tuple[int, int, int] = (0, 0, 0)
    n_points: int = 0
    history: bool = False


@dataclass(eq=False)
class Reduced:
    """What was kept, of n runs: moments (segments, 4, n_y, n), least, largest, sum, sum of squares of each segment;
    sums (2, 2 orders + 1, n) of cosines and sines of multiples of the angle, products (2, orders + 1, n_y, n) of those
    with the columns; points (n, n_points, n_y) and how many were found (n,), more than n_points where these had no
    room; history (rows, n_y, n) or None; last recorded row (n_y, n); steepest (n,): what the angle goes at most between
    two rows of the window, where points are kept.
    """

    moments: np.ndarray
    sums: np.ndarray
    products: np.ndarray
    points: np.ndarray
    found: np.ndarray
    history: np.ndarray | None
    last: np.ndarray
    steepest: np.ndarray

    def part(self, runs: slice) -> Reduced:
        """Return some of the runs."""
        return Reduced(
            self.moments[..., runs],
            self.sums[..., runs],
            self.products[..., runs],
            self.points[runs],
            self.found[runs],
            None if self.history is None else self.history[..., runs],
            self.last[..., runs],
            self.steepest[runs],
        )

    @staticmethod
    def joined(parts: Sequence[Reduced]) -> Reduced:
        """Return the runs of several together."""
        names = [f.name for f in fields(Reduced) if f.name != "history" or parts[0].history is not None]
        axes = {name: 0 if name in ("points", "found") else -1 for name in names}
        together = {name: np.concatenate([getattr(part, name) for part in parts], axes[name]) for name in names}
        return Reduced(**{"history": None, **together})  # type: ignore[arg-type]


class _CReduction(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int64) for name in ("row", "n_segments", "segment")),
        *((name, ctypes.c_void_p) for name in ("end", "moments")),
        *((name, ctypes.c_int64) for name in ("first", "last", "n_orders", "cosine", "sine")),
        *((name, ctypes.c_void_p) for name in ("sums", "products")),
        *((name, ctypes.c_int64) for name in ("angle", "n_points")),
        *((name, ctypes.c_void_p) for name in ("points", "found", "recent", "history", "latest", "steepest")),
    ]


class LaneLibrary:
    """The C functions of an ensemble of ``width`` runs of one diagram (lanes.c); record: the columns of a row."""

    def __init__(self, model: Model, record: Sequence[ca.SX], compiler: Compiler, width: int) -> None:
        kernel = build_kernel(model.trace, record)
        self.model, self.width, self.n_y = model, width, kernel.sizes["RS_NY"]
        self.compiler = compiler.name
        source = emit_c(kernel, lanes=width)
        self.handle, self.cached = compile_c(source, compiler, "-O3" if kernel.unrolled else "-O2")
        i64, ptr = ctypes.c_int64, ctypes.c_void_p
        for name, arguments, result in (
            ("rs_size", [], i64),
            ("rs_prepare", [ptr, ptr], None),
            ("rs_start", [ptr, ptr, ptr], None),
            ("rs_run", [ptr, ptr, ptr, i64, i64, ptr, i64, ptr, ptr], i64),
            ("rs_end", [ptr, ptr, i64, ptr], None),
        ):
            function = getattr(self.handle, name, None)
            if function is None:
                raise compiler_error(compiler.command[0], f"wrote a library without {name}")
            function.argtypes, function.restype = arguments, result

    def array(self, *shape: int) -> np.ndarray:
        """Return zeros of a shape whose last part are the lanes, where vectors may lie."""
        size = math.prod(shape) * self.width
        room = np.zeros(size + ALIGNMENT // 8)
        skip = -room.ctypes.data % ALIGNMENT // 8
        return room[skip : skip + size].reshape(*shape, self.width)


class Lanes:
    """``width`` runs at work, from t = 0. p: parameters (width, n_p); steps: their lengths [s] (width,).

    x, z: their states, (n_x, width) and (n_z, width); failed: the steps by which they had left all bounds, else 0.
    """

    def __init__(self, library: LaneLibrary, p: np.ndarray, steps: np.ndarray, reduction: Reduction) -> None:
        self.library, self.reduction = library, reduction
        model, self._functions = library.model, library.handle
        self._each = np.ascontiguousarray(p, float)
        self._p, self._step = library.array(model.n_p), library.array()
        self._p[:], self._step[:] = self._each.T, steps
        self._memory = library.array(int(self._functions.rs_size()))
        self.x = self._memory[: model.n_x]
        self.z = self._memory[model.n_x : model.n_x + model.n_z]
        self.failed = np.zeros(library.width, np.int64)
        self._functions.rs_prepare(self._p.ctypes.data, self._memory.ctypes.data)
        self._kept, self.reduced = self._reduce(reduction)

    def start(self, x: np.ndarray, z: np.ndarray) -> None:
        """Begin with states x (width, n_x), z (width, n_z): sample hits due at t = 0."""
        self.x[:], self.z[:] = x.T, z.T
        self._functions.rs_start(self._p.ctypes.data, self._each.ctypes.data, self._memory.ctypes.data)

    def run(self, n0: int, n1: int, every: int) -> int:
        """Take steps n0..n1-1; a row is recorded at the start of every step divisible by ``every``.

        Return the step reached, less than n1 where all runs have failed.
        """
        addresses = [array.ctypes.data for array in (self._p, self._each, self._memory)]
        kept = ctypes.addressof(self._kept)
        return int(
            self._functions.rs_run(*addresses, n0, n1, self._step.ctypes.data, every, kept, self.failed.ctypes.data)
        )

    def end(self, with_row: bool) -> Reduced:
        """Record the row at the end of the run, where it has one, and return what was kept."""
        kept = ctypes.addressof(self._kept)
        self._functions.rs_end(self._p.ctypes.data, self._memory.ctypes.data, int(with_row), kept)
        return self.reduced

    def save(self) -> np.ndarray:
        """Return all states at this instant."""
        return self._memory.copy()

    def repeat(self, saved: np.ndarray, first: int, last: int, parts: int) -> np.ndarray:
        """Return the rows (n, n_y, width) of steps first..last-1 from saved states, with steps of a part of the length.

        The runs stand where they stood, and what was kept stays as it is.
        """
        now, failed, step = self._memory.copy(), self.failed.copy(), self._step.copy()
        kept, reduced = self._kept, self.reduced
        try:
            self._memory[:] = saved
            self._step /= parts
            self._kept, self.reduced = self._reduce(
                Reduction(self.library.n_y, np.zeros(0, int), (0, last - first), history=True)
            )
            self.run(first * parts, last * parts, parts)
            return np.asarray(self.reduced.history)
        finally:
            self._memory[:], self.failed[:], self._step[:] = now, failed, step
            self._kept, self.reduced = kept, reduced

    def _reduce(self, wanted: Reduction) -> tuple[_CReduction, Reduced]:
        """Return room for what is wanted of the rows to come."""
        array, n_y, width = self.library.array, wanted.n_y, self.library.width
        first, last = wanted.window
        moments = array(len(wanted.ends), 4, n_y)
        moments[:, 0], moments[:, 1] = np.inf, -np.inf
        out = Reduced(
            moments,
            array(2, 2 * wanted.orders + 1) if wanted.orders >= 0 else array(0),
            array(2, wanted.orders + 1, n_y) if wanted.orders >= 0 else array(0),
            np.zeros((width, wanted.n_points, n_y)),
            np.zeros(width, np.int64),
            array(last - first, n_y) if wanted.history else None,
            array(n_y),
            array(),
        )
        ends, recent = np.ascontiguousarray(wanted.ends, np.int64), array(4 * n_y + 2)
        kept = _CReduction()
        kept.n_segments, kept.end, kept.moments = len(ends), ends.ctypes.data, out.moments.ctypes.data
        kept.first, kept.last, kept.n_orders = first, last, wanted.orders
        kept.cosine, kept.sine, kept.angle = wanted.angle
        kept.sums, kept.products = out.sums.ctypes.data, out.products.ctypes.data
        kept.n_points, kept.points, kept.found = wanted.n_points, out.points.ctypes.data, out.found.ctypes.data
        kept.recent = recent.ctypes.data
        kept.room = ends, recent  # which nobody else holds
        kept.history = None if out.history is None else out.history.ctypes.data
        kept.latest, kept.steepest = out.last.ctypes.data, out.steepest.ctypes.data
        return kept, out
