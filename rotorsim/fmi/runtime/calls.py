"""Calls of one instance of an FMU: status checked, values converted, the function at work noted in the block."""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from rotorsim.fmi.runtime.binding import TYPES, CallError, Log, library_of, status_error
from rotorsim.fmi.runtime.memory import Block, Head

FUNCTIONS = (
    "-",
    "load",
    "Instantiate",
    "SetupExperiment",
    "EnterInitializationMode",
    "ExitInitializationMode",
    "Set",
    "Get",
    "DoStep",
    "SetTime",
    "SetContinuousStates",
    "GetDerivatives",
    "GetContinuousStates",
    "GetEventIndicators",
    "GetNominalsOfContinuousStates",
    "CompletedIntegratorStep",
    "EnterEventMode",
    "NewDiscreteStates",
    "EnterContinuousTimeMode",
    "SetInputDerivatives",
    "GetOutputDerivatives",
    "GetDirectionalDerivative",
    "GetAdjointDerivative",
    "GetFMUState",
    "SetFMUState",
    "FreeFMUState",
    "SerializeFMUState",
    "DeserializeFMUState",
    "Terminate",
    "Reset",
    "FreeInstance",
    "EnterConfigurationMode",
    "ExitConfigurationMode",
)
NUMBER = {name: k for k, name in enumerate(FUNCTIONS)}
Call = tuple[int, Any, tuple[Any, ...]]  # number in FUNCTIONS, function, arguments


class Functions(Protocol):
    """A library: ``functions["DoStep"]`` takes an instance and addresses, and returns a status.

    prefix: of the names of functions and statuses.
    """

    prefix: str

    def __getitem__(self, name: str) -> Any:
        """Return a function. Raises CallError where there is none."""


