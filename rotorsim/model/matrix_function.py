"""Matrices of CasADi expressions evaluated at many points at once, in and out of NumPy's own memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.model.called import forget_failures, raise_failure


class MatrixFunction:
    """A matrix expression evaluated at many points at once; only its nonzeros are computed.

    expression: or what returns it. It is compiled when it is first needed.
    """

    def __init__(self, arguments: Sequence[Any], expression: Any | Callable[[], Any]) -> None:
        self._arguments, self._given = list(arguments), expression
        self._sizes = [argument.numel() for argument in arguments]
        self._mapped: dict[tuple[int, tuple[int, ...]], Any] = {}

    @cached_property
    def _expression(self) -> Any:
        return ca.sparsify(ca.SX(self._given() if callable(self._given) else self._given))

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = self._expression.sparsity().get_triplet()
        return np.array(rows, int), np.array(columns, int)

    @property
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
    def _function(self) -> Any:
        return ca.Function("f", self._arguments, [self._expression.nz[:]])

    def __call__(self, *columns: Any) -> np.ndarray:
        """Return values, shape (n, rows, columns); each argument is a column or n columns side by side."""
        n = max((np.shape(c)[1] for c in columns if np.ndim(c) == 2), default=1)
        out = np.zeros((n, *self.shape))
        if len(self.rows):
            out[:, self.rows, self.columns] = self._nonzeros(n, columns)
        return out

    def _nonzeros(self, n: int, columns: tuple[Any, ...]) -> np.ndarray:
        """Return the nonzeros, (n, nnz); CasADi reads and writes the arrays' own memory, which lie column by column."""
        given = [np.ascontiguousarray(np.transpose(c), float).reshape(-1, k) for c, k in self._paired(columns)]
        fixed = tuple(k for k, array in enumerate(given) if len(array) != n)
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

    def _paired(self, columns: tuple[Any, ...]) -> list[tuple[Any, int]]:
        return [(column, max(size, 1)) for column, size in zip(columns, self._sizes, strict=True)]


def _memory(array: Any) -> Any:
    return memoryview(array)
