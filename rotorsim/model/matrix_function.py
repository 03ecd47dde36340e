"""Matrices of CasADi expressions evaluated at many points at once, in and out of NumPy's own memory."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.model.array_function import array_function
from rotorsim.model.called import connect, forget_failures, raise_failure, steady_arguments
from rotorsim.model.emit.program import Program
from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler
from rotorsim.model.emit.writer import Writer, array_leaf, call_table, called_functions

POINTS_AT_A_TIME = 4096  # points at a time: what is on the way fits into the cache of a processor
MANY_POINTS = 128  # NumPy takes 1 us for an operation at a few, the virtual machine 0.008 us at each
WORTH_PREPARING = 800  # points of such calls: to prepare an operation for NumPy takes 5 us
WORTH_COMPILING = 10_000  # calls of parts by the virtual machine, each by way of Python: as long as a compilation takes


class MatrixFunction:
    """A matrix expression evaluated at many points at once; only its nonzeros are computed.

    expression: or what returns it. It is compiled when it is first needed.
    """

    def __init__(self, arguments: Sequence[Any], expression: Any | Callable[[], Any]) -> None:
        self.arguments, self._given = list(arguments), expression
        self._sizes = [argument.numel() for argument in arguments]
        self._mapped: dict[tuple[int, tuple[int, ...]], Any] = {}
        self._calls = 0  # of parts whose equations are elsewhere, by the virtual machine
        self._points = 0  # of calls with many of them

    @cached_property
    def _expression(self) -> Any:
        return ca.sparsify(ca.SX(self._given() if callable(self._given) else self._given))

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = self._expression.sparsity().get_triplet()
        return np.array(rows, int), np.array(columns, int)

    @property
    def nonzeros(self) -> Any:
        """The entries that are not zero everywhere, as a column of expressions of the arguments."""
        return ca.vec(self._expression.nz[:]) if len(self.rows) else ca.SX(0, 1)  # those of a row are a row

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the matrix."""
        return tuple(self._expression.shape)

    @property
    def rows(self) -> np.ndarray:
        """Row of each entry that is not zero everywhere."""
        return self._places[0]

    @property
    def columns(self) -> np.ndarray:
        """Column of each entry that is not zero everywhere."""
        return self._places[1]

    @cached_property
    def _column(self) -> Any:
        """The nonzeros as an expression, without calls whose results nobody wants."""
        function = ca.Function("f", self.arguments, [self._expression.nz[:]])
        if not function.get_function():
            return self._expression.nz[:]
        program, names = Program(), [f"a{k}" for k in range(len(self.arguments))]
        nodes = program.load(function, names)[0]
        return program.to_casadi(nodes, dict(zip(names, self.arguments, strict=True)), {})

    @cached_property
    def _steady(self) -> _Steady | None:
        """What follows parameters alone by way of a part whose equations are elsewhere, if anything does."""
        places = steady_arguments(ca.Function("f", self.arguments, [self._column]))
        if not places or len(places) == len(self.arguments):
            return None
        followed = [self.arguments[k] for k in places]
        rest, symbols, values = ca.extract_parametric(self._column, ca.vertcat(*followed))
        return _Steady(places, ca.vertcat(*symbols), rest, MatrixFunction(followed, ca.densify(ca.vertcat(*values))))

    @cached_property
    def _function(self) -> Any:
        if self._steady is None:
            return ca.Function("f", self.arguments, [self._column])
        return ca.Function("f", [*self.arguments, self._steady.symbols], [self._steady.rest])

    def __call__(self, *columns: Any) -> np.ndarray:
        """Return values, shape (n, rows, columns); each argument is a column or n columns side by side."""
        found = self.entries(*columns)
        out = np.zeros((len(found), *self.shape))
        out[:, self.rows, self.columns] = found
        return out

    def entries(self, *columns: Any) -> np.ndarray:
        """Return the entries that are not zero everywhere, (n, nnz), see ``rows`` and ``columns``."""
        n = max((np.shape(c)[1] for c in columns if np.ndim(c) == 2), default=1)
        return self._nonzeros(n, columns) if len(self.rows) else np.zeros((n, 0))

    def _nonzeros(self, n: int, columns: tuple[Any, ...]) -> np.ndarray:
        """Return the nonzeros, (n, nnz); CasADi reads and writes the arrays' own memory, which lie column by column."""
        self._points += n if n >= MANY_POINTS else 0
        if n >= MANY_POINTS and self._points > WORTH_PREPARING and self._by_arrays is not None:
            return self._at_arrays(n, columns)
        given = [np.ascontiguousarray(np.transpose(c), float).reshape(-1, k) for c, k in self._paired(columns)]
        if self._steady is not None:
            given.append(self._steady.at(given))
        fixed = tuple(k for k, array in enumerate(given) if len(array) != n)
        self._calls += n * self._called
        if self._calls > WORTH_COMPILING and self._compiled is not None:
            return self._by_c(n, given)
        key = (n, fixed)
        if key not in self._mapped:
            mapped = self._function if n == 1 else self._function.map(f"f{n}", "serial", n, list(fixed), [])
            self._mapped = {**self._mapped, key: mapped} if len(self._mapped) < 16 else {key: mapped}
        result = np.empty((n, len(self.rows)))
        buffer, trigger = self._mapped[key].buffer()
        for k, array in enumerate(given):
            if array.size:
                buffer.set_arg(k, _memory(array))
        buffer.set_res(0, _memory(result))
        forget_failures()
        trigger()
        raise_failure()
        return result

    @cached_property
    def _by_arrays(self) -> Any:
        """The function by NumPy, None where it is not to be had."""
        return None if self._steady is not None or self._called else array_function(self._function)

    def _at_arrays(self, n: int, columns: tuple[Any, ...]) -> np.ndarray:
        """Return the nonzeros, (n, nnz), of arguments that are a column, or n columns side by side."""
        given = [np.asarray(column, float) for column in columns]
        out = np.empty((len(self.rows), n))
        with np.errstate(all="ignore"):
            for first in range(0, n, POINTS_AT_A_TIME):
                some = slice(first, first + POINTS_AT_A_TIME)
                parts = [array[:, some] if array.shape[1:] == (n,) else array.ravel() for array in given]
                self._by_arrays(*parts, out=out[:, some])
        return out.T

    @cached_property
    def _called(self) -> int:
        """How many parts whose equations are elsewhere one evaluation calls."""
        function = self._function
        if not function.get_function():
            return 0
        return sum(function.instruction_id(k) == ca.OP_CALL for k in range(function.n_instructions()))

    @cached_property
    def _compiled(self) -> Any:
        """The function in C, which calls these parts without Python; None without a compiler that works."""
        compiler = find_compiler()
        if compiler is None:
            return None
        program, names = Program(), [f"a{k}" for k in range(self._function.n_in())]
        nodes = program.load(self._function, names)[0]
        called = called_functions([program])
        table, connecting = call_table(called)
        arguments = ", ".join([*(f"const double *{name}" for name in names), "double *out", "double *work"])
        targets = [(f"out[{k}]", node) for k, node in enumerate(nodes)]
        text, work = Writer(program, {}, array_leaf, [*called]).text(
            "rs_f", arguments, ", ".join([*names, "out", "work"]), targets
        )
        at = ", ".join(f"a[{k}] + i * step[{k}]" for k in range(len(names)))
        source = f"""#include <math.h>
#include <stdint.h>
#include <string.h>
#if defined(_WIN32)
#define RS_EXPORT __declspec(dllexport)
#else
#define RS_EXPORT __attribute__((visibility("default")))
#endif
{table}
{text}
RS_EXPORT void rs_map(int64_t n, const double *const *a, const int64_t *step, double *out) {{
  double work[{work + 1}];
  for (int64_t i = 0; i < n; i++) rs_f({at}, out + i * {len(nodes)}, work);
}}
{connecting}"""
        try:
            library, _ = compile_c(source, compiler, "-O1")
        except CompilerError:
            return None
        connect(library, called)
        library.rs_map.argtypes = [ctypes.c_int64, *[ctypes.c_void_p] * 3]
        library.rs_map.restype = None
        return library

    def _by_c(self, n: int, given: Sequence[np.ndarray]) -> np.ndarray:
        """Return the nonzeros, (n, nnz); arguments of one row are the same at all points."""
        result = np.empty((n, len(self.rows)))
        addresses = np.array([array.ctypes.data for array in given], np.uintp)
        steps = np.array([array.shape[1] if len(array) == n else 0 for array in given], np.int64)
        forget_failures()
        self._compiled.rs_map(n, addresses.ctypes.data, steps.ctypes.data, result.ctypes.data)
        raise_failure()
        return result

    def _paired(self, columns: tuple[Any, ...]) -> list[tuple[Any, int]]:
        return [(column, max(size, 1)) for column, size in zip(columns, self._sizes, strict=True)]


@dataclass(frozen=True, eq=False)
class _Steady:
    """What an expression takes of some of its arguments alone: symbols for it, the rest, and what gives it."""

    places: tuple[int, ...]  # of these arguments
    symbols: Any
    rest: Any
    values: MatrixFunction

    def at(self, given: Sequence[np.ndarray]) -> np.ndarray:
        """Return the values for arguments of (n or 1, size), (n or 1, size); computed once for those that are equal."""
        own = [given[k] for k in self.places]
        n = max(map(len, own))
        rows = np.concatenate([np.broadcast_to(array, (n, array.shape[1])) for array in own], axis=1)
        first = np.flatnonzero(np.r_[True, (rows[1:] != rows[:-1]).any(axis=1)])  # runs follow one another
        found = self.values(*(array[first if len(array) > 1 else [0]].T for array in own))[:, :, 0]
        return np.repeat(found, np.diff(np.r_[first, n]), axis=0) if len(first) < n else found


def _memory(array: Any) -> Any:
    return memoryview(array)
