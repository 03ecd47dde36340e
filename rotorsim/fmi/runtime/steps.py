"""The steps of an instance: every call is prepared once, with pointers into the block, and then only made."""

from __future__ import annotations

import ctypes
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from rotorsim.fmi.runtime.binding import CallError
from rotorsim.fmi.runtime.calls import NUMBER, Call, Calls, address, references, whole
from rotorsim.fmi.runtime.memory import Block, Head, Op, Said

MAX_ITERATIONS = 1000  # of an event


class Failed:
    """What loop.c returns, beside 16 times the status of a call. LATE: wait for a process, or it says more."""

    SET, STEP, GET, EARLY, ENDED, LATE = range(1, 7)


class State:
    """What a member of loop.c has done in a pass."""

    TODO, ASKED, DONE = range(3)


PART, PROCESS = 0, 1  # kinds of members, beside the versions of FMUs in this process
_DEFINED = {
    "T": Block.T,
    "H": Block.H,
    "LAST": Block.LAST,
    **{f"OP_{name}": getattr(Op, name) for name in ("TIME", "X", "U", "STEP", "XDOT", "Y", "Z", "COMPLETED")},
    **{name: getattr(Said, name) for name in ("EVENT", "UNTOLD", "PENDING")},
    "TERMINATE": Said.TERMINATE,
    "DO_STEP": NUMBER["DoStep"],
    "PART": PART,
    "PROCESS": PROCESS,
    **{name: n for of in (Head, Failed, State) for name, n in vars(of).items() if name.isupper()},
}
DEFINES = "".join(
    f"#define RS_{name} {number}\n" for name, number in _DEFINED.items()
)  # that loop.c and equations.c begin with


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
    """A participant as loop.c takes it: ``rs_member``."""

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


class _Asked(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int64) for name in ("op", "number")),
        *((name, ctypes.c_void_p) for name in ("function", "references")),
        ("n_references", ctypes.c_size_t),
        ("values", ctypes.c_void_p),
        ("n", ctypes.c_size_t),
    ]


