"""Platforms of FMUs: folders of binaries, and which of them fits this machine."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.fmi.description.model import ModelDescription

__all__ = [
    "SUFFIXES",
    "binary_kind",
    "find_library",
    "folders",
    "library_names",
    "platform_of",
    "platforms_inside",
    "this_platform",
]

_PROCESSORS = {
    "x86_64": "x86_64",
    "amd64": "x86_64",
    "i386": "x86",
    "i686": "x86",
    "x86": "x86",
    "aarch64": "aarch64",
    "arm64": "aarch64",
}
_SYSTEMS = {"linux": "linux", "win32": "windows", "darwin": "darwin"}
_OLD = {
    "x86_64-linux": "linux64",
    "x86-linux": "linux32",
    "x86_64-windows": "win64",
    "x86-windows": "win32",
    "x86_64-darwin": "darwin64",
}
SUFFIXES = {"linux": ".so", "windows": ".dll", "darwin": ".dylib"}


def this_platform() -> str:
    """Return the platform of this Python as FMI 3.0 names it, for example x86_64-linux."""
    machine = platform.machine().lower()
    processor = _PROCESSORS.get(machine, machine)
    if processor == "x86_64" and sys.maxsize <= 2**32:
        processor = "x86"
    return f"{processor}-{_SYSTEMS.get(sys.platform, sys.platform)}"


def folders(version: str) -> tuple[str, ...]:
    """Return the folders under binaries/ that are of this machine, the best first.

    FMI 2.0 has names for x86 only; FMUs for other processors use those of FMI 3.0.
    """
    name = this_platform()
    old = (_OLD[name],) if name in _OLD else ()
    return (*old, name) if version == "2.0" else (name,)


def platforms_inside(description: ModelDescription, names: Iterable[str]) -> ModelDescription:
    """Return the description with the platforms for which an archive holds the libraries it names."""
    found: dict[str, None] = {}
    wanted = {kind.identifier for kind in description.kinds.values()}
    for name in names:
        parts = name.split("/")
        if len(parts) == 3 and parts[0] == "binaries" and parts[2].rpartition(".")[0] in wanted:
            found[parts[1]] = None
    return replace(description, platforms=tuple(sorted(found)))


def library_names(description: ModelDescription, kind: str) -> list[str]:
    """Return the paths in the archive at which the library for this machine may be."""
    suffix = SUFFIXES.get(_SYSTEMS.get(sys.platform, ""), ".so")
    identifier = description.kinds[kind].identifier
    return [f"binaries/{folder}/{identifier}{suffix}" for folder in folders(description.version)]


def find_library(description: ModelDescription, kind: str, folder: Path) -> Path:
    """Return the library for this machine. Raises RotorsimError that says which platforms are inside."""
    names = library_names(description, kind)
    for name in names:
        path = folder / name
        if path.is_file():
            return path
    inside = ", ".join(description.platforms) if description.platforms else "none"
    what = f"holds no library for this platform ({this_platform()}): {names[0]} is not there"
    hint = f"platforms inside: {inside}"
    if not description.platforms and (folder / "binaries").is_dir():
        hint += f"; the library must be named after the modelIdentifier {description.kinds[kind].identifier}"
    raise RotorsimError(Problem(what, description.name, Place(description.place.file), hint))


def platform_of(folder: str) -> str:
    """Return the platform of a folder as FMI 3.0 names it, "" for a folder of no platform that we know."""
    new = {old: name for name, old in _OLD.items()} | {"darwin32": "x86-darwin"}
    if folder in new:
        return new[folder]
    processor, _, system = folder.partition("-")
    return folder if processor in _PROCESSORS.values() and system in SUFFIXES else ""


def binary_kind(start: bytes) -> str:
    """Return the platform for which a library is made, from its first bytes; "" if it is none that we know.

    Of a macOS library for several processors, the platform of its first.
    """
    machine = 0
    if start[:4] == b"\x7fELF" and len(start) >= 20:
        machine = int.from_bytes(start[18:20], "little")
        return _named({62: "x86_64", 3: "x86", 183: "aarch64"}, machine, "linux")
    if start[:2] == b"MZ" and len(start) >= 64:
        at = int.from_bytes(start[60:64], "little")
        if start[at : at + 4] == b"PE\0\0":
            machine = int.from_bytes(start[at + 4 : at + 6], "little")
        return _named({0x8664: "x86_64", 0x14C: "x86", 0xAA64: "aarch64"}, machine, "windows")
    if start[:4] in (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe"):
        machine = int.from_bytes(start[4:8], "little")
    elif start[:4] == b"\xca\xfe\xba\xbe":
        machine = int.from_bytes(start[8:12], "big")
    return _named({0x01000007: "x86_64", 7: "x86", 0x0100000C: "aarch64"}, machine, "darwin")


def _named(processors: dict[int, str], machine: int, system: str) -> str:
    return f"{processors[machine]}-{system}" if machine in processors else ""
