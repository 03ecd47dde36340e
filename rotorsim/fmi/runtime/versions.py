"""What the versions of FMI do differently, as one interface: `Calls`."""

from __future__ import annotations

import contextlib
import ctypes
from typing import Any

from rotorsim.fmi.runtime.binding import CallError
from rotorsim.fmi.runtime.calls import Calls, address, optional
from rotorsim.fmi.runtime.fmi1 import ModelCalls1, SlaveCalls1
from rotorsim.fmi.runtime.memory import Block, Head, Said

_FLAGS = ("needed", "terminate", "nominals", "states", "defined")
_STATE_VERBS = ("Get", "Set", "Free", "Serialize")


def make_calls(block: Block, path: str, version: str, kind: str) -> Calls:
    """Return the calls of an FMU of a version, as "cs" or "me"; its library is loaded. Raises CallError."""
    return _calls_of(version, kind)(block, path, version, kind)


def function_name(version: str, kind: str, function: str) -> str:
    """Return what a version calls a function of `FUNCTIONS`."""
    prefix = "fmi" if version == "1.0" else f"fmi{version[0]}"
    return prefix + (_calls_of(version, kind).names.get(function) or function)


def _calls_of(version: str, kind: str) -> type[Calls]:
    if version == "1.0":
        return SlaveCalls1 if kind == "cs" else ModelCalls1
    return Calls2 if version == "2.0" else Calls3


class Calls2(Calls):
    """FMI 2.0."""

    names = {
        **{f"{verb}FMUState": f"{verb}FMUstate" for verb in _STATE_VERBS},
        "SerializedFMUStateSize": "SerializedFMUstateSize",
        "DeserializeFMUState": "DeSerializeFMUstate",
        "GetOutputDerivatives": "GetRealOutputDerivatives",
        "SetInputDerivatives": "SetRealInputDerivatives",
    }
    boolean = ctypes.c_int

    class _Info(ctypes.Structure):
        _fields_ = [*((name, ctypes.c_int) for name in _FLAGS), ("time", ctypes.c_double)]

    def create(self, name: bytes, token: bytes, resources: bytes | None) -> int | None:
        callbacks = ctypes.addressof(self.log.struct)
        instance: int | None = self.library["Instantiate"](
            name, int(self.kind == "cs"), token, resources, callbacks, 0, 1
        )
        return instance

    def initialise(self, start: float, stop: float | None, tolerance: float | None, n_x: int, n_z: int) -> None:
        self.call("SetupExperiment", *optional(tolerance), start, *optional(stop))
        self.call("EnterInitializationMode")

    def update_discrete_states(self) -> Any:
        info = self._Info()
        self.call("NewDiscreteStates", address(info))
        return info

    def reached(self) -> float | None:
        time, ended, last = ctypes.c_double(), ctypes.c_int(), None
        with contextlib.suppress(CallError):
            if self.library["GetBooleanStatus"](self.instance, 3, address(ended)) == 0 and ended.value:
                self.head[Head.SAID] = Said.TERMINATE
            if self.library["GetRealStatus"](self.instance, 2, address(time)) == 0:
                last = time.value
        return last


class Calls3(Calls):
    """FMI 3.0."""

    names = {"GetDerivatives": "GetContinuousStateDerivatives", "NewDiscreteStates": "UpdateDiscreteStates"}
    boolean = ctypes.c_bool

    class _Info(ctypes.Structure):
        _fields_ = [*((name, ctypes.c_bool) for name in _FLAGS), ("time", ctypes.c_double)]

    _OFFSETS = (0, 1, 2, 3, 4, 8)  # of the fields of _Info

    def create(self, name: bytes, token: bytes, resources: bytes | None) -> int | None:
        instance: int | None
        if self.kind == "cs":
            instance = self.library["InstantiateCoSimulation"](
                name, token, resources, False, True, False, False, None, 0, None, self.log.callback, None
            )
        else:
            instance = self.library["InstantiateModelExchange"](
                name, token, resources, False, True, None, self.log.callback
            )
        return instance

    def initialise(self, start: float, stop: float | None, tolerance: float | None, n_x: int, n_z: int) -> None:
        self.call("EnterInitializationMode", *optional(tolerance), start, *optional(stop))
        counts = {"GetNumberOfContinuousStates": n_x, "GetNumberOfEventIndicators": n_z}
        for name, described in counts.items() if self.kind == "me" else ():
            count = ctypes.c_size_t()
            self.call("-", address(count), name=name)
            if count.value != described:
                raise CallError("error", name, f"says {count.value}, its model description says {described}")

    def sized(self, *arrays: tuple[int, int]) -> tuple[int, ...]:
        return tuple(argument for array in arrays for argument in array)

    def update_discrete_states(self) -> Any:
        info = self._Info()
        self.call("NewDiscreteStates", *(address(info) + offset for offset in self._OFFSETS))
        return info

    def step_results(self, flags: int) -> tuple[int, ...]:
        return (*(flags + k for k in range(3)), self.block.at(Block.LAST))

    def reached(self) -> float | None:
        last: float = self.block.numbers[Block.LAST]
        return last
