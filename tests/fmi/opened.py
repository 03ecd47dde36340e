"""An exported FMU opened in FMPy's low-level classes, in the same words for FMI 2.0 and 3.0."""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Model, FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Model, FMU3Slave

Message = tuple[int, str, str]  # status, category, text


class Opened:
    """One instance. messages: what it logged."""

    def __init__(self, file: Path, folder: str, kind: str, name: str, log: bool) -> None:
        self.description = fmpy.read_model_description(str(file))
        self.two = self.description.fmiVersion == "2.0"
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.messages: list[Message] = []
        made: dict[tuple[bool, str], Callable[..., Any]] = {
            (True, "cs"): FMU2Slave,
            (True, "me"): FMU2Model,
            (False, "cs"): FMU3Slave,
            (False, "me"): FMU3Model,
        }
        interface = self.description.coSimulation if kind == "cs" else self.description.modelExchange
        self.fmu = made[self.two, kind](
            guid=self.description.guid,
            modelIdentifier=interface.modelIdentifier,
            unzipDirectory=folder,
            instanceName=name,
        )
        self.kind = kind
        if self.two:
            self.callbacks = fmi2CallbackFunctions()
            self.callbacks.logger = fmi2CallbackLoggerTYPE(self._log2)
            self.fmu.instantiate(callbacks=self.callbacks, loggingOn=log)
        else:
            self.fmu.instantiate(loggingOn=log, logMessage=self._log3)

    def _log2(self, environment: Any, name: bytes, status: int, category: bytes, text: bytes) -> None:
        self.messages.append((status, category.decode(), text.decode()))

    def _log3(self, environment: Any, status: int, category: bytes, text: bytes) -> None:
        self.messages.append((status, category.decode(), text.decode()))

    def references(self, names: Sequence[str]) -> list[int]:
        return [self.variables[name].valueReference for name in names]

    def get(self, *names: str, size: int | None = None) -> np.ndarray:
        vr = self.references(names)
        return np.array(self.fmu.getReal(vr) if self.two else self.fmu.getFloat64(vr, size))

    def set(self, **values: float) -> None:
        self.put(list(values), list(values.values()))

    def put(self, names: Sequence[str], values: Sequence[float]) -> None:
        (self.fmu.setReal if self.two else self.fmu.setFloat64)(self.references(names), list(values))

    def enter(self, start: float = 0.0, stop: float | None = None) -> None:
        if self.two:
            self.fmu.setupExperiment(startTime=start, stopTime=stop)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start, stopTime=stop)

    def leave(self) -> None:
        self.fmu.exitInitializationMode()

    def begin(self, start: float = 0.0, stop: float | None = None) -> None:
        self.enter(start, stop)
        self.leave()

    def step(self, time: float, size: float) -> None:
        self.fmu.doStep(time, size)

    def walk(self, names: Sequence[str], n: int, h: float, first: int = 0) -> np.ndarray:
        """Take n steps; return the variables before each and after the last, shape (n + 1, len(names))."""
        rows = [self.get(*names)]
        for k in range(first, first + n):
            self.step(k * h, h)
            rows.append(self.get(*names))
        return np.array(rows)

    def update(self) -> tuple[bool, float]:
        """Carry out an event; return whether there is a next one, and when."""
        info = self.fmu.newDiscreteStates() if self.two else self.fmu.updateDiscreteStates()
        return bool(info[4]), float(info[5])

    def vector(self, what: str, n: int) -> np.ndarray:
        """Return derivatives, states, nominals or event indicators."""
        names = {
            "derivatives": ("getDerivatives", "getContinuousStateDerivatives"),
            "states": ("getContinuousStates",) * 2,
            "nominals": ("getNominalsOfContinuousStates",) * 2,
            "events": ("getEventIndicators",) * 2,
        }
        out = np.zeros(n)
        getattr(self.fmu, names[what][0 if self.two else 1])(out.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), n)
        return out

    def set_states(self, x: np.ndarray) -> None:
        values = np.ascontiguousarray(x, float)
        self.fmu.setContinuousStates(values.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), len(values))


@contextmanager
def opened(file: Path, *kinds: str, log: bool = False) -> Iterator[Any]:
    """Give an instance of every kind named ("cs", "me"), freed at the end; one kind: the instance itself."""
    with tempfile.TemporaryDirectory() as folder:
        fmpy.extract(str(file), folder)
        instances = [Opened(file, folder, kind, f"instance{k}", log) for k, kind in enumerate(kinds)]
        try:
            yield instances[0] if len(instances) == 1 else instances
        finally:
            for instance in instances:
                instance.fmu.freeInstance()
