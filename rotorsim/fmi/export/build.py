"""Compile the sources of an FMU for one platform or several: the compiler of this machine, or ziglang's."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.fmi.description.platforms import SUFFIXES, binary_kind, library_folder, this_platform
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

# Platforms as FMI 3 names them, and the targets of ziglang.
TARGETS = {
    "x86_64-linux": "x86_64-linux-gnu.2.17",
    "aarch64-linux": "aarch64-linux-gnu.2.17",
    "x86_64-windows": "x86_64-windows-gnu",
    "aarch64-windows": "aarch64-windows-gnu",
    "x86_64-darwin": "x86_64-macos",
    "aarch64-darwin": "aarch64-macos",
}


def suffix_of(platform: str) -> str:
    """Return the end of the names of libraries."""
    return SUFFIXES[platform.partition("-")[2]]


def find_platforms(names: Iterable[str] | None) -> list[str]:
    """Return platforms by name (``x86_64-linux`` or ``linux64``); None: this one. Raises RotorsimError."""
    if names is None and this_platform() not in TARGETS:
        what = f"no FMU can be built for this machine ({this_platform()})"
        raise RotorsimError(Problem(what, hint="name platforms; they need the package ziglang"))
    wanted = [this_platform()] if names is None else list(names)
    known = {name: platform for platform in TARGETS for name in (platform, library_folder(platform, "2.0"))}
    problems = [Problem("unknown platform", name, hint=near_miss(name, known)) for name in wanted if name not in known]
    if problems:
        raise RotorsimError(*dict.fromkeys(problems))
    return list(dict.fromkeys(known[name] for name in wanted))


def _compiler_for(platform: str) -> Compiler:
    own = find_compiler() if platform == this_platform() else None
    if own is not None:
        return own
    if importlib.util.find_spec("ziglang") is not None:
        return Compiler((sys.executable, "-m", "ziglang", "cc"), "ziglang")
    here = platform == this_platform()
    what = "there is no C compiler" if here else "building for another platform needs ziglang"
    raise RotorsimError(Problem(what, platform, hint="pip install ziglang (411 MB), or --platform source"))


def _options(platform: str, compiler: Compiler, optimise: str) -> list[str]:
    """Return the options: those of a run in process, so that one machine gives the same numbers to the last bit."""
    options = [*FLAGS, optimise, "-fvisibility=hidden"]
    if compiler.name != "ziglang":
        return options
    windows = platform.endswith("windows")
    return ["-target", TARGETS[platform], *(o for o in options if not (windows and o == "-fPIC")), "-s"]


def build_library(sources: Mapping[str, bytes], platform: str, optimise: str) -> bytes:
    """Compile the first source file and return the library; libraries are kept in the cache by content.

    Raises RotorsimError with what the compiler said.
    """
    compiler = _compiler_for(platform)
    options = _options(platform, compiler, optimise)
    digest = hashlib.sha256("\0".join([compiler.identity(), *options]).encode())
    for name, text in sources.items():
        digest.update(name.encode() + b"\0" + text + b"\0")
    key = f"fmu-{digest.hexdigest()[:32]}"
    kept = cached(key, suffix_of(platform))
    if kept is not None:
        return kept.read_bytes()
    with scratch_folder() as folder:
        library = _compile(Path(folder), sources, [*compiler.command, *options], platform)
    keep(library, key, suffix_of(platform))
    return library


def _compile(folder: Path, sources: Mapping[str, bytes], command: list[str], platform: str) -> bytes:
    for name, text in sources.items():
        (folder / name).write_bytes(text)
    target = folder / f"library{suffix_of(platform)}"
    command = [*command, "-o", str(target), str(folder / next(iter(sources)))]
    if suffix_of(platform) != ".dll":
        command.append("-lm")
    if suffix_of(platform) == ".so" and "nested.h" in sources:
        command.append("-ldl")  # a part of libc since glibc 2.34
    try:
        run_compiler(command, platform)
        library = target.read_bytes()
    except CompilerError as failure:
        raise RotorsimError(*(replace(problem, hint="") for problem in failure.problems), exit_code=1) from None
    except FileNotFoundError:
        raise RotorsimError(Problem("the C compiler wrote no library", platform), exit_code=1) from None
    if binary_kind(library) != platform:
        what = f"the compiler made a library for {binary_kind(library) or 'another platform'}"
        raise RotorsimError(Problem(what, platform), exit_code=1)
    return library
