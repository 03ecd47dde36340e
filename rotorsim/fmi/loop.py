"""An explicit co-simulation with a fixed communication step in one loop of C, for members in this process.

Members are instances of FMUs for Co-Simulation whose inputs and outputs are all Float64, and compiled parts of a
diagram. Inputs are held during a step: u = L y + u0.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Protocol

import numpy as np

from rotorsim.compile.instance import CompiledInstance
from rotorsim.compile.toolchain import CompilerError, compile_c, find_compiler
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.binding import STATUS
from rotorsim.fmi.calls import Call
from rotorsim.fmi.exchange import Slave
from rotorsim.fmi.process import LocalWorker

__all__ = ["FastLoop", "PartMember"]

_FIRST, _SLICE = 100, 0.1  # steps taken first; s between looks at Ctrl-C and progress
_WHAT = {1: "Set", 2: "DoStep", 3: "Get"}


class PartMember(Protocol):
    """A compiled part as a member: its instance in C, its own step [s], the place of its inputs in z, its outputs."""

    name: str
    instance: Any
    internal: float
    n_z: int
    inputs: Sequence[str]
    outputs: Sequence[str]


class _Call(ctypes.Structure):
    _fields_ = [
        ("function", ctypes.c_void_p), ("references", ctypes.c_void_p), ("n_references", ctypes.c_size_t),
        ("values", ctypes.c_void_p), ("n", ctypes.c_size_t),
    ]  # fmt: skip


class _Member(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int64) for name in ("kind", "n_set", "n_get", "unbound")),
        *((name, ctypes.c_void_p) for name in (
            "instance", "do_step", "set", "get", "run", "record", "p", "m", "x", "z", "y", "row",
        )),
        ("step", ctypes.c_double), ("last", ctypes.c_double), ("warned", ctypes.c_int64),
    ]  # fmt: skip


class FastLoop:
    """Members, set up and coupled by L (n_u, n_y) and u0 (n_u,); `run` takes steps.

    order: of the members for Gauss-Seidel; None: Jacobi. sweeps: how often, at most, inputs and outputs are made to
    agree after a step. Raises RotorsimError where a member cannot take part, or
    there is no C compiler; `possible` asks before.
    """

    def __init__(
        self, members: Sequence[Slave | PartMember], L: np.ndarray, u0: np.ndarray, order: Sequence[int] | None = None,
        sweeps: int = 0,
    ) -> None:  # fmt: skip
        wrong = [f"{member.name} {why}" for member in members if (why := _unfit(member))]
        library = None if wrong else _library()
        if library is None:
            what = "; ".join(wrong) or "there is no C compiler that works"
            hint = 'FMUs take part with "in_process": true, as Co-Simulation; or leave out fast'
            raise RotorsimError(Problem(f"no fast loop: {what}", hint=hint))
        self.members = list(members)
        self._function = library.rs_cosimulate
        self._keep: list[Any] = []
        self._made = (_Member * len(members))(*map(self._member, members))
        sizes = [len(_inputs(member)) for member in members]
        self._first = np.cumsum([0, *sizes], dtype=np.int64)
        self._u = _pointers([at for member in members for at in _places(member, "u")])
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
        self._failed = np.zeros(2, np.int64)
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
        self, t0: float, h: float, steps: int, *, every: int = 1, progress: Callable[[float], None] | None = None
    ) -> np.ndarray:
        """Take steps of length h from t0 on; return y (rows, n_y) after each step that ``every`` divides.

        The outputs of the members must be up to date (`exchange` without a step, `output`). The rows end early where
        one is not finite; that row is the last. Raises FmuError with the time when an FMU fails.
        """
        rows = np.empty((steps // every, self.n_y))
        done = written = 0
        chunk = _FIRST
        while done < steps:
            end = min(steps, done + max(chunk // every, 1) * every)
            begun = time.perf_counter()
            taken = self._function(
                ctypes.addressof(self._made), len(self.members), *map(_at, (self._order,)), self._sequential,
                *map(_at, (self._first, self._start, self._column, self._gain, self._u0, self._u)), self.n_y,
                _at(self._y), t0, h, done, end, every, self._sweeps, _at(rows[written:]), _at(self._failed),
            )  # fmt: skip
            written = (done + taken) // every
            if self._failed[1]:
                self.rows = rows[:written].copy()
                self._raise(int(self._failed[0]), int(self._failed[1]), t0 + (done + taken) * h)
            if taken < end - done or (written and not np.isfinite(rows[written - 1]).all()):
                return rows[:written].copy()
            done = end
            if time.perf_counter() - begun < _SLICE:
                chunk *= 2
            if progress:
                progress(done / steps)
        return rows

    def warned(self, k: int) -> int:
        """Return how often an FMU has returned a warning in this loop."""
        return int(self._made[k].warned)

    def _raise(self, k: int, what: int, t: float) -> None:
        """Raise the failure of a member as `Slave.exchange` does, with the time of an end that it asks for."""
        member = self.members[k]
        assert isinstance(member, Slave)
        if what == 5:
            raise member.step_failed("-", "asks for the end of the simulation", "ended", self._made[k].last)
        if what == 4:
            raise member.step_failed("DoStep", "returned early", "discard", t)
        status = what // 16
        if status == 2 and what % 16 == 2 and (end := member.asked_end()) is not None:
            raise member.step_failed("-", "asks for the end of the simulation", "ended", end)
        word = STATUS[status] if status < len(STATUS) else f"status {status}"
        kind = {2: "discard", 4: "fatal"}.get(status, "error")
        returned = f"returned fmi{member.description.version[0]}{word}"
        raise member.step_failed(_WHAT[what % 16], returned, kind, t)

    # -- filling the structures ----------------------------------------------------------------------------------------

    def _member(self, member: Slave | PartMember) -> _Member:
        if isinstance(member, Slave):
            return self._fmu(member)
        instance: CompiledInstance = member.instance
        row = np.zeros(instance.n_y)
        self._rows = getattr(self, "_rows", {})
        self._rows[id(member)] = out = np.zeros(instance.n_y)
        self._keep += [row, out, instance, member]
        library = instance.library
        made = _Member(kind=0, step=member.internal)
        made.run, made.record = (ctypes.cast(f, ctypes.c_void_p) for f in (library.run, library.record))
        made.p, made.m, made.x, made.z = (_at(a) for a in (instance.p, instance.memory, instance.x, instance.z))
        made.y, made.row = _at(out), _at(row)
        return made

    def _fmu(self, slave: Slave) -> _Member:
        self._rows = getattr(self, "_rows", {})
        assert isinstance(slave.worker, LocalWorker)
        steps = slave.worker.session.steps
        assert steps is not None
        calls = steps.calls
        getters, setters = (self._calls(found, calls.two) for found in (steps.output_calls, steps.input_calls))
        made = _Member(kind=2 if calls.two else 3, n_set=len(setters), n_get=len(getters), unbound=steps.unbound)
        made.instance = calls.instance
        made.do_step = ctypes.cast(calls.library["DoStep"], ctypes.c_void_p)
        made.set, made.get = ctypes.addressof(setters), ctypes.addressof(getters)
        self._keep += [setters, getters, slave]
        return made

    @staticmethod
    def _calls(calls: Sequence[Call], two: bool) -> Any:
        made = (_Call * len(calls))()
        for entry, (_, function, arguments) in zip(made, calls, strict=True):
            entry.function = ctypes.cast(function, ctypes.c_void_p)
            entry.references, entry.n_references, entry.values = arguments[1:4]
            entry.n = 0 if two else arguments[4]
        return made


def _unfit(member: Slave | PartMember) -> str:
    """Return why a member cannot take part, or ""."""
    if not isinstance(member, Slave):
        return "" if isinstance(member.instance, CompiledInstance) else "is not compiled"
    if not isinstance(member.worker, LocalWorker):
        return "has a process of its own"
    steps = member.worker.session.steps
    if member.kind != "cs" or steps is None:
        return "is not set up for Co-Simulation"
    prepared = (*steps.input_calls, *steps.output_calls)
    return "" if all(number for number, _, _ in prepared) else "has inputs or outputs that are not Float64"


def _inputs(member: Slave | PartMember) -> Sequence[str]:
    return member.input_names if isinstance(member, Slave) else member.inputs


def _places(member: Slave | PartMember, which: str, rows: dict[int, np.ndarray] | None = None) -> list[int]:
    """Return the addresses of the inputs or outputs of a member."""
    if isinstance(member, Slave):
        block = member.worker.block
        first, count = (block.u, len(member.input_names)) if which == "u" else (block.y, len(member.output_names))
        return [block.at(first + k) for k in range(count)]
    if which == "u":
        return [_at(member.instance.z) + 8 * (member.n_z + k) for k in range(len(member.inputs))]
    assert rows is not None
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
    source = files("rotorsim.fmi").joinpath("c", "loop.c").read_text(encoding="utf-8")
    try:
        library, _ = compile_c(source, compiler)
    except CompilerError as failure:
        failure.warn("the parts are coupled without the fast loop")
        return None
    i64, f64, ptr = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
    library.rs_cosimulate.argtypes = [
        ptr, i64, ptr, i64, ptr, ptr, ptr, ptr, ptr, ptr, i64, ptr, f64, f64, i64, i64, i64, i64, ptr, ptr,
    ]  # fmt: skip
    library.rs_cosimulate.restype = i64
    return library
