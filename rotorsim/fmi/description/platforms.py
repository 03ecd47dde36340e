"""Platforms of FMUs: folders of binaries, and which of them fits this machine."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.fmi.description.model import ModelDescription

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
_MACHINES = {
    ("linux", 62): "x86_64",
    ("linux", 3): "x86",
    ("linux", 183): "aarch64",
    ("windows", 0x8664): "x86_64",
    ("windows", 0x14C): "x86",
    ("windows", 0xAA64): "aarch64",
    ("darwin", 0x01000007): "x86_64",
    ("darwin", 7): "x86",
    ("darwin", 0x0100000C): "aarch64",
}


def this_platform() -> str:
    """Return the platform of this Python as FMI 3.0 names it, for example x86_64-linux."""
    machine = platform.machine().lower()
    processor = _PROCESSORS.get(machine, machine)
    if processor == "x86_64" and sys.maxsize <= 2**32:
        processor = "x86"
    return f"{processor}-{_SYSTEMS.get(sys.platform, sys.platform)}"


def library_folder(platform: str, version: str) -> str:
    """Return the folder under binaries/. Before FMI 3.0 there are names for x86 only; others go by those of 3.0."""
    return platform if version == "3.0" else _OLD.get(platform, platform)


def folders(version: str) -> tuple[str, ...]:
    """Return the folders under binaries/ that are of this machine, the best first."""
    name = this_platform()
    return tuple(dict.fromkeys((library_folder(name, version), name)))


def platforms_inside(description: ModelDescription, names: Iterable[str]) -> ModelDescription:
    """Return the description with the platforms for which an archive holds the libraries it names."""
    wanted = {kind.identifier for kind in description.kinds.values()}
    paths = (name.split("/") for name in names if name.startswith("binaries/"))
    inside = {path[1] for path in paths if len(path) == 3 and path[2].rpartition(".")[0] in wanted}
    return replace(description, platforms=tuple(sorted(inside)))


def find_library(description: ModelDescription, kind: str, folder: Path) -> Path:
    """Return the library for this machine. Raises RotorsimError that says which platforms are inside."""
    suffix = SUFFIXES.get(_SYSTEMS.get(sys.platform, ""), ".so")
    identifier = description.kinds[kind].identifier
    names = [f"binaries/{name}/{identifier}{suffix}" for name in folders(description.version)]
    path = next((folder / name for name in names if (folder / name).is_file()), None)
    if path is not None:
        return path
    what = f"holds no library for this platform ({this_platform()}): {names[0]} is not there"
    hint = f"platforms inside: {', '.join(description.platforms) or 'none'}"
    if not description.platforms and (folder / "binaries").is_dir():
        hint += f"; the library must be named after the modelIdentifier {identifier}"
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
    system, field = "", b""
    if start[:4] == b"\x7fELF":
        system, field = "linux", start[18:20]
    elif start[:2] == b"MZ":
        header = start[int.from_bytes(start[60:64], "little") :]
        system, field = "windows", header[4:6] if header[:4] == b"PE\0\0" else b""
    elif start[:4] in (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe"):
        system, field = "darwin", start[4:8]
    elif start[:4] == b"\xca\xfe\xba\xbe":
        system, field = "darwin", start[11:7:-1]
    processor = _MACHINES.get((system, int.from_bytes(field, "little")))
    return f"{processor}-{system}" if processor else ""
