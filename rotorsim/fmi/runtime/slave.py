"""FMUs of FMI 1.0, 2.0 and 3.0 as Python objects: one interface for all, in this process or in one of their own.

with open_fmu("controller.fmu") as fmu:
    slave = fmu.instantiate("cs")
    slave.setup(0.0, 1.0, parameters={"KP": 14000.0}, inputs=["displacement[1]"], outputs=["current[1]"])
    y = slave.exchange(np.array([1e-5]), t=0.0, h=1e-4)

A file is described without being unpacked, and opened in a temporary folder that is removed again.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from rotorsim.errors import Problem, RotorsimError
from rotorsim.files import sweep, temporary_prefix
from rotorsim.fmi.description.archive import Archive, Limits
from rotorsim.fmi.description.model import ModelDescription
from rotorsim.fmi.description.platforms import find_library, platforms_inside
from rotorsim.fmi.description.reader import read_description
from rotorsim.fmi.runtime.exchange import EventUpdate, Slave
from rotorsim.fmi.runtime.guard import guard_exit
from rotorsim.fmi.runtime.instance import Log
from rotorsim.fmi.runtime.memory import Sizes
from rotorsim.fmi.runtime.process import LocalWorker, RemoteWorker

__all__ = [
    "MAX_DESCRIPTION",
    "MEMORY",
    "TIMEOUT",
    "EventUpdate",
    "Fmu",
    "Slave",
    "describe",
    "describe_fmu",
    "open_fmu",
]

TIMEOUT = 10.0  # s, for one answer of an FMU
MEMORY = 4 << 30  # bytes of address space of its process
MAX_DESCRIPTION = 64 << 20  # bytes of modelDescription.xml
_UNUSED = ("sources/", "documentation/")
_ONCE: set[tuple[str, str]] = set()  # FMUs at work in this process that allow one instance only
_INPUT_ORDER = 2  # highest derivative of inputs that is handed over


def describe_fmu(
    path: str | Path, *, limits: Limits | None = None, sizes: Mapping[str, int] | None = None
) -> ModelDescription:
    """Return the model description of an FMU; nothing is unpacked. Raises RotorsimError with every mistake."""
    with Archive(path, limits) as archive:
        return describe(archive, str(path), sizes)


def open_fmu(
    path: str | Path,
    *,
    in_process: bool = False,
    timeout: float = TIMEOUT,
    memory: int | None = MEMORY,
    log: Log | None = None,
    limits: Limits | None = None,
    sizes: Mapping[str, int] | None = None,
) -> Fmu:
    """Return an FMU, to be used in a with statement.

    in_process: load its library into this process: faster, but a crash of it is one of ours, and there are no limits
    of time and memory. timeout: for one answer [s]; memory: address space of its process [bytes], None: no limit.
    log: gets every message of the FMU (status, category, message); without it only errors show them.
    sizes: values of structural parameters (FMI 3.0), which give arrays their shapes.
    Raises RotorsimError.
    """
    with Archive(path, limits) as archive:
        description = describe(archive, str(path), sizes)
    return Fmu(Path(path), description, in_process, timeout, memory, log, limits)


def describe(archive: Archive, shown: str, sizes: Mapping[str, int] | None = None) -> ModelDescription:
    """Return the model description in an open archive, with the warnings of both."""
    data = archive.read("modelDescription.xml", MAX_DESCRIPTION)
    description = read_description(data, f"{shown}/modelDescription.xml", sizes=sizes)
    described = platforms_inside(description, archive.names)
    return replace(described, warnings=(*archive.warnings, *described.warnings))


class Fmu(AbstractContextManager["Fmu"]):
    """An FMU file: its description, and its instances. Unpacked when first instantiated; a context manager."""

    def __init__(
        self,
        path: Path,
        description: ModelDescription,
        in_process: bool,
        timeout: float,
        memory: int | None,
        log: Log | None,
        limits: Limits | None,
    ) -> None:
        self.path, self.description = path, description
        self.in_process, self.timeout, self.memory, self.log, self.limits = in_process, timeout, memory, log, limits
        self.folder: Path | None = None
        self._slaves: weakref.WeakSet[Slave] = weakref.WeakSet()
        self._finalizer: weakref.finalize[..., Fmu] | None = None

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Free the instances; remove the unpacked files."""
        for slave in list(self._slaves):
            slave.free()
        if self._finalizer:
            self._finalizer()
        self.folder = None

    def instantiate(self, kind: str = "cs", instance: str = "") -> Slave:
        """Return an instance for Co-Simulation ("cs") or Model Exchange ("me"). Raises RotorsimError."""
        description = self.description
        chosen = description.kind(kind)
        clocks = ", ".join(description.clocks[:5])
        ticking = [name for name in description.clocks if description.variables[name].causality == "input"]
        own = {(chosen.identifier, description.token)} if self.in_process and chosen.once_per_process else set()
        hint = "let it run in a process of its own (the default), or free the other instance first"
        shown = ", ".join([*ticking[:5], *(["..."] if len(ticking) > 5 else [])])
        driven = f": it is driven by clocks ({clocks})" if clocks else ""
        reasons = {
            f"Scheduled Execution is not supported{driven}": kind == "se",
            "leaves its work to a tool (CoSimulation_Tool), which is not supported": description.is_tool_coupling,
            f"has clocks as inputs, which are not supported: {shown}": ticking,
            "allows one instance in a process, and there is one already": own & _ONCE,
        }
        what = next((what for what, is_so in reasons.items() if is_so), "")
        if what:
            raise RotorsimError(Problem(what, description.name, description.place, hint if own & _ONCE else ""))
        _ONCE.update(own)
        try:
            return self._instantiate(kind, instance or description.name, lambda: _ONCE.difference_update(own))
        except BaseException:
            _ONCE.difference_update(own)
            raise

    def _instantiate(self, kind: str, instance: str, released: Callable[[], None]) -> Slave:
        description, folder = self.description, self._unpacked()
        library = find_library(description, kind, folder)
        sizes = Sizes(
            sum(v.size for v in description.variables.values()),
            len(description.states),
            description.n_events,
            _INPUT_ORDER if description.kinds[kind].can_interpolate_inputs else 0,
        )
        if self.in_process:
            guard_exit(str(self.path))
        worker = (
            LocalWorker(sizes) if self.in_process else RemoteWorker(sizes, folder, library, self.timeout, self.memory)
        )
        resources = folder / "resources"
        where = resources.as_uri() if description.version == "2.0" else f"{resources}/" if resources.is_dir() else None
        wanted = [c for c in description.log_categories if c.startswith("logStatus")] if self.log is None else []
        slave = Slave(description, worker, kind, instance, str(self.path), self.log, released)
        slave.owner = self
        try:
            slave.command(
                "instantiate",
                path=str(library),
                version=description.version,
                kind=kind,
                name=instance,
                token=description.token,
                resources=where,
                n_x=sizes.n_x,
                n_z=sizes.n_z,
                categories=wanted,
            )
        except BaseException:
            slave.free()
            raise
        self._slaves.add(slave)
        return slave

    def _unpacked(self) -> Path:
        if self.folder is None:
            sweep(tempfile.gettempdir(), "rotorsim-fmu-")
            folder = Path(tempfile.mkdtemp(prefix=temporary_prefix("rotorsim-fmu-"))).resolve()
            self._finalizer = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            try:
                with Archive(self.path, self.limits) as archive:
                    archive.unpack(folder, lambda name: not name.startswith(_UNUSED))
            except BaseException:
                self._finalizer()
                raise
            self.folder = folder
        return self.folder
