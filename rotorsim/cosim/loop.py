"""An explicit co-simulation with a fixed communication step in one loop of C.

Members are compiled parts of a diagram, and instances of FMUs for Co-Simulation: in processes of their own, or in this
one where their inputs and outputs are all Float64. Inputs are held during a step: u = L y + u0.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from importlib.resources import files
from typing import Any, Protocol

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.runtime.exchange import Slave
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.process import LocalWorker, RemoteWorker
from rotorsim.fmi.runtime.steps import DEFINES, PART, PROCESS, Failed, Member, State
from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler
from rotorsim.model.instance import CompiledInstance

__all__ = ["FastLoop", "PartMember"]

_FIRST, _SLICE = 100, 0.1  # steps taken first; s between looks at Ctrl-C and progress


class PartMember(Protocol):
    """A compiled part as a member: its instance in C, its own step [s], the place of its inputs in z, its outputs."""

    name: str
    instance: Any
    internal: float
    n_z: int
    inputs: Sequence[str]
    outputs: Sequence[str]


class FastLoop:
    """Members, set up and coupled by L (n_u, n_y) and u0 (n_u,); `run` takes steps.

    order: of the members for Gauss-Seidel; None: Jacobi. sweeps: how often, at most, inputs and outputs are made to
    agree after a step. Raises RotorsimError where a member cannot take part, or
    there is no C compiler; `possible` asks before.
    """

    def __init__(
        self,
        members: Sequence[Slave | PartMember],
        L: np.ndarray,
        u0: np.ndarray,
        order: Sequence[int] | None = None,
        sweeps: int = 0,
    ) -> None:
        wrong = [f"{member.name} {why}" for member in members if (why := _unfit(member))]
        library = None if wrong else _library()
        if library is None:
            what = "; ".join(wrong) or "there is no C compiler that works"
            hint = "FMUs take part as Co-Simulation, in this process with Float64 alone; or leave out fast"
            raise RotorsimError(Problem(f"no fast loop: {what}", hint=hint))
        self.members = list(members)
        self._function, self._library = library.rs_cosimulate, str(library._name)
        self._keep: list[Any] = []
        self._rows: dict[int, np.ndarray] = {}
        self._made = (Member * len(members))(*map(self._member, members))
        self._slaves = [(m, made) for m, made in zip(members, self._made, strict=True) if isinstance(m, Slave)]
        sizes = [len(_inputs(member)) for member in members]
        self._first = np.cumsum([0, *sizes], dtype=np.int64)
        self._u = _pointers([at for member in members for at in _places(member, "u", self._rows)])
        self._y = _pointers([at for member in members for at in _places(member, "y", self._rows)])
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
    def possible(members: Sequence[Slave | PartMember]) -> bool:
        """Return whether there can be a fast loop over these members."""
        return not any(map(_unfit, members)) and _library() is not None

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
        if wrong := [f"{member.name} {why}" for member in self.members if (why := _unfit(member))]:
            raise RotorsimError(Problem(f"no fast loop: {'; '.join(wrong)}"))
        for slave, made in self._slaves:
            if isinstance(slave.worker, RemoteWorker):
                slave.wait(t0, slave.worker.expect)
            elif isinstance(slave.worker, LocalWorker) and slave.worker.session.steps:
                made.unbound = slave.worker.session.steps.unbound
        self._place[:] = 0
        rows = np.empty((steps // every, self.n_y))
        done = written = 0
        chunk, told = _FIRST, time.perf_counter()
        while done < steps:
            last = min(steps, done + max(chunk // every, 1) * every)
            begun = time.perf_counter()
            taken = self._call(t0, h, end, done, last, every, rows[written:])
            written = (done + taken) // every
            member, what = map(int, self._failed)
            t, now = (min(t0 + n * h, end) for n in (done + taken, done + taken + 1))
            try:
                if what:
                    self._go_on(member, what, now if self._place[0] else t, now)
                elif written and not np.isfinite(rows[written - 1]).all():
                    written -= 1
                    for slave, _ in self._slaves:
                        slave.finite_outputs(t0 + (done + taken - 1) * h)
                    return rows[: written + 1].copy()
            except FmuError:
                self.rows = rows[:written].copy()
                self._leave()
                raise
            done += taken
            if time.perf_counter() - begun < _SLICE:
                chunk *= 2
            if progress and time.perf_counter() - told > _SLICE:
                progress(done / steps)
                told = time.perf_counter()
        if progress:
            progress(1.0)
        return rows

    def _call(self, t0: float, h: float, end: float, first: int, last: int, every: int, rows: np.ndarray) -> int:
        """Take the steps first..last-1 in C; return how many were done."""
        apart = [(slave.worker, made) for slave, made in self._slaves if isinstance(slave.worker, RemoteWorker)]
        for worker, made in apart:
            made.count = worker.count
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
            for worker, made in apart:
                worker.count = made.count

    def _go_on(self, k: int, what: int, t: float, now: float) -> None:
        """Wait for a process that was asked at t; raise a failure, or an end at the time now, as participants do."""
        member = self.members[k]
        assert isinstance(member, Slave)
        worker, finish = member.worker, member.worker.finish
        if isinstance(worker, RemoteWorker):
            finish, self._made[k].state = partial(worker.finish, 0), State.DONE
        elif isinstance(worker, LocalWorker):
            finish = partial(worker.session.fail, what)
        try:
            member.wait(t, finish)
        except FmuError as failure:
            if failure.kind == "discard" and member.ended:
                end = failure.last if failure.last is not None else t
                raise member.step_failed("-", "asks for the end of the simulation", "ended", end) from None
            raise
        if member.ended:
            raise member.step_failed("-", "asks for the end of the simulation", "ended", now)

    def _leave(self) -> None:
        """Wait for processes that are at work still, so that others can ask them again."""
        for k, made in enumerate(self._made):
            if made.kind == PROCESS and made.state == State.ASKED:
                with contextlib.suppress(FmuError):
                    self._go_on(k, Failed.LATE, 0.0, 0.0)

    # -- filling the structures ----------------------------------------------------------------------------------------

    def _member(self, member: Slave | PartMember) -> Member:
        if isinstance(member, Slave):
            return self._process(member) if isinstance(member.worker, RemoteWorker) else self._fmu(member)
        instance: CompiledInstance = member.instance
        row = np.zeros(instance.n_y)
        self._rows[id(member)] = out = np.zeros(instance.n_y)
        self._keep += [row, out, instance, member]
        functions = instance.functions
        made = Member(kind=PART, step=member.internal)
        made.run, made.record = (ctypes.cast(f, ctypes.c_void_p) for f in (functions.rs_run, functions.rs_record))
        made.p, made.m, made.x, made.z = (_at(a) for a in (instance.p, instance.memory, instance.x, instance.z))
        made.y, made.row = _at(out), _at(row)
        return made

    def _process(self, slave: Slave) -> Member:
        worker = slave.worker
        assert isinstance(worker, RemoteWorker)
        if os.path.exists(self._library):  # a cache that cannot be written to keeps none
            slave.command("in_c", library=self._library)
        return Member(kind=PROCESS, head=worker.block.at(0), looks=worker.looks, bell=worker.pipe.sink)

    def _fmu(self, slave: Slave) -> Member:
        assert isinstance(slave.worker, LocalWorker)
        assert slave.worker.session.steps
        return slave.worker.session.steps.in_c()


def _unfit(member: Slave | PartMember) -> str:
    """Return why a member cannot take part, or ""."""
    if not isinstance(member, Slave):
        return "" if isinstance(member.instance, CompiledInstance) else "is not compiled"
    if member.kind != "cs" or not member.is_running:
        return "is not set up for Co-Simulation"
    worker = member.worker
    if isinstance(worker, RemoteWorker):
        return "" if worker.ordered else "has a process of its own, and this machine cannot look at it"
    assert isinstance(worker, LocalWorker)
    assert worker.session.steps
    return "" if worker.session.steps.all_float else "has inputs or outputs that are not Float64"


def _inputs(member: Slave | PartMember) -> Sequence[str]:
    return member.input_names if isinstance(member, Slave) else member.inputs


def _places(member: Slave | PartMember, which: str, rows: Mapping[int, np.ndarray]) -> list[int]:
    """Return the addresses of the inputs or outputs of a member."""
    if isinstance(member, Slave):
        block = member.worker.block
        first, count = (block.u, len(member.input_names)) if which == "u" else (block.y, len(member.output_names))
        return [block.at(first + k) for k in range(count)]
    if which == "u":
        return [_at(member.instance.z) + 8 * (member.n_z + k) for k in range(len(member.inputs))]
    return [_at(rows[id(member)]) + 8 * k for k in range(len(member.outputs))]


def _pointers(addresses: Sequence[int]) -> np.ndarray:
    return np.array(addresses, np.uint64)


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
    i64, f64, ptr = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
    library.rs_cosimulate.argtypes = [
        ptr,
        i64,
        ptr,
        i64,
        ptr,
        ptr,
        ptr,
        ptr,
        ptr,
        ptr,
        i64,
        ptr,
        f64,
        f64,
        f64,
        i64,
        i64,
        i64,
        i64,
        ptr,
        ptr,
        ptr,
    ]
    library.rs_cosimulate.restype = i64
    return library
