"""Compile the sources of an FMU for one platform or several: the compiler of this machine, or ziglang's."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.fmi.description.platforms import this_platform
from rotorsim.model.emit.toolchain import (
    FLAGS,
    Compiler,
    CompilerError,
    cached,
    find_compiler,
    keep,
    run_compiler,
    scratch_folder,
)

__all__ = ["PLATFORMS", "Platform", "build_library", "find_platforms", "format_of", "own_platform"]


@dataclass(frozen=True)
class Platform:
    """A platform: its tuple in FMI 3 and folder in FMI 2, the suffix of libraries, the target of ziglang."""

    name: str
    fmi2: str
    suffix: str
    target: str

    def folder(self, version: str) -> str:
        """Return the folder in ``binaries``."""
        return self.fmi2 if version == "2.0" else self.name


# FMI 2 has names for x86 only; other processors go by their tuple there as well.
PLATFORMS = {
    platform.name: platform
    for platform in (
        Platform("x86_64-linux", "linux64", ".so", "x86_64-linux-gnu.2.17"),
        Platform("aarch64-linux", "aarch64-linux", ".so", "aarch64-linux-gnu.2.17"),
        Platform("x86_64-windows", "win64", ".dll", "x86_64-windows-gnu"),
        Platform("aarch64-windows", "aarch64-windows", ".dll", "aarch64-windows-gnu"),
        Platform("x86_64-darwin", "darwin64", ".dylib", "x86_64-macos"),
        Platform("aarch64-darwin", "aarch64-darwin", ".dylib", "aarch64-macos"),
    )
}
_NAMES = {**PLATFORMS, **{platform.fmi2: platform for platform in PLATFORMS.values()}}


def own_platform() -> Platform | None:
    """Return the platform of this process, or None when it is none that FMUs are made for."""
    return PLATFORMS.get(this_platform())


def find_platforms(names: Iterable[str] | None) -> list[Platform]:
    """Return platforms by name (``x86_64-linux`` or ``linux64``); None: this one. Raises RotorsimError."""
    if names is None:
        here = own_platform()
        if here is None:
            what = f"no FMU can be built for this machine ({this_platform()})"
            raise RotorsimError(Problem(what, hint="name platforms; they need the package ziglang"))
        return [here]
    wanted = list(dict.fromkeys(names))
    problems = [
        Problem("unknown platform", name, hint=near_miss(name, _NAMES)) for name in wanted if name not in _NAMES
    ]
    if problems:
        raise RotorsimError(*problems)
    return list(dict.fromkeys(_NAMES[name] for name in wanted))


def format_of(library: bytes) -> str:
    """Return the platform that the head of a library says it is for, as FMI 3 names it ("" if unknown)."""
    if library[:5] == b"\x7fELF\x02":
        return {0x3E: "x86_64-linux", 0xB7: "aarch64-linux"}.get(int.from_bytes(library[18:20], "little"), "")
    if library[:4] == b"\xcf\xfa\xed\xfe":
        return {7: "x86_64-darwin", 12: "aarch64-darwin"}.get(library[4], "")
    at = int.from_bytes(library[60:64], "little")
    if library[:2] == b"MZ" and library[at : at + 4] == b"PE\0\0":
        machine = int.from_bytes(library[at + 4 : at + 6], "little")
        return {0x8664: "x86_64-windows", 0xAA64: "aarch64-windows"}.get(machine, "")
    return ""


def _compiler_for(platform: Platform) -> Compiler:
    here = own_platform()
    own = find_compiler()
    if platform == here and own is not None:
        return own
    if importlib.util.find_spec("ziglang") is not None:
        return Compiler((sys.executable, "-m", "ziglang", "cc"), "ziglang")
    what = "there is no C compiler" if platform == here else "building for another platform needs ziglang"
    raise RotorsimError(Problem(what, platform.name, hint="pip install ziglang (411 MB), or --platform source"))


def compiler_options(platform: Platform, compiler: Compiler, optimise: str) -> list[str]:
    """Return the options: those of a run in process, so that one machine gives the same numbers to the last bit."""
    options = [*FLAGS, optimise, "-fvisibility=hidden"]
    if compiler.name != "ziglang":
        return options
    if platform.suffix == ".dll":
        options.remove("-fPIC")
    return ["-target", platform.target, *options, "-s"]


def build_library(sources: Mapping[str, bytes], platform: Platform, optimise: str) -> bytes:
    """Compile the first source file and return the library; libraries are kept in the cache by content.

    Raises RotorsimError with what the compiler said.
    """
    compiler = _compiler_for(platform)
    options = compiler_options(platform, compiler, optimise)
    digest = hashlib.sha256("\0".join([compiler.identity(), *options]).encode())
    for name, text in sources.items():
        digest.update(name.encode() + b"\0" + text + b"\0")
    key = f"fmu-{digest.hexdigest()[:32]}"
    kept = cached(key, platform.suffix)
    if kept is not None:
        return kept.read_bytes()
    with scratch_folder() as folder:
        library = _compile(Path(folder), sources, [*compiler.command, *options], platform)
    keep(library, key, platform.suffix)
    return library


def _compile(folder: Path, sources: Mapping[str, bytes], command: list[str], platform: Platform) -> bytes:
    for name, text in sources.items():
        (folder / name).write_bytes(text)
    target = folder / f"library{platform.suffix}"
    command = [*command, "-o", str(target), str(folder / next(iter(sources)))]
    if platform.suffix != ".dll":
        command.append("-lm")
    try:
        run_compiler(command, platform.name)
        library = target.read_bytes()
    except CompilerError as failure:
        raise RotorsimError(*(replace(problem, hint="") for problem in failure.problems), exit_code=1) from None
    except FileNotFoundError:
        raise RotorsimError(Problem("the C compiler wrote no library", platform.name), exit_code=1) from None
    if format_of(library) != platform.name:
        what = f"the compiler made a library for {format_of(library) or 'another platform'}"
        raise RotorsimError(Problem(what, platform.name), exit_code=1)
    return library
