"""Find a C compiler, compile a diagram once, and keep the library in the user's cache folder."""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rotorsim.errors import Problem, RotorsimError

__all__ = ["Compiler", "cache_folder", "compile_c", "find_compiler"]

FLAGS = ("-std=c99", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off")
TIME_LIMIT = 600.0  # s; a compiler that takes longer is taken for hung


@dataclass(frozen=True)
class Compiler:
    """A C compiler: the command, and the name by which a run says which path it took."""

    command: tuple[str, ...]
    name: str

    def identity(self) -> str:
        """Return a text that changes when the compiler does."""
        try:
            status = os.stat(os.path.realpath(self.command[0]))
        except OSError:
            return self.name
        return f"{self.name} {status.st_size} {status.st_mtime_ns}"


def find_compiler() -> Compiler | None:
    """Return the C compiler of this machine, ziglang's if there is none, or None.

    The environment variable ROTORSIM_CC names one; ``ROTORSIM_CC=none`` forbids all.
    """
    return _find(os.environ.get("ROTORSIM_CC", ""), os.environ.get("PATH", ""))


@cache
def _find(wanted: str, path: str) -> Compiler | None:
    if wanted.lower() == "none":
        return None
    for name in (wanted,) if wanted else ("cc", "gcc", "clang"):
        found = shutil.which(name, path=path or None)
        if found:
            return Compiler((found,), found)
    if not wanted and importlib.util.find_spec("ziglang") is not None:
        return Compiler((sys.executable, "-m", "ziglang", "cc"), "ziglang")
    return None


def cache_folder() -> Path:
    """Return the folder of compiled libraries (ROTORSIM_CACHE, else the user's cache folder)."""
    given = os.environ.get("ROTORSIM_CACHE")
    if given:
        return Path(given)
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return base / "rotorsim"


def compile_c(source: str, compiler: Compiler, optimise: str = "-O3") -> tuple[ctypes.CDLL, bool]:
    """Return the library of a C source and whether it came from the cache.

    The file's name is the hash of source, compiler and flags; it appears by atomic rename, so that
    runs in parallel never see half a library. optimise: -O3, or -O2 for long sources (half the time).
    Raises RotorsimError with what the compiler said.
    """
    key = hashlib.sha256("\0".join([source, compiler.identity(), optimise, *FLAGS]).encode()).hexdigest()[:32]
    suffix = ".dll" if sys.platform == "win32" else ".so"
    folder = cache_folder()
    library = folder / f"{key}{suffix}"
    if library.exists():
        try:
            return ctypes.CDLL(str(library)), True
        except OSError:  # left by another machine on a shared disk: compile again
            library.unlink(missing_ok=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix="build-") as build:
            return _build(source, [*compiler.command, optimise], Path(build), library), False
    except OSError:  # no cache can be written: compile for this process only
        with tempfile.TemporaryDirectory(prefix="rotorsim-", ignore_cleanup_errors=True) as build:
            return _build(source, [*compiler.command, optimise], Path(build), Path(build) / library.name), False


def _build(source: str, compiler: list[str], build: Path, library: Path) -> ctypes.CDLL:
    text, target = build / "diagram.c", build / "diagram.out"
    text.write_text(source, encoding="utf-8")
    command = [*compiler, *FLAGS, "-o", str(target), str(text), "-lm"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT, check=False)
    except subprocess.TimeoutExpired:
        raise RotorsimError(
            Problem(
                what=f"the C compiler took longer than {TIME_LIMIT:.0f} s",
                subject=compiler[0],
                hint="run with --no-compiler (slower, needs no compiler)",
            ),
            exit_code=1,
        ) from None
    if done.returncode != 0:
        said = "\n".join(done.stderr.strip().splitlines()[:5])
        raise RotorsimError(
            Problem(
                what=f"the C compiler failed: {said}",
                subject=compiler[0],
                hint="run with --no-compiler (slower, needs no compiler), or name another one in ROTORSIM_CC",
            ),
            exit_code=1,
        )
    os.replace(target, library)
    return ctypes.CDLL(str(library))
