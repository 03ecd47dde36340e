"""The equations of an FMU, called from compiled code without Python between them (equations.c).

In this process, or in one of its own: the two processes then hand the block of numbers to and fro by themselves.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from rotorsim.fmi.description.model import FLOATS, ModelDescription
from rotorsim.fmi.runtime.calls import Calls, references
from rotorsim.fmi.runtime.channel import ordered
from rotorsim.fmi.runtime.process import LocalWorker, RemoteWorker
from rotorsim.fmi.runtime.runs import make_runs
from rotorsim.fmi.runtime.slave import Slave
from rotorsim.fmi.runtime.steps import DEFINES
from rotorsim.model.called import CALLED
from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler

READY = 8  # instances that are asked without Python, as of blocks with one file and parameters of their own
PAIRS_EACH = 6  # for every parameter: directions whose instances are known
_INT, _POINTER = ctypes.c_int64, ctypes.c_void_p


class _Instance(ctypes.Structure):
    _fields_ = [*((n, _POINTER) for n in ("instance", "sides")), ("due", ctypes.c_double), ("remote", _POINTER)]


class _Pair(ctypes.Structure):
    _fields_ = [("p", _POINTER), ("seed", _POINTER), ("high", _Instance), ("low", _Instance), ("step", ctypes.c_double)]


class _Ready(ctypes.Structure):
    _fields_ = [("p", _POINTER), ("of", _Instance)]


class _Fmu(ctypes.Structure):
    _fields_ = [
        *((n, _INT) for n in ("version", "n_x", "n_u", "n_y", "n_z", "n_p", "timed", "guarded", "n_pairs")),
        ("counts", _INT * 4),
        *((n, _POINTER) for n in ("set_time", "set_x", "get_xdot", "get_z", "set_real", "get_real")),
        *((n, _POINTER) for n in ("directional", "adjoint")),
        ("refs", _POINTER * 4),
        *((n, _POINTER) for n in ("u_scales", "y_scales", "nominals", "idle")),
        ("relative", ctypes.c_double),
        ("n_ready", _INT),
        ("ready", _POINTER),
        ("pairs", _POINTER),
        ("seen", _POINTER),
        ("work", _POINTER),
    ]


class _Function(ctypes.Structure):
    _fields_ = [
        *(("fmu", _POINTER), ("n_rows", _INT), ("rows", _POINTER)),
        *((name, _INT * 4) for name in ("groups", "wanted")),
        ("slow", _POINTER),
    ]


class _Completed(ctypes.Structure):
    _fields_ = [("fmu", _POINTER), ("p", _POINTER), ("function", _POINTER), ("unbound", _INT)]


@cache
def _library() -> ctypes.CDLL | None:
    compiler = find_compiler()
    if compiler is None:
        return None
    texts = (files("rotorsim.fmi").joinpath(name).read_text(encoding="utf-8") for name in ("evaluate.h", "equations.c"))
    source = DEFINES + "".join(texts)
    try:
        return compile_c(source, compiler, "-O3")[0]
    except CompilerError:
        return None


class InC:
    """What equations.c knows of an FMU: its functions, its last instances, and pairs of instances beside it.

    u, y: names of inputs and outputs; picked: where each of these lies among all outputs of the instances;
    p_size: number of parameters.
    """

    def __init__(
        self, description: ModelDescription, u: Sequence[str], y: Sequence[str], picked: Sequence[int], p_size: int
    ) -> None:
        self.description, self.u, self.y = description, list(u), list(y)
        self._picked = np.array(picked, np.int64)
        self.made = _Fmu()
        self._keep: list[Any] = []
        self._n_p = p_size
        self._ready = (_Ready * READY)()
        self._chosen: list[tuple[np.ndarray, Slave] | None] = [None] * READY
        self._oldest = 0
        self._sides: dict[int, np.ndarray] = {}
        self._callbacks: dict[int, tuple[_Completed, np.ndarray]] = {}
        self._most = PAIRS_EACH * (p_size + 1)
        self._pairs = (_Pair * self._most)()
        self._pair_of: list[tuple[np.ndarray, np.ndarray, Slave, Slave] | None] = [None] * self._most
        self._next = 0
        self._bound = False
        self.guarded = True

    @staticmethod
    def why_not(description: ModelDescription, u: Sequence[str], y: Sequence[str], in_process: bool) -> str:
        """Return why an FMU cannot be called from C, or nothing."""
        if _library() is None:
            return "no C compiler"
        if not in_process:
            return "" if ordered() else "has a process of its own, and this machine cannot look at it"
        every = [*make_runs(description.resolve(u), "input"), *make_runs(description.resolve(y), "output")]
        if any(run["type"] != FLOATS[0] or run["index"] is not None for run in every):
            return "has inputs or outputs that are not Float64, or entries of an array"
        for names in ([*description.derivatives, *y], [*description.states, *u]):
            runs = make_runs(description.resolve(names), "") if names else []
            if len(runs) > 1 or any(run["index"] is not None or run["n"] != len(names) for run in runs):
                return "has an output that is a derivative"
        return ""

    def bind(
        self,
        slave: Slave,
        scales: Sequence[np.ndarray],
        nominals: np.ndarray,
        idle: np.ndarray,
        relative: float,
        seen: np.ndarray,
        *,
        offered: Sequence[str],
        timed: bool,
    ) -> None:
        """Take the functions of the library of an instance.

        scales: of inputs and outputs, (n, 2); nominals (n_x,); idle (n_u,): inputs of functions that do not follow
        them; relative: step of central differences; seen (n_u + n_z,): gets inputs and event indicators where x' was
        asked for last; offered: which derivatives, directional, adjoint.
        """
        description, made = self.description, self.made
        n_x, n_u, n_y, n_p = len(description.states), len(self.u), len(self.y), self._n_p
        made.n_x, made.n_u, made.n_y, made.n_z, made.n_p = n_x, n_u, n_y, description.n_events, n_p
        made.timed, made.n_pairs = int(timed), self._most
        if isinstance(slave.worker, LocalWorker):
            self._take_functions(slave.worker.session.calls, offered)
        n, m = n_x + n_y, n_x + n_u
        # raw inputs, two times [x'; y], a point; zeros; a direction, rows, a direction in p, a gradient
        work = np.zeros(n_u + 2 * n + m + (n_p + m + 1) + m + n + n_p + m)
        held = [np.array(array, float) for array in (*scales, nominals, idle)]
        self._keep += [work, seen, *held]
        made.u_scales, made.y_scales, made.nominals, made.idle = (array.ctypes.data for array in held)
        made.relative = relative
        made.seen, made.guarded = seen.ctypes.data, int(self.guarded)
        made.work, made.pairs = work.ctypes.data, ctypes.addressof(self._pairs)
        made.ready, made.n_ready = ctypes.addressof(self._ready), READY
        self._bound = True

    def _take_functions(self, calls: Calls, offered: Sequence[str]) -> None:
        """Take the functions of a library that is loaded."""
        description, made = self.description, self.made
        made.version = int(calls.version[0])
        names = (self.u, self.y, [*description.derivatives, *self.y], [*description.states, *self.u])
        for k, own in enumerate(names):
            numbers = [ref for run in make_runs(description.resolve(own), "") for ref in run["refs"]] if own else []
            array = references(numbers)
            self._keep.append(array)
            made.refs[k], made.counts[k] = ctypes.addressof(array), len(numbers)
        wanted = {
            "set_time": "SetTime",
            "set_x": "SetContinuousStates",
            "get_xdot": "GetDerivatives",
            "get_z": "GetEventIndicators",
            "set_real": f"Set{calls.type_of(FLOATS[0])[0]}",
            "get_real": f"Get{calls.type_of(FLOATS[0])[0]}",
        }
        wanted |= {kind: f"Get{kind.capitalize()}Derivative" for kind in offered}
        for field, name in wanted.items():
            setattr(made, field, ctypes.cast(calls.function(name), _POINTER).value)

    def guard(self, on: bool) -> None:
        """Say whether an event ends the equations."""
        self.guarded = on
        self.made.guarded = int(on)

    @property
    def is_bound(self) -> bool:
        """Whether it knows the library."""
        return self._bound

    def choose(self, slave: Slave, p: np.ndarray, sides: np.ndarray, due: float) -> None:
        """Ask an instance with parameters p without Python from now on, instead of the one chosen first of all."""
        if any(known is not None and known[1] is slave for known in self._chosen):
            return
        k, self._oldest = self._oldest, (self._oldest + 1) % READY
        own = np.array(p, float)
        self._chosen[k] = own, slave
        self._ready[k] = _Ready(own.ctypes.data, self._instance(slave, sides, due))

    def pair(
        self, p: np.ndarray, seed: np.ndarray, ends: Sequence[tuple[Slave, np.ndarray, float]], step: float
    ) -> None:
        """Take the instances at p + step seed and p - step seed."""
        k, self._next = self._next, (self._next + 1) % self._most
        own = np.array(p, float), np.array(seed, float)
        self._pair_of[k] = (*own, ends[0][0], ends[1][0])
        pair = self._pairs[k]
        pair.p, pair.seed = (array.ctypes.data for array in own)
        pair.high, pair.low = (self._instance(*end) for end in ends)
        pair.step = step

    def completed_callback(self, slave: Slave, p: np.ndarray) -> tuple[int, int] | None:
        """Return the addresses of a function that tells an instance of a step, and of its context; None: of none."""
        worker, library, version = slave.worker, _library(), int(self.description.version[0])
        if library is None or version == 1:
            return None
        function, unbound = None, 1
        if isinstance(worker, LocalWorker):
            function = ctypes.cast(worker.session.calls.function("CompletedIntegratorStep"), _POINTER).value
            unbound = worker.session.steps.unbound
        own = np.array(p, float)
        made = _Completed(ctypes.addressof(self.made), own.ctypes.data, function, unbound)
        self._callbacks[id(slave)] = made, own
        return ctypes.cast(library.rs_fmu_completed, _POINTER).value or 0, ctypes.addressof(made)

    def forget(self, slave: Slave) -> None:
        """Forget an instance that is freed."""
        for k, chosen in enumerate(self._chosen):
            if chosen is not None and chosen[1] is slave:
                self._chosen[k], self._ready[k] = None, _Ready()
        for k, known in enumerate(self._pair_of):
            if known is not None and slave in known[2:]:
                self._pair_of[k], self._pairs[k].step = None, 0.0
        self._sides.pop(id(slave), None)
        self._callbacks.pop(id(slave), None)

    def _instance(self, slave: Slave, sides: np.ndarray, due: float) -> _Instance:
        worker = slave.worker
        own = self._sides.setdefault(id(slave), np.array(sides, float))
        if isinstance(worker, LocalWorker):
            return _Instance(worker.session.calls.instance, own.ctypes.data, due)
        assert isinstance(worker, RemoteWorker)
        worker.asked.picked = self._picked.ctypes.data
        return _Instance(None, own.ctypes.data, due, ctypes.addressof(worker.asked))

    @staticmethod
    def serve(slave: Slave) -> None:
        """Let an instance in a process of its own answer by C, too."""
        library = _library()
        if library is not None and isinstance(slave.worker, RemoteWorker):
            slave.worker.serve_in_c(str(library._name))

    def function(
        self,
        rows: Sequence[int],
        groups: Sequence[bool],
        wanted: Sequence[bool],
        slow: Callable[[Any, Any, Any], None],
        what: str,
    ) -> tuple[int, int, Any]:
        """Return addresses of a C function and of its context, and what both need as long as they are called.

        groups: which of t, x, u, p are arguments; wanted: by which of them sums are results; what: values, forward or
        reverse. slow: gets the context, the arguments and the results, and answers where C cannot.
        """
        library = _library()
        assert library is not None
        indices = np.array(rows, np.int64)
        trampoline = CALLED(slow)
        made = _Function(
            ctypes.addressof(self.made),
            len(indices),
            indices.ctypes.data,
            (_INT * 4)(*map(int, groups)),
            (_INT * 4)(*map(int, wanted)),
            ctypes.cast(trampoline, _POINTER).value,
        )
        function = getattr(library, f"rs_fmu_{what}")
        return ctypes.cast(function, _POINTER).value or 0, ctypes.addressof(made), (made, indices, trampoline, self)
