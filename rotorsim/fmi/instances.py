"""Instances of an FMU for Model Exchange with values of its inputs and parameters, initialised.

An instance that is not needed any more is reset and initialised anew, if that once gave what a new one gives: a process
of its own takes some tenths of a second to start, and in this process some FMUs keep something of every instance (those
of OpenModelica a key of the thread, of which there are 1024: what came after some hundred fits failed).
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.model import ModelDescription
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.slave import Fmu, Slave, open_fmu
from rotorsim.model.heard import remark

SHOWN = 5  # values in a message


class Values:
    """Values of the entries of ports (`rotorsim.fmi.block.FmuPort`), SI.

    names: entries; scales (n, 2): factor and offset, SI = factor * value of the FMU + offset; starts (n,): NaN where
    the FMU states none.
    """

    def __init__(self, ports: Sequence[Any]) -> None:
        self.names = [name for port in ports for name in port.entries]
        self.units = [port.unit if port.unit not in (None, "1") else "" for port in ports for _ in port.entries]
        self.scales = np.concatenate([np.zeros((0, 2)), *(port.scales for port in ports)])
        starts = [np.full(len(p.entries), np.nan) if p.start is None else np.ravel(p.start) for p in ports]
        self.starts = np.concatenate([np.zeros(0), *starts])

    def __len__(self) -> int:
        return len(self.names)

    def of_fmu(self, si: np.ndarray) -> np.ndarray:
        """Return values (n,) in the units of the FMU."""
        return np.asarray((si - self.scales[:, 1]) / self.scales[:, 0])

    def are_starts(self, si: np.ndarray) -> bool:
        """Return whether values (n,) are those that the FMU has by itself."""
        return not self.changed(si)

    def changed(self, si: np.ndarray) -> dict[str, Any]:
        """Return the values, in the units of the FMU, that are not the start values of variables."""
        rows = zip(self.names, si.tolist(), self.of_fmu(si).tolist(), self.starts.tolist(), strict=True)
        return {
            name: raw
            for name, value, raw, start in rows
            if value != start and not (np.isnan(start) and (np.isnan(value) or value == 0.0))
        }

    def words(self, si: np.ndarray, given: np.ndarray) -> str:
        """Return values (n,) in words: those that are not as given, else those that are not the start values."""
        changed = self.changed(si)
        moved = np.flatnonzero((si != given) & ~(np.isnan(si) & np.isnan(given))).tolist()
        which = moved or [k for k, name in enumerate(self.names) if name in changed]
        shown = [f"{self.names[k]} = {si[k]:.9g} {self.units[k]}".rstrip() for k in which[:SHOWN]]
        return ", ".join([*shown, *(["..."] if len(which) > SHOWN else [])])


class Instances:
    """Makes instances of an FMU. texts: values of variables that are no numbers."""

    def __init__(
        self,
        name: str,
        path: Any,
        description: ModelDescription,
        in_process: bool,
        texts: Mapping[str, Any],
        inputs: Values,
        parameters: Values,
        outputs: Sequence[str],
        timeout: float,
    ) -> None:
        self.name, self.path, self.description, self.in_process = name, path, description, in_process
        self.texts, self.inputs, self.parameters, self.outputs = dict(texts), inputs, parameters, list(outputs)
        self.timeout = timeout
        self._fmu: Fmu | None = None
        self._resets: bool | None = None  # not tried yet

    def new(self, u: np.ndarray, p: np.ndarray) -> Slave:
        """Return a new instance with parameters p, initialised with inputs u."""
        if self._fmu is None:
            about: dict[str, Any] = {"in_process": self.in_process, "timeout": self.timeout}
            self._fmu = open_fmu(self.path, sizes=self.description.sizes, **about)
            weakref.finalize(self, self._fmu.close).atexit = False  # its processes see to that themselves
        slave = self._fmu.instantiate("me", self.name)
        try:
            self._set_up(slave, u, p)
        except BaseException:
            slave.free()
            raise
        return slave

    def close(self) -> None:
        """Remove the unpacked files; they are unpacked again when they are needed."""
        fmu, self._fmu = self._fmu, None
        if fmu is not None:
            fmu.close()

    def again(self, slave: Slave, u: np.ndarray, p: np.ndarray) -> Slave:
        """Return an instance in the place of one that is not needed: that one, reset, or a new one."""
        if self._resets is False:
            slave.free()
            return self.new(u, p)
        try:
            slave.free_states()
            slave.reset()
        except FmuError as error:
            slave.free()
            if error.kind in ("error", "discard"):
                self._is_made_anew("cannot be reset")
            return self.new(u, p)
        try:
            self._set_up(slave, u, p)
        except RotorsimError:
            slave.free()
            return self.new(u, p)  # it says what is wrong, if it is not the reset
        except BaseException:
            slave.free()
            raise
        return slave if self._resets else self._tried(slave, u, p)

    def _set_up(self, slave: Slave, u: np.ndarray, p: np.ndarray) -> None:
        given = self.parameters.changed(p) | self.inputs.changed(u) | self.texts
        slave.setup(0.0, None, None, parameters=given, inputs=self.inputs.names, outputs=self.outputs)

    def _tried(self, slave: Slave, u: np.ndarray, p: np.ndarray) -> Slave:
        """Return an instance that was reset for the first time, or the new one that says otherwise."""
        fresh = self.new(u, p)
        raw = self.inputs.of_fmu(np.nan_to_num(u))
        said = []
        with suppress(RotorsimError):
            said = [np.concatenate([one.states(), *one.evaluate(0.0, one.states(), raw)]) for one in (fresh, slave)]
        self._resets = len(said) == 2 and bool((said[0] == said[1]).all())
        if self._resets:
            fresh.free()
            return slave
        slave.free()
        self._is_made_anew("reset, it is not what a new instance is")
        return fresh

    def _is_made_anew(self, why: str) -> None:
        self._resets = False
        remark(self.name, f"{why}: it is instantiated anew for all values")