class Calls(ABC):
    """The library, the instance and the log of an FMU, and the ways to call it; what the versions do differently.

    names: a function as `FUNCTIONS` has it -> as the version calls it. boolean: its type of C. version: 2.0 or 3.0,
    whose arguments the functions have that are called from C. waiting: an initialisation that may not be left again.
    completed_in_c: CompletedIntegratorStep has them, too.
    """

    names: Mapping[str, str] = {}
    waiting: Callable[[], None] | None = None
    completed_in_c = True
    boolean: Any

    def __init__(self, block: Block, path: str, version: str, kind: str) -> None:
        self.block, self.head = block, block.head
        self.version, self.kind = version, kind
        self.types = TYPES[version]
        self.log = Log(version)
        self.head[Head.FUNCTION] = NUMBER["load"]
        self.library = self.open(path, version)
        self.instance: int | None = None

    def open(self, path: str, version: str) -> Functions:
        """Load the library. Raises CallError."""
        return library_of(path, version)

    @abstractmethod
    def create(self, name: bytes, token: bytes, resources: bytes | None) -> int | None:
        """Return a new instance, which logs."""

    @abstractmethod
    def initialise(self, start: float, stop: float | None, tolerance: float | None, n_x: int, n_z: int) -> None:
        """Enter the initialisation; n_x, n_z: numbers of states and event indicators in the description."""

    def before_reading(self) -> None:
        """Do what waits until values are read."""
        if self.waiting is not None:
            initialise, self.waiting = self.waiting, None
            initialise()

    @property
    def is_settled(self) -> bool:
        """Whether inputs that are set in the initialisation come too late for it."""
        return False

    def exit_initialisation(self) -> None:
        """Leave the initialisation."""
        self.call("ExitInitializationMode")

    def reset(self) -> None:
        """Go back to where the instance was when it was made."""
        self.call("Reset")

    def sized(self, *arrays: tuple[int, int]) -> tuple[int, ...]:
        """Return the arguments that arrays make, (address, length) each: FMI 3.0 tells their lengths."""
        return tuple(at for at, _ in arrays)

    def update_discrete_states(self) -> Any:
        """Return a structure with ``needed``, ``terminate``, ``nominals``, ``states``, ``defined`` and ``time``."""
        raise CallError("refused", "NewDiscreteStates", "is of Model Exchange")

    def completed_step(self, unbound: int) -> tuple[bool, bool]:
        """Tell of a completed step; return whether the FMU wants an event, and the end."""
        wants = (self.boolean * 2)()
        second = address(wants) + ctypes.sizeof(wants) // 2
        self.call("CompletedIntegratorStep", unbound, address(wants), second)
        return bool(wants[0]), bool(wants[1])

    def step_results(self, flags: int) -> tuple[int, ...]:
        """Return further arguments of DoStep: where three flags and the time reached are to be put."""
        return ()

    def reached(self) -> float | None:
        """Return how far a step came that was refused; note whether the FMU asks for the end."""
        return None

    def function(self, name: str) -> Any:
        """Return a function of the library."""
        return self.library[self.names.get(name, name)]

    def instantiate(self, name: str, token: str, resources: str | None) -> None:
        """Make the instance. Raises CallError."""
        self.head[Head.FUNCTION] = NUMBER["Instantiate"]
        where = resources.encode() if resources is not None else None
        self.instance = self.create(name.encode(), token.encode(), where)
        self.head[Head.FUNCTION] = 0
        if not self.instance:
            raise CallError("error", "Instantiate", "returned no instance", log=self.log.taken())

    def free(self) -> None:
        """Free the instance."""
        if self.instance:
            instance, self.instance = self.instance, None
            self.head[Head.FUNCTION] = NUMBER["FreeInstance"]
            self.function("FreeInstance")(instance)
            self.head[Head.FUNCTION] = 0

    def call(self, shown: str, *arguments: Any, name: str = "") -> None:
        """Call a function with the instance and arguments; name: where it is not that shown. Raises CallError."""
        if not self.instance:
            raise CallError("refused", shown, "there is no instance")
        function: Callable[..., int] = self.function(name or shown)
        self.head[Head.FUNCTION] = NUMBER.get(shown, 0)
        status = function(self.instance, *arguments)
        self.head[Head.FUNCTION] = 0
        if status:
            self.check(shown, status)

    def many(self, calls: Sequence[Call]) -> None:
        """Make calls that are prepared. Raises CallError."""
        head = self.head
        for number, function, arguments in calls:
            head[Head.FUNCTION] = number
            status = function(*arguments)
            if status:
                self.check(FUNCTIONS[number], status)

    def check(self, function: str, status: int) -> None:
        """Count a warning; raise what a worse status means."""
        if status != 1:
            self.fail(function, status)
        self.head[Head.WARNED] += 1

    def fail(self, function: str, status: int) -> None:
        """Raise what a status means."""
        self.head[Head.FUNCTION] = 0
        raise status_error(function, status, self.library.prefix, log=self.log.taken())

    # -- values --------------------------------------------------------------------------------------------------------

    def type_of(self, kind: str) -> tuple[str, Any]:
        """Return the word in function names and the type of C."""
        if kind not in self.types:
            raise CallError("refused", "Set", f"variables of type {kind} are not supported")
        return self.types[kind]

    def access(self, verb: str, run: Mapping[str, Any], values: Any) -> None:
        """Set the values of a run of variables (see runs.py), or get them."""
        of, word = references(run["refs"]), self.type_of(run["type"])[0]
        self.call(verb, address(of), len(of), *self.sized((address(values), run["n"])), name=verb + word)

    def get(self, run: Mapping[str, Any]) -> list[Any]:
        """Return the values of a run of variables."""
        values = (self.type_of(run["type"])[1] * run["n"])()
        self.access("Get", run, values)
        found = [v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in values]
        found = [bool(v) for v in found] if run["type"] == "Boolean" else found
        return found if run["index"] is None else [found[k] for k in run["index"]]

    def set(self, run: Mapping[str, Any], numbers: Sequence[Any]) -> None:
        """Set the values of a run of variables; of an array that is set in part, the rest is kept."""
        ctype, values = self.type_of(run["type"])[1], list(numbers)
        if run["index"] is not None:
            values = self.get({**run, "index": None})
            for k, number in zip(run["index"], numbers, strict=True):
                values[k] = number
        if run["type"] == "String":
            values = [text.encode() for text in values]
        elif run["type"] == "Boolean":
            values = [bool(number) for number in values]
        elif not run["type"].startswith("Float"):
            values = [whole(number, ctype) for number in values]
        self.access("Set", run, (ctype * run["n"])(*values))


def references(numbers: Sequence[int]) -> Any:
    """Return value references as C wants them."""
    return (ctypes.c_uint32 * len(numbers))(*numbers)


def address(data: Any) -> int:
    """Return where an object of C lies."""
    return ctypes.addressof(data)


def optional(value: float | None) -> tuple[int, float]:
    """Return whether a value is given, and it."""
    return (0, 0.0) if value is None else (1, value)


def whole(number: int, ctype: Any) -> int:
    """Return a whole number that fits the type. Raises CallError: C would wrap it without a word."""
    bits = 8 * ctypes.sizeof(ctype)
    signed = ctype(-1).value < 0
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    if not low <= number <= high:
        raise CallError("refused", "Set", f"{number} does not fit into {bits} bits")
    return number
