"""An explicit co-simulation with a fixed communication step in one loop of C.

Members are compiled parts of a diagram, and instances of FMUs for Co-Simulation: in processes of their own, or in this
one where their inputs and outputs are all Float64. Inputs are held during a step: u = L y + u0.
"""

from __future__ import annotations

import contextlib
import ctypes
import time
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Protocol

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.steps import DEFINES, PART, PROCESS, Failed, Member, State
from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler
from rotorsim.model.instance import CompiledInstance

_FIRST, _SLICE = 100, 0.1  # steps taken first; s between looks at Ctrl-C and progress


class LoopMember(Protocol):
    """Who takes part in the loop: an instance of an FMU (`Slave`), or a compiled part."""

    name: str

    def why_not_in_c(self) -> str:
        """Return why it cannot take part now, or ""."""

    def in_c(self, library: str) -> Member:
        """Return its structure for loop.c, whose library is at a path."""

    def addresses(self) -> tuple[list[int], list[int]]:
        """Return the addresses of its inputs and of its outputs."""

    def enter_c(self, member: Member, t: float) -> None:
        """Get ready for steps from t on. Raises FmuError."""

    def leave_c(self, member: Member) -> None:
        """Take over from the loop when it returns."""

    def finish_in_c(self, member: Member, what: int, t: float, end: float) -> None:
        """Do what the loop left to be done in a step from t to an end. Raises FmuError."""

    def finite_outputs(self, t: float) -> np.ndarray:
        """Return the outputs (n_y,) of a step from t. Raises FmuError where an FMU gives some that are not finite."""


class PartMember:
    """A compiled part as a member; step: its own [s]. Its n_u inputs lie behind the first n_z of its instance's z."""

    def __init__(self, name: str, instance: CompiledInstance | None, step: float, n_z: int, n_u: int, n_y: int) -> None:
        self.name, self.instance, self.step, self.n_z, self.n_u = name, instance, step, n_z, n_u
        self._row = np.zeros(0 if instance is None else instance.n_y)
        self._y = np.zeros_like(self._row)
        self.n_y = n_y

    def why_not_in_c(self) -> str:
        return "is not compiled" if self.instance is None else ""

    def in_c(self, library: str) -> Member:
        assert self.instance is not None
        own, made = self.instance, Member(kind=PART, step=self.step)
        made.run, made.record = (
            ctypes.cast(f, ctypes.c_void_p) for f in (own.functions.rs_run, own.functions.rs_record)
        )
        made.p, made.m, made.x, made.z = map(_at, (own.p, own.memory, own.x, own.z))
        made.y, made.row = _at(self._y), _at(self._row)
        return made

    def addresses(self) -> tuple[list[int], list[int]]:
        assert self.instance is not None
        first = _at(self.instance.z) + 8 * self.n_z
        return [first + 8 * k for k in range(self.n_u)], [_at(self._y) + 8 * k for k in range(self.n_y)]

    def enter_c(self, member: Member, t: float) -> None:
        """It is ready."""

    def leave_c(self, member: Member) -> None:
        """Nothing is to be taken over."""

    def finish_in_c(self, member: Member, what: int, t: float, end: float) -> None:
        """It never leaves anything."""

    def finite_outputs(self, t: float) -> np.ndarray:
        return self._y[: self.n_y].copy()