class Server(ctypes.Structure):
    """Evaluations as equations.c does them in the process of an FMU: ``rs_server``."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in ("version", "n_calls", "unbound")),
        *((name, ctypes.c_void_p) for name in ("instance", "calls", "head")),
        *((name, ctypes.c_int64) for name in ("count", "looks", "bell")),
    ]


class Steps(ABC):
    """What happens at every step of an instance with chosen inputs and outputs.

    initialising: the FMU is in its initialisation mode. unbound: no state before this point will be set again, which
    the FMU is told. served_by: the function of C that does these steps where all inputs and outputs are Float64.
    """

    served_by: str

    def __init__(self, calls: Calls, inputs: Sequence[Any], outputs: Sequence[Any], *, events: bool = False) -> None:
        self.calls, self.block = calls, calls.block
        self.head, self.numbers = self.block.head, self.block.numbers
        self.initialising, self.unbound = True, 1
        self._keep: list[Any] = []  # what C holds pointers to
        bound = [(events and run["discrete"], self._bind(run, "Set", self.block.u)) for run in inputs]
        self._held, self._discrete = (
            [call for late, calls in bound if late == at_events for call in calls] for at_events in (False, True)
        )
        self._outputs = [call for run in outputs for call in self._bind(run, "Get", self.block.y)]

    @abstractmethod
    def run(self, op: int) -> None:
        """Do what the bits of ``op`` say, on the numbers in the block. Raises CallError."""

    @property
    def fed(self) -> bool:
        """Whether it has inputs."""
        return bool(self._held or self._discrete)

    @abstractmethod
    def in_c(self) -> Member | Server:
        """Return the steps for `served_by`, where inputs and outputs are all Float64."""

    @property
    def all_float(self) -> bool:
        """Whether inputs and outputs are all Float64."""
        return all(number for number, _, _ in (*self._held, *self._outputs))

    def begin(self) -> None:
        """Start, after the initialisation."""
        self.initialising = False

    def read_outputs(self) -> None:
        """Get the outputs."""
        if self.initialising:
            self.calls.before_reading()
        self.calls.many(self._outputs)

    def set(self, run: Mapping[str, Any], numbers: Sequence[Any]) -> None:
        """Set variables between steps."""
        self.calls.set(run, numbers)

    # -- preparing -----------------------------------------------------------------------------------------------------

    def _bind(self, run: Mapping[str, Any], verb: str, offset: int) -> list[Call]:
        """Return the calls that set or get a run of variables, from ``offset`` in the block on."""
        word, ctype = self.calls.type_of(run["type"])
        of, n, index = references(run["refs"]), run["n"], run["index"]
        first = offset + run["offset"]
        values = None if run["type"] == "Float64" and index is None else (ctype * n)()
        self._keep += [of, values]
        where = self.block.at(first) if values is None else address(values)
        arguments = (self.calls.instance, address(of), len(of), *self.calls.sized((where, n)))
        call: Call = (NUMBER[verb], self.calls.function(verb + word), arguments)
        if values is None:
            return [call]
        pairs = list(enumerate(range(n) if index is None else index, first))
        if verb == "Get":
            return [call, (0, self._spread, (values, pairs))]
        before = [(NUMBER["Get"], self.calls.function("Get" + word), arguments)] if index is not None else []
        return [*before, (0, self._gather, (values, pairs, run["type"])), call]

    def _spread(self, values: Any, pairs: Sequence[tuple[int, int]]) -> int:
        for at, k in pairs:
            self.numbers[at] = values[k]
        return 0

    def _gather(self, values: Any, pairs: Sequence[tuple[int, int]], kind: str) -> int:
        for at, k in pairs:
            number = self.numbers[at]
            if kind == "Boolean":
                values[k] = number != 0.0
            elif kind.startswith("Float"):
                values[k] = number
            elif math.isfinite(number) and number == round(number):
                values[k] = whole(int(number), type(values)._type_)
            else:
                raise CallError("refused", "Set", f"{number:g} is not a whole number")
        return 0


class CoSimulationSteps(Steps):
    """Steps of Co-Simulation: set inputs, step, get outputs."""

    served_by = "rs_serve"

    def __init__(self, calls: Calls, inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        super().__init__(calls, inputs, outputs)
        orders = range(1, self.block.sizes.order + 1)
        plain = [run for run in inputs if run["type"] == "Float64" and run["index"] is None]
        self._du = [self._bind_derivative(run, order) for run in plain for order in orders]
        self._do_step = calls.function("DoStep")
        self._flags = (ctypes.c_bool * 3)()  # FMI 3.0: event handling needed, terminate, early return
        self._more = calls.step_results(address(self._flags))

    def _bind_derivative(self, run: Mapping[str, Any], order: int) -> Call:
        """Return the call that sets derivatives of inputs (FMI 2.0)."""
        of, orders = references(run["refs"]), (ctypes.c_int * run["n"])(*[order] * run["n"])
        self._keep += [of, orders]
        at = self.block.at(self.block.du + (order - 1) * self.block.sizes.n + run["offset"])
        arguments = (self.calls.instance, address(of), run["n"], address(orders), at)
        return NUMBER["SetInputDerivatives"], self.calls.function("SetInputDerivatives"), arguments

    def run(self, op: int) -> None:
        if op & Op.U:
            self.calls.many(self._held)
        if op & Op.DU:
            self.calls.many(self._du)
        if op & Op.STEP:
            self._advance()
        if op & Op.Y:
            self.read_outputs()
        self.head[Head.FUNCTION] = 0

    def _advance(self) -> None:
        numbers = self.numbers
        self.head[Head.FUNCTION] = NUMBER["DoStep"]
        t, h = numbers[Block.T], numbers[Block.H]
        status = self._do_step(self.calls.instance, t, h, self.unbound, *self._more)
        if status == 1:
            self.head[Head.WARNED] += 1
        elif status:
            self._refused(status)
        if self._flags[2] and abs(numbers[Block.LAST] - t - h) > 1e-9 * h:
            raise self._early()
        self.head[Head.SAID] = Said.TERMINATE if self._flags[1] else 0

    def _early(self) -> CallError:
        last = self.numbers[Block.LAST]
        return CallError("discard", "DoStep", f"returned early, at t = {last:.9g} s", last=last)

    def _refused(self, status: int) -> None:
        """Raise why a step was not done; of a step that was refused, how far it came."""
        if status == 5:
            what = f"runs on after it has returned ({self.calls.library.prefix}Pending), which is not supported"
            raise CallError("error", "DoStep", what, log=self.calls.log.taken())
        if status != 2:
            self.calls.fail("DoStep", status)
        last = self.calls.reached()
        how = "" if last is None else f", it came to t = {last:.9g} s"
        raise CallError("discard", "DoStep", f"refused the step{how}", last=last, log=self.calls.log.taken())

    # -- in C ----------------------------------------------------------------------------------------------------------

    def in_c(self) -> Member:
        setters, getters = (_in_c(calls) for calls in (self._held, self._outputs))
        self._keep += [setters, getters]
        return Member(
            kind=int(self.calls.version[0]),
            n_set=len(setters),
            n_get=len(getters),
            unbound=self.unbound,
            instance=self.calls.instance,
            do_step=ctypes.cast(self._do_step, ctypes.c_void_p),
            set=address(setters),
            get=address(getters),
            head=self.block.at(0),
        )

    def fail(self, what: int) -> None:
        """Raise what loop.c returned, as `run` does. Raises CallError, but for an end that is asked for."""
        kind, status = what % 16, what // 16
        if kind == Failed.EARLY:
            raise self._early()
        if kind == Failed.STEP:
            self._refused(status)
        if kind != Failed.ENDED:
            self.calls.fail({Failed.SET: "Set", Failed.GET: "Get"}[kind], status)


class ModelExchangeSteps(Steps):
    """Evaluations and events of Model Exchange."""

    served_by = "rs_serve_equations"

    def __init__(self, calls: Calls, n_x: int, n_z: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        super().__init__(calls, inputs, outputs, events=True)
        block = self.block
        self._write_x = self._bind_vector("SetContinuousStates", block.x, n_x)
        self._read_x = self._bind_vector("GetContinuousStates", block.x, n_x)
        self._xdot = self._bind_vector("GetDerivatives", block.xdot, n_x)
        self._z = self._bind_vector("GetEventIndicators", block.z, n_z)
        self._nominals = self._bind_vector("GetNominalsOfContinuousStates", block.nominals, n_x)
        self._set_time = calls.function("SetTime")

    def _bind_vector(self, name: str, offset: int, n: int) -> list[Call]:
        return [(NUMBER[name], self.calls.function(name), (self.calls.instance, self.block.at(offset), n))][: n or 0]

    def run(self, op: int) -> None:
        many = self.calls.many
        if op & Op.TIME:
            many([(NUMBER["SetTime"], self._set_time, (self.calls.instance, self.numbers[Block.T]))])
        if op & Op.X:
            many(self._write_x)
        if op & Op.U:
            many(self._held)
            many(self._discrete if self.initialising else ())
        if op & Op.XDOT:
            many(self._xdot)
        if op & Op.Y:
            self.read_outputs()
        if op & Op.Z:
            many(self._z)
        if op & Op.COMPLETED:
            self._complete()
        if op & Op.EVENT:
            self._event(op)
        self.head[Head.FUNCTION] = 0

    def in_c(self) -> Server:
        time: Call = (NUMBER["SetTime"], self._set_time, (self.calls.instance, 0))
        asked = {Op.TIME: [time], Op.X: self._write_x, Op.U: self._held, Op.XDOT: self._xdot, Op.Y: self._outputs}
        asked[Op.Z] = self._z
        if self.calls.completed_in_c:
            name = "CompletedIntegratorStep"
            asked[Op.COMPLETED] = [(NUMBER[name], self.calls.function(name), ())]
        calls = [(op, call) for op, own in asked.items() for call in own]
        made = (_Asked * len(calls))()
        for entry, (op, (number, function, arguments)) in zip(made, calls, strict=True):
            entry.op, entry.number, entry.function = op, number, ctypes.cast(function, ctypes.c_void_p)
            if op in (Op.U, Op.Y):
                entry.references, entry.n_references, entry.values, entry.n = (*arguments[1:], 0)[:4]
            elif op not in (Op.TIME, Op.COMPLETED):
                entry.values, entry.n = arguments[1:]
        self._keep.append(made)
        version, instance = int(self.calls.version[0]), self.calls.instance
        return Server(version, len(calls), self.unbound, instance, address(made), self.block.at(0))

    def begin(self) -> None:
        super().begin()
        self._settle()
        self.calls.many(self._nominals)

    def set(self, run: Mapping[str, Any], numbers: Sequence[Any]) -> None:
        if self.initialising:
            return super().set(run, numbers)
        self.calls.call("EnterEventMode")
        super().set(run, numbers)
        return self._settle()

    def _complete(self) -> None:
        event, end = self.calls.completed_step(self.unbound)
        self.head[Head.SAID] = (Said.EVENT if event else 0) | (Said.TERMINATE if end else 0)

    def _event(self, op: int) -> None:
        self.calls.call("EnterEventMode")
        self.calls.many(self._discrete if op & Op.U else ())
        self._settle()
        if self.head[Head.SAID] & Said.NOMINALS:
            self.calls.many(self._nominals)

    def _settle(self) -> None:
        """Iterate the event until nothing changes; go on in continuous time; read the states."""
        said = 0
        for _ in range(MAX_ITERATIONS):
            info = self.calls.update_discrete_states()
            told = {Said.TERMINATE: info.terminate, Said.NOMINALS: info.nominals, Said.STATES: info.states}
            said |= sum(bit for bit, is_so in told.items() if is_so)
            if not info.needed or info.terminate:
                break
        else:
            what = f"the event does not end after {MAX_ITERATIONS} iterations"
            raise CallError("error", "NewDiscreteStates", what)
        self.numbers[Block.NEXT] = info.time if info.defined else math.inf
        self.head[Head.SAID] = said
        if not said & Said.TERMINATE:
            self.calls.call("EnterContinuousTimeMode")
            self.calls.many(self._read_x)


def _in_c(calls: Sequence[Call]) -> Any:
    made = (_Call * len(calls))()
    for entry, (number, function, arguments) in zip(made, calls, strict=True):
        entry.number, entry.function = number, ctypes.cast(function, ctypes.c_void_p)
        entry.references, entry.n_references, entry.values, entry.n = (*arguments[1:], 0)[:4]
    return made
