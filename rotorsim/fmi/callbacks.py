"""Functions of an FMU for CasADi: numbers go in and come out, and derivatives are further functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.fmi.compiled import InC
from rotorsim.fmi.equations import FmuEquations
from rotorsim.fmi.slopes import Slopes
from rotorsim.model.called import CALLED_AT, STEADY, has_failed, note_failure, register


class _Function(ca.Callback):
    """A function of t, x, u, p, and what follows them, for CasADi, on buffers of numbers.

    A failure cannot pass through: it is kept (`note_failure`), and the results are not numbers.
    """

    def __init__(self, name: str, arguments: Sequence[int], results: Sequence[tuple[int, int]], **options: Any) -> None:
        """arguments: sizes of columns; results: shapes."""
        ca.Callback.__init__(self)
        self.arguments, self.results = tuple(arguments), tuple(results)
        self.steady = STEADY in name
        self._last: tuple[bytes, Sequence[np.ndarray]] | None = None
        self.native: Callable[[], None] | None = None
        self._parts: Sequence[np.ndarray] = ()
        self._found: Sequence[np.ndarray] = ()
        self.construct(name, options)

    def get_n_in(self) -> int:
        return len(self.arguments)

    def get_n_out(self) -> int:
        return len(self.results)

    def get_sparsity_in(self, k: int) -> Any:
        return ca.Sparsity.dense(self.arguments[k], 1)

    def get_sparsity_out(self, k: int) -> Any:
        return ca.Sparsity.dense(*self.results[k])

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, given: Sequence[Any], out: Sequence[Any]) -> int:
        if self.native is not None:
            for part, one in zip(self._parts, given, strict=True):
                part[:] = np.frombuffer(one) if part.size else _NOTHING
            self.native()
            for own, target in zip(self._found, out, strict=True):
                if own.size and target is not None:
                    np.frombuffer(target)[:] = own
            return 0
        arguments = [np.frombuffer(one) if size else _NOTHING for one, size in zip(given, self.arguments, strict=True)]
        for target, value, (rows, columns) in zip(out, self.sound(arguments), self.results, strict=True):
            if rows * columns and target is not None:
                np.frombuffer(target)[:] = np.ravel(value, order="F")
        return 0

    def sound(self, arguments: Sequence[np.ndarray]) -> Sequence[np.ndarray]:
        """Return the results at arguments; what is not a number where something has failed."""
        try:
            if has_failed():
                pass
            elif not self.steady:
                return self.evaluate(*arguments)
            else:
                key = b"".join(map(bytes, arguments))
                if self._last is None or self._last[0] != key:
                    self._last = key, self.evaluate(*arguments)
                return self._last[1]
        except BaseException as error:  # nothing may pass through CasADi, Ctrl-C neither
            note_failure(error)
        return [np.full(shape, np.nan) for shape in self.results]

    def call_from_c(
        self, native: InC, rows: Sequence[int], groups: tuple[Sequence[bool], Sequence[bool]], what: str
    ) -> None:
        """Let C answer for this function, whose results are columns, and this function where C cannot.

        groups: which of t, x, u, p are arguments, and which of the sums by them are results.
        """
        n_in, n_out = sum(self.arguments), sum(rows for rows, _ in self.results)

        def slow(_: Any, arguments: Any, results: Any) -> None:
            flat = np.ctypeslib.as_array(arguments, (max(n_in, 1),))[:n_in]
            try:
                found = np.concatenate([np.ravel(one) for one in self.sound(np.split(flat, ends))])
            except BaseException as error:  # nothing may pass through C
                note_failure(error)
                found = np.full(n_out, np.nan)
            np.ctypeslib.as_array(results, (max(n_out, 1),))[:n_out] = found

        ends = np.cumsum(self.arguments)[:-1]
        function, context, keep = native.function(rows, *groups, slow, what)
        register(self.name(), function, context, keep)
        given, found = np.zeros(max(n_in, 1)), np.zeros(max(n_out, 1))
        self._parts = np.split(given[:n_in], ends)
        self._found = np.split(found[:n_out], np.cumsum([rows for rows, _ in self.results])[:-1])
        self.native = partial(CALLED_AT(function), context, given.ctypes.data, found.ctypes.data)
        self._keep = keep, given, found

    def evaluate(self, *arguments: np.ndarray) -> Sequence[np.ndarray]:
        """Return the results at arguments."""
        raise NotImplementedError


_NOTHING = np.zeros(0)
ALL = (True, True, True, True)
_SUMS = {  # by t, x, u, p
    "time": (True, False, False, False),
    "states": (False, True, True, False),
    "parameters": (False, False, False, True),
}


class Called(_Function):
    """Some of x' and y of an FMU, or where it begins.

    rows: of x' and y, None: the states at the start. groups: whether t, x, u and p are arguments.
    """

    def __init__(self, name: str, equations: FmuEquations, rows: Sequence[int] | None, groups: Sequence[bool]) -> None:
        self.equations, self.rows, self.groups = equations, None if rows is None else list(rows), tuple(groups)
        self.sizes = (1, equations.n_x, equations.n_u, equations.n_p)
        self.size = self.size_of(equations) if rows is None else len(rows)
        self._derivatives: list[Any] = []  # CasADi does not hold them
        self._point: tuple[bytes, np.ndarray] = (b"", _NOTHING)
        own = [size if one else 0 for size, one in zip(self.sizes, groups, strict=True)]
        super().__init__(name, own, [(self.size, 1)], never_inline=True)

    @staticmethod
    def size_of(equations: FmuEquations) -> int:
        """Return how many numbers it gives where they are not rows of x' and y."""
        return equations.n_x

    def whole(self, arguments: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return t, x, u, p; for what is no argument zeros, inputs with which the FMU begins."""
        missing = [np.zeros(self.sizes[0]), np.zeros(self.sizes[1]), self.equations.idle, np.zeros(self.sizes[3])]
        return [one if given else idle for one, idle, given in zip(arguments, missing, self.groups, strict=True)]

    def moves(self, seeds: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return how t, x, u, p move; what is no argument does not."""
        pairs = zip(seeds, self.sizes, self.groups, strict=True)
        return [one if given else np.zeros(size) for one, size, given in pairs]

    def evaluate(self, *arguments: np.ndarray) -> Sequence[np.ndarray]:
        t, x, u, p = self.whole(arguments)
        found = self._values(float(t[0]), x, u, p)
        self.equations.prefer(p)
        return [found]

    def _values(self, t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        n_x = self.equations.n_x
        if self.rows is None:
            return self.equations.start(u, p)
        if max(self.rows) < n_x:
            return self.equations.rates(t, x, u, p)[self.rows]
        if min(self.rows) >= n_x:
            return self.equations.values(t, x, u, p)[[k - n_x for k in self.rows]]
        return self.equations.both(t, x, u, p)[self.rows]

    def has_forward(self, directions: int) -> bool:
        return directions == 1

    def get_forward(self, _: int, name: str, _in: Any, _out: Any, _options: Any) -> Any:
        if self.steady:
            return self._products(name, self.arguments, lambda J, seeds: [J @ seeds[3]])
        made = _Forward(name, self)
        self._derivatives.append(made)
        self.answer_in_c(made, "forward")
        return made

    def answer_in_c(self, function: _Function, what: str, wanted: Sequence[bool] = ALL) -> None:
        """Let C answer for a function of these rows, where it can. wanted: sums by t, x, u, p."""
        native, row_of = self.equations.native, self.equations.native_row
        if native is not None and self.rows and all(k in row_of for k in self.rows):
            function.call_from_c(native, [row_of[k] for k in self.rows], (self.groups, wanted), what)

    def has_reverse(self, directions: int) -> bool:
        return directions == 1

    def get_reverse(self, _: int, name: str, _in: Any, _out: Any, _options: Any) -> Any:
        """Return the weighted sums of derivatives by all arguments.

        Those by time, by states and inputs, and by parameters are functions of their own, of which an expression calls
        those whose results it uses: differences by parameters are dear.
        """
        if self.steady:
            none = [ca.SX(0, 1)] * 3
            return self._products(name, [self.size], lambda J, seeds: [*none, J.T @ seeds[0]])
        given = [ca.SX.sym(f"a{k}", size) for k, size in enumerate([*self.arguments, self.size, self.size])]
        sums = [ca.SX(size, 1) for size in self.arguments]
        for what, wanted in _SUMS.items():
            places = [k for k in range(4) if wanted[k] and self.groups[k]]
            if not any(self.arguments[k] for k in places):
                continue
            made = _Reverse(f"{name}_{what}", self, wanted)
            self._derivatives.append(made)
            self.answer_in_c(made, "reverse", wanted)
            for k, one in zip(places, made.call(given), strict=True):
                sums[k] = one
        return ca.Function(name, given, sums)

    def _products(self, name: str, sizes: Sequence[int], product: Callable[[Any, Sequence[Any]], list[Any]]) -> Any:
        """Return a function of the point, the results and seeds of some sizes: products of derivatives by p with these.

        The derivatives are those of parameters alone, as the function is: found once for many seeds, and for each
        parameter by a call of its own, of which those remain whose results somebody wants.
        """
        given = [ca.SX.sym(f"a{k}", size) for k, size in enumerate([*self.arguments, self.size, *sizes])]
        columns = [_ByParameter(f"{self.name()}_by_{k}", self, k) for k in range(self.sizes[3])]
        self._derivatives += columns
        J = ca.horzcat(ca.SX(self.size, 0), *(column(given[3]) for column in columns))
        return ca.Function(name, given, product(J, given[5:]))

    def along(self, point: Sequence[np.ndarray], seeds: Sequence[np.ndarray]) -> np.ndarray:
        """Return the derivative in a direction of t, x, u, p; what does not move costs nothing."""
        moves = [bool(seed.any()) for seed in seeds]
        moves[0] = moves[0] and self.equations.timed
        if not any(moves):
            return np.zeros(self.size)
        if not (moves[0] or moves[3]):
            J = self.jacobian_at(point, (False, True, True, False))
            self.equations.prefer(point[3])
            return np.asarray(J @ np.concatenate(seeds))
        return self.equations.difference(self._values, point, seeds)

    def jacobian_at(self, point: Sequence[np.ndarray], wanted: Sequence[bool]) -> np.ndarray:
        """Return the derivatives by t, x, u and p; those of the last point once more, where it is asked for again."""
        key = np.concatenate([*point, np.array(wanted, float)]).tobytes()
        if self._point[0] != key:
            self._point = key, self._jacobian(point, wanted)
        return self._point[1]

    def _jacobian(self, point: Sequence[np.ndarray], wanted: Sequence[bool]) -> np.ndarray:
        if self.rows is not None:
            t, x, u, p = point
            return self.equations.jacobian(float(t[0]), x, u, p, wanted)[self.rows]
        columns = np.eye(sum(self.sizes))
        ends = np.cumsum(self.sizes)[:-1]
        J = np.zeros((self.size, len(columns)))
        for k in range(self.sizes[0] + self.sizes[1], len(columns)):
            J[:, k] = self.equations.difference(self._values, point, np.split(columns[k], ends))
        return J


class CalledSlopes(Called):
    """The factors of states and inputs in the rows of x' and y of a linear FMU, row by row, as a function of p."""

    def __init__(self, name: str, equations: FmuEquations, rows: Sequence[int] | None, groups: Sequence[bool]) -> None:
        self.slopes = Slopes(equations)
        super().__init__(name, equations, rows, groups)

    @staticmethod
    def size_of(equations: FmuEquations) -> int:
        return (equations.n_x + equations.n_y) * (equations.n_x + equations.n_u)

    def _values(self, t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        return self.slopes.at(p).ravel()


class _ByParameter(_Function):
    """The derivatives by one entry of p of a function of p alone; derivatives of it are central differences."""

    def __init__(self, name: str, of: Called, k: int) -> None:
        self.of, self.k = of, k
        options = {"enable_fd": True, "fd_method": "central", "never_inline": True}
        super().__init__(name, of.arguments[3:], [(of.size, 1)], **options)

    def evaluate(self, *arguments: np.ndarray) -> Sequence[np.ndarray]:
        nothing, seed = [_NOTHING] * 3, np.eye(self.of.sizes[3])[self.k]
        return [self.of.along(self.of.whole([*nothing, *arguments]), self.of.moves([*nothing, seed]))]


class _Forward(_Function):
    """The derivative of a function of an FMU in a direction; derivatives of it are central differences."""

    def __init__(self, name: str, of: Called) -> None:
        self.of = of
        sizes = [*of.arguments, of.size, *of.arguments]
        super().__init__(name, sizes, [(of.size, 1)], enable_fd=True, fd_method="central", never_inline=True)

    def evaluate(self, *arguments: np.ndarray) -> Sequence[np.ndarray]:
        return [self.of.along(self.of.whole(arguments[:4]), self.of.moves(arguments[5:]))]


class _Reverse(_Function):
    """Weighted sums of the derivatives of a function of an FMU by those of its arguments that are wanted."""

    def __init__(self, name: str, of: Called, wanted: Sequence[bool]) -> None:
        self.of = of
        self.wanted = [given and one for given, one in zip(of.groups, wanted, strict=True)]
        shapes = [(size, 1) for size, one in zip(of.sizes, self.wanted, strict=True) if one]
        options = {"enable_fd": True, "fd_method": "central", "never_inline": True}
        super().__init__(name, [*of.arguments, of.size, of.size], shapes, **options)

    def evaluate(self, *arguments: np.ndarray) -> Sequence[np.ndarray]:
        point = self.of.whole(arguments[:4])
        sums = self.of.jacobian_at(point, self.wanted).T @ arguments[5]
        self.of.equations.prefer(point[3])
        parts = np.split(sums, np.cumsum(self.of.sizes)[:-1])
        return [part for part, one in zip(parts, self.wanted, strict=True) if one]