class FastLoop:
    """Members, set up and coupled by L (n_u, n_y) and u0 (n_u,); `run` takes steps.

    order: of the members for Gauss-Seidel; None: Jacobi. sweeps: how often, at most, inputs and outputs are made to
    agree after a step. Raises RotorsimError where a member cannot take part, or
    there is no C compiler; `possible` asks before.
    """

    def __init__(
        self,
        members: Sequence[LoopMember],
        L: np.ndarray,
        u0: np.ndarray,
        order: Sequence[int] | None = None,
        sweeps: int = 0,
    ) -> None:
        self.members = list(members)
        self._refuse_unfit()
        library = _library()
        if library is None:
            raise _refused("there is no C compiler that works")
        self._function = library.rs_cosimulate
        self._made = (Member * len(members))(*(member.in_c(str(library._name)) for member in members))
        places = [member.addresses() for member in members]
        self._first = np.cumsum([0, *(len(inputs) for inputs, _ in places)], dtype=np.int64)
        self._u, self._y = (np.array([at for own in places for at in own[k]], np.uint64) for k in (0, 1))
        self.n_y = len(self._y)
        if L.shape != (len(self._u), self.n_y):
            raise RotorsimError(Problem(f"L has the shape {L.shape}, not {(len(self._u), self.n_y)}"))
        rows, self._column = (part.astype(np.int64) for part in np.nonzero(L))
        self._gain = np.ascontiguousarray(L[rows, self._column], float)
        self._start = np.searchsorted(rows, np.arange(len(self._u) + 1)).astype(np.int64)
        self._u0 = np.ascontiguousarray(u0, float)
        self._order = np.array(range(len(members)) if order is None else order, np.int64)
        self._sequential, self._sweeps = int(order is not None), sweeps
        self._failed, self._place = np.zeros(2, np.int64), np.zeros(2, np.int64)
        self.rows = np.empty((0, self.n_y))  # what was computed until a failure

    def begin(self, y: np.ndarray) -> None:
        """Say what the outputs y (n_y,) are at the start: the first step takes its inputs from them."""
        for at, value in zip(self._y.tolist(), y.tolist(), strict=True):
            ctypes.c_double.from_address(at).value = value

    @staticmethod
    def possible(members: Sequence[LoopMember]) -> bool:
        """Return whether there can be a fast loop over these members."""
        return not any(member.why_not_in_c() for member in members) and _library() is not None

    def _refuse_unfit(self) -> None:
        wrong = [f"{member.name} {why}" for member in self.members if (why := member.why_not_in_c())]
        if wrong:
            raise _refused("; ".join(wrong))

    def run(
        self,
        t0: float,
        h: float,
        steps: int,
        *,
        every: int = 1,
        end: float = np.inf,
        progress: Callable[[float], None] | None = None,
    ) -> np.ndarray:
        """Take steps of length h from t0 on, to ``end`` at most; return y (rows, n_y) after each that every divides.

        The outputs of the members must be up to date (`exchange` without a step, `output`). The rows end early where
        one is not finite; that row is the last. Raises FmuError with the time when an FMU fails, or its outputs are not
        finite.
        """
        self._refuse_unfit()
        for member, made in zip(self.members, self._made, strict=True):
            member.enter_c(made, t0)
        self._place[:] = 0
        rows = np.empty((steps // every, self.n_y))
        done = written = 0
        chunk, shown = _FIRST, time.perf_counter()
        while done < steps:
            last = min(steps, done + max(chunk // every, 1) * every)
            begun = time.perf_counter()
            taken = self._call(t0, h, end, done, last, every, rows[written:])
            written = (done + taken) // every
            t, now = (min(t0 + n * h, end) for n in (done + taken, done + taken + 1))
            try:
                k, what = map(int, self._failed)
                if what:
                    self._finish(k, what, now if self._place[0] else t, now)
                elif written and not np.isfinite(rows[written - 1]).all():
                    written -= 1
                    for member in self.members:
                        member.finite_outputs(t0 + (done + taken - 1) * h)
                    return rows[: written + 1].copy()
            except FmuError:
                self.rows = rows[:written].copy()
                self._leave()
                raise
            done += taken
            if time.perf_counter() - begun < _SLICE:
                chunk *= 2
            if progress and time.perf_counter() - shown > _SLICE:
                progress(done / steps)
                shown = time.perf_counter()
        if progress:
            progress(1.0)
        return rows

    def _call(self, t0: float, h: float, end: float, first: int, last: int, every: int, rows: np.ndarray) -> int:
        """Take the steps first..last-1 in C; return how many were done."""
        try:
            return int(
                self._function(
                    ctypes.addressof(self._made),
                    len(self.members),
                    _at(self._order),
                    self._sequential,
                    *map(_at, (self._first, self._start, self._column, self._gain, self._u0, self._u)),
                    self.n_y,
                    _at(self._y),
                    t0,
                    h,
                    end,
                    first,
                    last,
                    every,
                    self._sweeps,
                    _at(rows),
                    _at(self._failed),
                    _at(self._place),
                )
            )
        finally:  # Ctrl-C in C is raised when it returns
            for member, made in zip(self.members, self._made, strict=True):
                member.leave_c(made)

    def _finish(self, k: int, what: int, t: float, end: float) -> None:
        self.members[k].finish_in_c(self._made[k], what, t, end)

    def _leave(self) -> None:
        """Wait for processes that are at work still, so that others can ask them again."""
        for k, made in enumerate(self._made):
            if made.kind == PROCESS and made.state == State.ASKED:
                with contextlib.suppress(FmuError):
                    self._finish(k, Failed.LATE, 0.0, 0.0)


def _refused(what: str) -> RotorsimError:
    hint = "FMUs take part as Co-Simulation, in this process with Float64 alone; or leave out fast"
    return RotorsimError(Problem(f"no fast loop: {what}", hint=hint))


def _at(array: np.ndarray) -> int:
    return int(array.ctypes.data)


@cache
def _library() -> Any:
    """Return the library of the loop, or None without a compiler that works."""
    compiler = find_compiler()
    if compiler is None:
        return None
    source = DEFINES + files("rotorsim.cosim").joinpath("loop.c").read_text(encoding="utf-8")
    try:
        library, _ = compile_c(source, compiler)
    except CompilerError as failure:
        failure.warn("the parts are coupled without the fast loop")
        return None
    types: dict[str, Any] = {"p": ctypes.c_void_p, "i": ctypes.c_int64, "d": ctypes.c_double}
    library.rs_cosimulate.argtypes = [types[letter] for letter in "pipippppppipdddiiiippp"]
    library.rs_cosimulate.restype = ctypes.c_int64
    return library
