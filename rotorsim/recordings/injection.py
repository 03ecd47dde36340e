"""Recordings of loops into which a test signal was injected: the test signal, and the signal before and after it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from rotorsim.diagram.parse.source import JsonPath
from rotorsim.recordings.document import (
    EXAMPLES,
    RECORDING_KEYS,
    REQUIRED,
    DocumentParser,
    parse_recording,
    read_source,
)
from rotorsim.recordings.loading import read_samples
from rotorsim.recordings.recording import ANGLE, TACHO, Channel, Recording
from rotorsim.units import compatible

TEST, BEFORE, AFTER = ROLES = ("test", "before", "after")  # E, V2 and V1 of ISO 14839-3: V1 = V2 + E
INJECTION_KEYS: dict[str, Mapping[str, type]] = {
    "recording": RECORDING_KEYS["recording"],
    "channel": {"signal": str, "axis": str, "node": int, "unit": str, "injection": str},
    "run": {key: kind for key, kind in RECORDING_KEYS["run"].items() if key != "use"},
}
_EXAMPLES = {
    **EXAMPLES,
    "signal": '"signal": "controller.displacement": the port at which it is injected',
    "channels": '"channels": {"e": {"signal": "controller.displacement[1]", "injection": "test", "unit": "um"}, ...}',
}


@dataclass(frozen=True)
class InjectionChannel(Channel):
    """A column, and what it is of the loop: "test", "before" or "after"; None: it measures the shaft angle."""

    role: str | None = None

    @property
    def label(self) -> str:
        """What is measured, in words."""
        return self.name if self.role is None else f"'{self.role}' at {self.name}"


@dataclass(frozen=True, eq=False)
class InjectionRecording(Recording):
    """A folder of runs; in each a test signal E is added to some signals V2, and V1 = V2 + E goes on."""

    @property
    def loops(self) -> dict[str, dict[str, str]]:
        """Entry of a port at which a test signal is injected -> "test", "before", "after" -> column."""
        found: dict[str, dict[str, str]] = {}
        for column, channel in self.channels.items():
            if isinstance(channel, InjectionChannel) and channel.role is not None:
                found.setdefault(channel.name, {})[channel.role] = column
        return found


def port_of(entry: str) -> str:
    """Return the port of an entry: ``controller.displacement`` of ``controller.displacement[1]``."""
    return entry.partition("[")[0]


def load_injection(path: str | Path) -> InjectionRecording:
    """Read a recording of kind "injection": ``path`` is its folder or its recording.json.

    Raises RotorsimError with every mistake of recording.json, or else of all data files.
    """
    source, folder = read_source(path)
    recording = read_samples(parse_recording(source, folder, parser_class=InjectionParser))
    return InjectionRecording(*(getattr(recording, name) for name in recording.__dataclass_fields__))


class InjectionParser(DocumentParser):
    """Checks a recording.json of kind "injection"."""

    kind: ClassVar[str] = "injection"
    keys: ClassVar[Mapping[str, Mapping[str, type]]] = INJECTION_KEYS
    required: ClassVar[Mapping[str, tuple[str, ...]]] = {**REQUIRED, "recording": (*REQUIRED["recording"], "kind")}
    examples: ClassVar[Mapping[str, str]] = _EXAMPLES

    def channel(self, column: str, entry: Any) -> InjectionChannel | None:
        base = super().channel(column, entry)
        if base is None:
            return None
        path: JsonPath = ("channels", column)
        role = self.choice(entry, "injection", ROLES, path, f"channel {column}")
        turns = base.signal in (ANGLE, TACHO)
        if "injection" not in entry and not turns:
            hint = '"test": what is injected; "before" and "after": the signal that it is added to, and the sum'
            self.error("key 'injection' is missing", path, f"channel {column}", hint)
        elif turns and "injection" in entry:
            what = f"nothing is injected into '{base.signal}'"
            self.error(what, (*path, "injection"), f"channel {column}", key=True)
        return InjectionChannel(**vars(base), role=role)

    def channels(self, data: dict[str, Any]) -> dict[str, Channel]:
        found = super().channels(data)
        if len(found) < len(data):
            return found
        loops: dict[str, dict[str, Channel]] = {}
        for channel in found.values():
            if isinstance(channel, InjectionChannel) and channel.role is not None:
                loops.setdefault(channel.name, {})[channel.role] = channel
        if data and not loops:
            self.error("no channel of an injection", ("channels",), "channels", _EXAMPLES["channels"])
        for name, roles in loops.items():
            first, *others = roles.values()
            if not others:
                hint = "two of 'test', 'before' and 'after' are needed; the third is their difference"
                self.error(f"only one channel at {name}", ("channels", first.column), "channels", hint, key=True)
            for other in others:
                self._one_unit(first, other)
        return found

    def _one_unit(self, first: Channel, other: Channel) -> None:
        if compatible(first.unit, other.unit) in ("same", "scaled"):
            return
        what = f"'{other.unit}' does not fit '{first.unit}' of '{first.column}', to which it is added"
        self.error(what, ("channels", other.column, "unit"), f"channel {other.column}", "give both in one unit")
