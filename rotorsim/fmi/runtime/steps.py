"""The steps of an instance: every call is prepared once, with pointers into the block, and then only made."""

from __future__ import annotations

import contextlib
import ctypes
import math
from collections.abc import Mapping, Sequence
from typing import Any

from rotorsim.fmi.runtime.binding import CallError
from rotorsim.fmi.runtime.calls import FUNCTIONS, NUMBER, Call, Calls, address, references, whole
from rotorsim.fmi.runtime.memory import Block, Head, Op, Said

__all__ = ["DEFINES", "PART", "PROCESS", "Failed", "Member", "State", "Steps"]

MAX_ITERATIONS = 1000  # of an event


class Failed:
    """What c/loop.c returns, beside 16 times the status of a call. LATE: wait for a process, or it says more."""

    SET, STEP, GET, EARLY, ENDED, LATE = range(1, 7)


class State:
    """What a member of c/loop.c has done in a pass."""

    TODO, ASKED, DONE = range(3)


PART, PROCESS = 0, 1  # kinds of members, beside the versions of FMUs in this process
_DEFINED = {
    "T": Block.T,
    "H": Block.H,
    "LAST": Block.LAST,
    "OP_U": Op.U,
    "OP_STEP": Op.STEP,
    "OP_Y": Op.Y,
    "TERMINATE": Said.TERMINATE,
    "DO_STEP": NUMBER["DoStep"],
    "PART": PART,
    "PROCESS": PROCESS,
    **{name: n for of in (Head, Failed, State) for name, n in vars(of).items() if name.isupper()},
}
DEFINES = "".join(f"#define RS_{name} {number}\n" for name, number in _DEFINED.items())  # that c/loop.c begins with


class _Call(ctypes.Structure):
    _fields_ = [
        ("number", ctypes.c_int64),
        ("function", ctypes.c_void_p),
        ("references", ctypes.c_void_p),
        ("n_references", ctypes.c_size_t),
        ("values", ctypes.c_void_p),
        ("n", ctypes.c_size_t),
    ]


