"""FMI 1.0 by FMPy's runtime (`fmpy.fmi1`), behind the interface of the later versions, `Calls`.

FMI 1.0 takes start values and inputs before its initialisation and gives outputs after it: it is initialised when a
value is read first, or where FMI 2.0 leaves its initialisation mode; there an instance that was read before is made
anew with the inputs that were found. There are no modes of events, no saved states and no directional derivatives.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rotorsim.fmi.runtime.binding import CallError
from rotorsim.fmi.runtime.calls import Calls, address, optional

_LAST_SUCCESSFUL_TIME = 2  # fmiStatusKind


class Library1:
    """The functions of a library, loaded and declared by FMPy."""

    prefix = "fmi"

    def __init__(self, path: str, kind: str) -> None:
        if "numpy" not in sys.modules:  # which FMPy loads; threads of it take of the memory that the FMU may have
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        from fmpy.fmi1 import FMU1Model, FMU1Slave

        file = Path(path)
        self._identifier = file.stem
        self._found: dict[str, Any] = {}
        made = FMU1Slave if kind == "cs" else FMU1Model
        unpacked = str(file.parents[2])  # above binaries/PLATFORM
        try:
            with contextlib.chdir("."):  # FMPy goes to the library, and stays there if it cannot be loaded
                self.fmu = made(
                    guid="", modelIdentifier=self._identifier, unzipDirectory=unpacked, libraryPath=str(file)
                )
        except Exception as error:
            what = str(error.__context__ or error).replace(f"{file.parent}{os.sep}", "")
            raise CallError("load", "load", what) from None

    def __getitem__(self, name: str) -> Any:
        function = self._found.get(name)
        if function is None:
            try:
                function = getattr(self.fmu.dll, f"{self._identifier}_fmi{name}")
            except AttributeError:
                raise CallError("load", "load", f"the library has no function fmi{name}") from None
            pointer: Any = ctypes._Pointer  # which may be given as an address
            function.argtypes = [ctypes.c_void_p if issubclass(own, pointer) else own for own in function.argtypes]
            function.restype = ctypes.c_int  # FMPy 0.3.32 takes statuses of Co-Simulation for texts
            self._found[name] = function
        return function


class Calls1(Calls):
    """FMI 1.0."""

    library: Library1

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.version = "2.0"  # whose arguments the functions have that are called from C

    def open(self, path: str, version: str) -> Library1:
        return Library1(path, self.kind)

    def function(self, name: str) -> Any:
        own = self.names.get(name, name)
        return self.library[own] if own else _nothing

    def instantiate(self, name: str, token: str, resources: str | None) -> None:
        self._given = name, token, resources
        super().instantiate(name, token, resources)

    def create(self, name: bytes, token: bytes, resources: bytes | None) -> int | None:
        from fmpy.fmi1 import fmi1CallbackFunctions

        fmu = self.library.fmu
        fmu.component, fmu.instanceName, fmu.guid = None, name.decode(), token.decode()
        with contextlib.suppress(Exception):  # FMPy's way to say that there is no instance
            fmu.instantiate(functions=fmi1CallbackFunctions.from_buffer(self.log.struct), loggingOn=True)
        instance: int | None = fmu.component
        return instance

    def reset(self) -> None:
        self.free()
        self.instantiate(*self._given)

    def get(self, run: Mapping[str, Any]) -> list[Any]:
        self.before_reading()
        return super().get(run)

    @property
    def is_settled(self) -> bool:
        return self.waiting is None

    def exit_initialisation(self) -> None:
        self.before_reading()


class SlaveCalls1(Calls1):
    """FMI 1.0 for Co-Simulation."""

    names = {
        "Instantiate": "InstantiateSlave",
        "EnterInitializationMode": "InitializeSlave",
        "Terminate": "TerminateSlave",
        "FreeInstance": "FreeSlaveInstance",
        "SetInputDerivatives": "SetRealInputDerivatives",
        "GetOutputDerivatives": "GetRealOutputDerivatives",
    }

    def initialise(self, start: float, stop: float | None, tolerance: float | None, n_x: int, n_z: int) -> None:
        self.waiting = lambda: self.call("EnterInitializationMode", start, *optional(stop))

    def reached(self) -> float | None:
        time = ctypes.c_double()
        status = self.library["GetRealStatus"](self.instance, _LAST_SUCCESSFUL_TIME, address(time))
        return time.value if status == 0 else None


class ModelCalls1(Calls1):
    """FMI 1.0 for Model Exchange."""

    completed_in_c = False
    names = {
        "Instantiate": "InstantiateModel",
        "EnterInitializationMode": "Initialize",
        "NewDiscreteStates": "EventUpdate",
        "GetNominalsOfContinuousStates": "GetNominalContinuousStates",
        "FreeInstance": "FreeModelInstance",
        "EnterEventMode": "",
        "EnterContinuousTimeMode": "",
    }

    def initialise(self, start: float, stop: float | None, tolerance: float | None, n_x: int, n_z: int) -> None:
        self._said: Any = None
        self.call("SetTime", start)
        self.waiting = lambda: self._tell("EnterInitializationMode", *optional(tolerance))

    def update_discrete_states(self) -> Any:
        if self._said is None:
            self._tell("NewDiscreteStates", 0)
        info, self._said = self._said, None
        return SimpleNamespace(
            needed=not _is_true(info.iterationConverged),
            terminate=_is_true(info.terminateSimulation),
            nominals=_is_true(info.stateValueReferencesChanged),
            states=_is_true(info.stateValuesChanged),
            defined=_is_true(info.upcomingTimeEvent),
            time=info.nextEventTime,
        )

    def _tell(self, function: str, *arguments: Any) -> None:
        """Call a function that says what an event changed."""
        from fmpy.fmi1 import fmi1EventInfo

        self._said = info = fmi1EventInfo()
        self.call(function, *arguments, address(info))

    def completed_step(self, unbound: int) -> tuple[bool, bool]:
        wants = ctypes.c_bool()
        self.call("CompletedIntegratorStep", address(wants))
        return wants.value, False


def _is_true(flag: bytes) -> bool:
    return flag != b"\0"


def _nothing(instance: int) -> int:
    """Stand for a function that FMI 1.0 has no need of."""
    return 0
