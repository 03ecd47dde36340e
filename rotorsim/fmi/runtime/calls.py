"""Calls of one instance of an FMU: status checked, values converted, the function at work noted in the block."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rotorsim.fmi.runtime.binding import STATUS, TYPES, CallError, Library, Log
from rotorsim.fmi.runtime.memory import Block, Head

__all__ = ["FUNCTIONS", "NUMBER", "Call", "Calls", "address", "references", "whole"]

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


class Calls:
    """The library, the instance and the log of an FMU, and the ways to call it."""

    def __init__(self, block: Block, path: str, version: str, kind: str) -> None:
        self.block, self.head = block, block.head
        self.version, self.kind, self.two = version, kind, version == "2.0"
        self.types = TYPES[version]
        self.log = Log(version)
        self.head[Head.FUNCTION] = NUMBER["load"]
        self.library = Library(path, version)
        self.instance: int | None = None

    def instantiate(self, name: str, token: str, resources: str | None) -> None:
        """Make the instance; it logs. Raises CallError."""
        self.head[Head.FUNCTION] = NUMBER["Instantiate"]
        library, texts = self.library, (name.encode(), token.encode())
        where = resources.encode() if resources is not None else None
        if self.two:
            callbacks = ctypes.addressof(self.log.struct)
            self.instance = library["Instantiate"](texts[0], int(self.kind == "cs"), texts[1], where, callbacks, 0, 1)
        elif self.kind == "cs":
            self.instance = library["InstantiateCoSimulation"](
                *texts, where, False, True, False, False, None, 0, None, self.log.callback, None
            )
        else:
            self.instance = library["InstantiateModelExchange"](*texts, where, False, True, None, self.log.callback)
        self.head[Head.FUNCTION] = 0
        if not self.instance:
            raise CallError("error", "Instantiate", "returned no instance", log=self.log.taken())

    def free(self) -> None:
        """Free the instance."""
        if self.instance:
            instance, self.instance = self.instance, None
            self.head[Head.FUNCTION] = NUMBER["FreeInstance"]
            self.library.free(instance)
            self.head[Head.FUNCTION] = 0

    def call(self, shown: str, name: str, *arguments: Any) -> None:
        """Call a function with the instance and arguments; ``shown``: its name for people. Raises CallError."""
        if not self.instance:
            raise CallError("refused", shown, "there is no instance")
        function: Callable[..., int] = self.library[name]
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
        kind = {2: "discard", 4: "fatal"}.get(status, "error")
        word = self.library.prefix + STATUS[status] if 0 <= status < len(STATUS) else f"status {status}"
        raise CallError(kind, function, f"returned {word}", log=self.log.taken())

    # -- values --------------------------------------------------------------------------------------------------------

    def type_of(self, kind: str) -> tuple[str, Any]:
        """Return the word in function names and the type of C."""
        if kind not in self.types:
            raise CallError("refused", "Set", f"variables of type {kind} are not supported")
        return self.types[kind]

    def get(self, run: Mapping[str, Any]) -> list[Any]:
        """Return the values of a run of variables (see runs.py)."""
        word, ctype = self.type_of(run["type"])
        of, values = references(run["refs"]), (ctype * run["n"])()
        arguments = (address(of), len(of), address(values))
        self.call("Get", "Get" + word, *arguments, *(() if self.two else (run["n"],)))
        found = [v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in values]
        found = [bool(v) for v in found] if run["type"] == "Boolean" else found
        return found if run["index"] is None else [found[k] for k in run["index"]]

    def set(self, run: Mapping[str, Any], numbers: Sequence[Any]) -> None:
        """Set the values of a run of variables; of an array that is set in part, the rest is kept."""
        word, ctype = self.type_of(run["type"])
        values = list(numbers)
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
        of, data = references(run["refs"]), (ctype * run["n"])(*values)
        arguments = (address(of), len(of), address(data))
        self.call("Set", "Set" + word, *arguments, *(() if self.two else (run["n"],)))


def references(numbers: Sequence[int]) -> Any:
    """Return value references as C wants them."""
    return (ctypes.c_uint32 * len(numbers))(*numbers)


def address(data: Any) -> int:
    """Return where an object of C lies."""
    return ctypes.addressof(data)


def whole(number: int, ctype: Any) -> int:
    """Return a whole number that fits the type. Raises CallError: C would wrap it without a word."""
    bits = 8 * ctypes.sizeof(ctype)
    signed = ctype(-1).value < 0
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    if not low <= number <= high:
        raise CallError("refused", "Set", f"{number} does not fit into {bits} bits")
    return number