class Member(ctypes.Structure):
    """A participant as c/loop.c takes it: ``rs_member``."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in ("kind", "state", "n_set", "n_get", "unbound")),
        *(
            (name, ctypes.c_void_p)
            for name in ("instance", "do_step", "set", "get", "run", "record", "p", "m", "x", "z", "y", "row")
        ),
        ("step", ctypes.c_double),
        ("head", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("count", "looks", "bell")),
    ]


class Steps:
    """What happens at every step of an instance with chosen inputs and outputs.

    initialising: the FMU is in its initialisation mode. unbound: no state before this point will be set again, which
    the FMU is told.
    """

    def __init__(self, calls: Calls, n_x: int, n_z: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        self.calls, self.block = calls, calls.block
        self.head, self.numbers = self.block.head, self.block.numbers
        self.two = calls.two
        self.initialising, self.unbound = True, 1
        self._keep: list[Any] = []  # what C holds pointers to
        held: list[Call] = []
        discrete: list[Call] = []
        for run in inputs:
            at_events = calls.kind == "me" and run["discrete"]
            (discrete if at_events else held).extend(self._bind(run, "Set", self.block.u))
        self._held, self._discrete, self._at_start = held, discrete, held + discrete
        self._outputs = [call for run in outputs for call in self._bind(run, "Get", self.block.y)]
        if calls.kind == "cs":
            self._bind_step(inputs)
        else:
            self._bind_states(n_x, n_z)

    # -- preparing -----------------------------------------------------------------------------------------------------

    def _bind_step(self, inputs: Sequence[Any]) -> None:
        self._du: list[Call] = self._bind_derivatives(inputs) if self.block.sizes.order and self.two else []
        self._do_step = self.calls.library["DoStep"]
        self._flags = (ctypes.c_bool * 3)()  # FMI 3.0: event handling needed, terminate, early return
        self._more: tuple[int, ...] = ()
        if not self.two:
            self._more = (*(address(self._flags) + k for k in range(3)), self.block.at(Block.LAST))

    def _bind_states(self, n_x: int, n_z: int) -> None:
        block, library, instance = self.block, self.calls.library, self.calls.instance

        def bound(number: str, name: str, offset: int, n: int) -> list[Call]:
            return [(NUMBER[number], library[name], (instance, block.at(offset), n))] if n else []

        slope = "GetDerivatives" if self.two else "GetContinuousStateDerivatives"
        nominal = "GetNominalsOfContinuousStates"
        self._write_x = bound("SetContinuousStates", "SetContinuousStates", block.x, n_x)
        self._read_x = bound("GetContinuousStates", "GetContinuousStates", block.x, n_x)
        self._xdot = bound("GetDerivatives", slope, block.xdot, n_x)
        self._z = bound("GetEventIndicators", "GetEventIndicators", block.z, n_z)
        self._nominals = bound(nominal, nominal, block.nominals, n_x)
        self._time = library["SetTime"]
        self._du = []

    def _bind(self, run: Mapping[str, Any], verb: str, offset: int) -> list[Call]:
        """Return the calls that set or get a run of variables, from ``offset`` in the block on."""
        library = self.calls.library
        word, ctype = self.calls.type_of(run["type"])
        of, n, index = references(run["refs"]), run["n"], run["index"]
        first = offset + run["offset"]
        direct = run["type"] == "Float64" and index is None
        values = None if direct else (ctype * n)()
        self._keep += [of, values]
        where = self.block.at(first) if values is None else address(values)
        arguments = (self.calls.instance, address(of), len(of), where, *(() if self.two else (n,)))
        call: Call = (NUMBER[verb], library[verb + word], arguments)
        if values is None:
            return [call]
        places = list(range(n)) if index is None else index
        pairs = list(zip(range(first, first + len(places)), places, strict=True))
        if verb == "Get":
            return [call, (0, self._spread, (values, pairs))]
        before: list[Call] = [(NUMBER["Get"], library["Get" + word], arguments)] if index is not None else []
        return [*before, (0, self._gather, (values, pairs, run["type"])), call]

    def _spread(self, values: Any, pairs: Sequence[tuple[int, int]]) -> int:
        for at, k in pairs:
            self.numbers[at] = values[k]
        return 0

    def _gather(self, values: Any, pairs: Sequence[tuple[int, int]], kind: str) -> int:
        numbers = self.numbers
        for at, k in pairs:
            number = numbers[at]
            if kind == "Boolean":
                values[k] = number != 0.0
            elif kind.startswith("Float"):
                values[k] = number
            elif math.isfinite(number) and number == round(number):
                values[k] = whole(int(number), type(values)._type_)
            else:
                raise CallError("refused", "Set", f"{number:g} is not a whole number")
        return 0

    def _bind_derivatives(self, inputs: Sequence[Any]) -> list[Call]:
        """Return the calls that set derivatives of the inputs (FMI 2.0)."""
        calls: list[Call] = []
        block, n = self.block, self.block.sizes.n
        for run in inputs:
            if run["type"] == "Float64" and run["index"] is None:
                of = references(run["refs"])
                for order in range(1, block.sizes.order + 1):
                    orders = (ctypes.c_int * run["n"])(*[order] * run["n"])
                    self._keep += [of, orders]
                    at = block.at(block.du + (order - 1) * n + run["offset"])
                    arguments = (self.calls.instance, address(of), run["n"], address(orders), at)
                    function = self.calls.library["SetRealInputDerivatives"]
                    calls.append((NUMBER["SetInputDerivatives"], function, arguments))
        return calls

    # -- in C ----------------------------------------------------------------------------------------------------------

    @property
    def all_float(self) -> bool:
        """Whether inputs and outputs are all Float64."""
        return all(number for number, _, _ in (*self._held, *self._outputs))

    def in_c(self) -> Member:
        """Return the steps of Co-Simulation for c/loop.c, where inputs and outputs are all Float64."""
        calls = self.calls
        setters, getters = (_in_c(found, calls.two) for found in (self._held, self._outputs))
        self._keep += [setters, getters]
        return Member(
            kind=2 if calls.two else 3,
            n_set=len(setters),
            n_get=len(getters),
            unbound=self.unbound,
            instance=calls.instance,
            do_step=ctypes.cast(self._do_step, ctypes.c_void_p),
            set=address(setters),
            get=address(getters),
            head=self.block.at(0),
        )

    def fail(self, what: int) -> None:
        """Raise what c/loop.c returned, as `run` does. Raises CallError, but for an end that is asked for."""
        kind, status = what % 16, what // 16
        if kind == Failed.EARLY:
            raise self._early()
        if kind == Failed.STEP:
            self._refused(status)
        if kind != Failed.ENDED:
            self.calls.fail({Failed.SET: "Set", Failed.GET: "Get"}[kind], status)

    # -- steps ---------------------------------------------------------------------------------------------------------

    def run(self, op: int) -> None:
        """Do what the bits of ``op`` say, on the numbers in the block. Raises CallError."""
        head = self.head
        if op & 3:  # TIME | X
            if op & Op.TIME:
                head[Head.FUNCTION] = NUMBER["SetTime"]
                status = self._time(self.calls.instance, self.numbers[Block.T])
                if status:
                    self.calls.check("SetTime", status)
            if op & Op.X:
                self.calls.many(self._write_x)
        if op & Op.U:
            for number, function, arguments in self._at_start if self.initialising else self._held:
                head[Head.FUNCTION] = number
                status = function(*arguments)
                if status:
                    self.calls.check(FUNCTIONS[number], status)
        if op & Op.DU:
            self.calls.many(self._du)
        if op & Op.STEP:
            self._advance()
        if op & Op.XDOT:
            self.calls.many(self._xdot)
        if op & Op.Y:
            for number, function, arguments in self._outputs:
                head[Head.FUNCTION] = number
                status = function(*arguments)
                if status:
                    self.calls.check(FUNCTIONS[number], status)
        if op >= Op.Z:
            if op & Op.Z:
                self.calls.many(self._z)
            if op & Op.READ_X:
                self.calls.many(self._read_x)
            if op & Op.COMPLETED:
                self._complete()
            if op & Op.EVENT:
                self._event(op)
        head[Head.FUNCTION] = 0

    def _advance(self) -> None:
        numbers = self.numbers
        self.head[Head.FUNCTION] = NUMBER["DoStep"]
        t, h = numbers[Block.T], numbers[Block.H]
        status = self._do_step(self.calls.instance, t, h, self.unbound, *self._more)
        if status == 1:
            self.head[Head.WARNED] += 1
        elif status:
            self._refused(status)
        if not self.two:
            if self._flags[2] and abs(numbers[Block.LAST] - t - h) > 1e-9 * h:
                raise self._early()
            self.head[Head.SAID] = Said.TERMINATE if self._flags[1] else 0

    def _early(self) -> CallError:
        last = self.numbers[Block.LAST]
        return CallError("discard", "DoStep", f"returned early, at t = {last:.9g} s", last=last)

    def _refused(self, status: int) -> None:
        """Raise why a step was not done; of a step that was refused, how far it came."""
        if status == 5:
            what = "runs on after it has returned (fmi2Pending), which is not supported"
            raise CallError("error", "DoStep", what, log=self.calls.log.taken())
        if status != 2:
            self.calls.fail("DoStep", status)
        last = self.reached()[0] if self.two else self.numbers[Block.LAST]
        how = "" if last is None else f", it came to t = {last:.9g} s"
        raise CallError("discard", "DoStep", f"refused the step{how}", last=last, log=self.calls.log.taken())

    def reached(self) -> tuple[float | None, bool]:
        """Return how far a step came that was refused, and whether the FMU asks for the end (FMI 2.0)."""
        time, ended, instance = ctypes.c_double(), ctypes.c_int(), self.calls.instance
        last: float | None = None
        with contextlib.suppress(CallError):
            if self.calls.library["GetBooleanStatus"](instance, 3, address(ended)) == 0 and ended.value:
                self.head[Head.SAID] = Said.TERMINATE
            if self.calls.library["GetRealStatus"](instance, 2, address(time)) == 0:
                last = time.value
        return last, bool(ended.value)

    def _complete(self) -> None:
        pair = ((ctypes.c_int if self.two else ctypes.c_bool) * 2)()
        second = address(pair) + ctypes.sizeof(pair) // 2
        name = "CompletedIntegratorStep"
        self.calls.call(name, name, self.unbound, address(pair), second)
        self.head[Head.SAID] = (Said.EVENT if pair[0] else 0) | (Said.TERMINATE if pair[1] else 0)

    # -- events of Model Exchange --------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Start in continuous time, after the initialisation."""
        self.initialising = False
        if self.calls.kind == "me":
            self.settle()
            self.calls.many(self._nominals)

    def _event(self, op: int) -> None:
        self.calls.call("EnterEventMode", "EnterEventMode")
        if op & Op.U:
            self.calls.many(self._discrete)
        self.settle()
        if self.head[Head.SAID] & Said.NOMINALS:
            self.calls.many(self._nominals)

    def settle(self) -> None:
        """Iterate the event until nothing changes; go on in continuous time; read the states."""
        said = 0
        info = _Info2() if self.two else _Info3()
        at = address(info)
        places = (at,) if self.two else tuple(at + offset for offset in _OFFSETS3)
        name = "NewDiscreteStates" if self.two else "UpdateDiscreteStates"
        for _ in range(MAX_ITERATIONS):
            self.calls.call("NewDiscreteStates", name, *places)
            said |= (Said.TERMINATE if info.terminate else 0) | (Said.NOMINALS if info.nominals else 0)
            said |= Said.STATES if info.states else 0
            if not info.needed or info.terminate:
                break
        else:
            what = f"the event does not end after {MAX_ITERATIONS} iterations"
            raise CallError("error", "NewDiscreteStates", what)
        self.numbers[Block.NEXT] = info.time if info.defined else math.inf
        self.head[Head.SAID] = said
        if not said & Said.TERMINATE:
            self.calls.call("EnterContinuousTimeMode", "EnterContinuousTimeMode")
            self.calls.many(self._read_x)


def _in_c(calls: Sequence[Call], two: bool) -> Any:
    made = (_Call * len(calls))()
    for entry, (number, function, arguments) in zip(made, calls, strict=True):
        entry.number, entry.function = number, ctypes.cast(function, ctypes.c_void_p)
        entry.references, entry.n_references, entry.values = arguments[1:4]
        entry.n = 0 if two else arguments[4]
    return made


_FLAGS = ("needed", "terminate", "nominals", "states", "defined")


class _Info2(ctypes.Structure):
    _fields_ = [*((name, ctypes.c_int) for name in _FLAGS), ("time", ctypes.c_double)]


class _Info3(ctypes.Structure):
    _fields_ = [*((name, ctypes.c_bool) for name in _FLAGS), ("time", ctypes.c_double)]


_OFFSETS3 = tuple(getattr(_Info3, name).offset for name in (*_FLAGS, "time"))
