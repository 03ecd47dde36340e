"""Find a C compiler, compile a diagram once, and keep the library in the user's cache folder."""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rotorsim.errors import Problem, RotorsimError
from rotorsim.files import sweep, temporary_prefix, write_atomically

FLAGS = (
    "-std=c99",
    "-fPIC",
    "-shared",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-ffp-contract=off",
    "-fno-tree-slp-vectorize",
)
NATIVE = "-march=native"  # changes no digit, as products and sums are not contracted
TIME_LIMIT = 600.0  # s; a compiler that takes longer is taken for hung
MOST_KEPT = 4096  # files in the cache, some 100 MB: a diagnosis compiles a hundred to a thousand diagrams
COMPILER_LINES = 5  # last lines of what a compiler said
_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_SCRATCH = "rotorsim-build-"


class CompilerError(RotorsimError):
    """A C compiler that failed, was killed, or wrote no library; its last lines are in the problem."""

    exit_code = 1

    def warn(self, instead: str) -> None:
        """Warn of the failure where the work goes on without the compiler."""
        problem = self.problems[0]
        warnings.warn(f"{problem.subject}: {problem.what}\n{instead}", RuntimeWarning, stacklevel=3)


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
        command = shutil.which(name, path=path or None)
        if command:
            return Compiler((command,), command)
    if wanted:
        warnings.warn(f"ROTORSIM_CC: there is no compiler {wanted}: none is used", RuntimeWarning, stacklevel=3)
    if not wanted and importlib.util.find_spec("ziglang") is not None:
        return Compiler((sys.executable, "-m", "ziglang", "cc"), "ziglang")
    return None


def cache_folder() -> Path:
    """Return the folder of compiled libraries (ROTORSIM_CACHE, else the user's cache folder).

    A path that depends on where the user stands would load what others put there: of ROTORSIM_CACHE it is refused
    (RotorsimError), of XDG_CACHE_HOME ignored, as its specification says.
    """
    given = os.environ.get("ROTORSIM_CACHE")
    if given:
        if not Path(given).is_absolute():
            hint = f"ROTORSIM_CACHE={Path(given).absolute()}"
            raise RotorsimError(Problem(f"ROTORSIM_CACHE={given}: is not an absolute path", hint=hint))
        return Path(given)
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME", ""))
        base = base if base.is_absolute() else Path.home() / ".cache"
    return base / "rotorsim"


def _trusted_folder() -> Path | None:
    """Return the cache folder, made where it is missing; None where there can be none, or others can write to it."""
    folder = cache_folder()
    try:
        if not folder.is_absolute():  # of a home that is none
            return None
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        if not hasattr(os, "geteuid"):
            return folder
        if status.st_uid != os.geteuid():
            _distrust(folder, "belongs to another user", "set ROTORSIM_CACHE to a folder of your own")
            return None
        if status.st_mode & _OTHERS:
            if os.environ.get("ROTORSIM_CACHE"):
                _distrust(folder, "can be written by others", f"chmod go-w {folder}")
                return None
            folder.chmod(stat.S_IMODE(status.st_mode) & ~_OTHERS)  # made by us, under a generous umask
    except OSError:
        return None
    return folder


@cache
def _distrust(folder: Path, why: str, cure: str) -> None:
    """Say once why a cache is not used."""
    warnings.warn(
        f"the cache {folder} {why}: it is not used, and every model is compiled anew ({cure})",
        RuntimeWarning,
        stacklevel=4,
    )


def cached(key: str, suffix: str) -> Path | None:
    """Return the file that `keep` put into the cache under a key, or None; what is damaged or not ours is deleted."""
    folder = _trusted_folder()
    if folder is None:
        return None
    there = [name for name in os.listdir(folder) if name.startswith(f"{key}-") and name.endswith(suffix)]
    for file in (folder / name for name in sorted(there)):  # a glob takes 20 ms beside ten thousand files
        if _is_intact(file, file.name.removeprefix(f"{key}-").removesuffix(suffix)):
            with suppress(OSError):
                os.utime(file)  # the last to be thinned out
            return file
        with suppress(OSError):
            file.unlink()
    return None


def keep(content: bytes, key: str, suffix: str) -> Path | None:
    """Put a file into the cache; return it, or None where no cache can be written.

    Its name holds the digest of the content, so that both appear at once, by one rename: runs in parallel never see
    half a file, and `cached` finds what a full disk, a power cut or a failing disk has changed.
    """
    folder = _trusted_folder()
    if folder is None:
        return None
    file = folder / f"{key}-{_digest(content)}{suffix}"
    try:
        _thin_out(folder, suffix)
        write_atomically(file, content, mode=0o600)
    except (OSError, RotorsimError):
        return None
    return file


def _thin_out(folder: Path, suffix: str) -> None:
    """Delete that half of the files of a kind which was not used for longest, where there are too many."""
    files = [entry for entry in os.scandir(folder) if entry.name.endswith(suffix)]
    if len(files) < MOST_KEPT:
        return
    for entry in sorted(files, key=lambda entry: entry.stat().st_mtime)[: len(files) // 2]:
        with suppress(OSError):
            os.unlink(entry)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _is_intact(file: Path, digest: str) -> bool:
    """Return whether a file is what its digest says, and of this user alone."""
    try:
        descriptor = os.open(file, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
        with open(descriptor, "rb") as stream:
            status = os.fstat(descriptor)
            if hasattr(os, "geteuid") and (status.st_uid != os.geteuid() or status.st_mode & _OTHERS):
                return False
            return stat.S_ISREG(status.st_mode) and _digest(stream.read()) == digest
    except OSError:
        return False


def scratch_folder() -> tempfile.TemporaryDirectory[str]:
    """Return a temporary folder to compile in; those of killed processes are deleted first."""
    sweep(tempfile.gettempdir(), _SCRATCH)
    return tempfile.TemporaryDirectory(prefix=temporary_prefix(_SCRATCH), ignore_cleanup_errors=True)


@cache
def _instructions(compiler: Compiler) -> str:
    """Return what a compiler defines with NATIVE, which tells processors apart; empty where it has no such flag."""
    try:
        with scratch_folder() as build:
            macros = Path(build, "macros")
            run_compiler([*compiler.command, NATIVE, "-dM", "-E", "-x", "c", os.devnull, "-o", str(macros)], "")
            return macros.read_text(encoding="utf-8", errors="replace")
    except (OSError, CompilerError):
        return ""


def lane_width(compiler: Compiler) -> int:
    """Return how many doubles the vectors of this processor hold, as far as the compiler knows.

    gcc for Windows does not align longer ones than those of SSE2 on the stack (its bug 54412).
    """
    macros = _instructions(compiler)
    widths = {"__AVX512F__": 8, "__AVX__": 4, "__SSE2__": 2, "__ARM_NEON": 2}
    width = next((width for name, width in widths.items() if f"#define {name} " in macros), 1)
    return min(width, 2) if "#define _WIN32 " in macros and "#define __clang__ " not in macros else width


def compile_c(source: str, compiler: Compiler, optimise: str = "-O3") -> tuple[ctypes.CDLL, bool]:
    """Return the library of a C source, for this processor, and whether it came from the cache.

    Its key in the cache is the hash of source, compiler, processor and flags; its content is checked before it is
    loaded. optimise: -O3, or -O2 for long sources (half the time).
    Raises CompilerError with what the compiler said.
    """
    native = _instructions(compiler)
    what = [source, compiler.identity(), native, optimise, *FLAGS]
    key = hashlib.sha256("\0".join(what).encode()).hexdigest()[:32]
    suffix = ".dll" if sys.platform == "win32" else ".so"
    library = cached(key, suffix)
    if library is not None:
        try:
            return ctypes.CDLL(str(library)), True
        except OSError:  # left by another machine on a shared disk: compile again
            library.unlink(missing_ok=True)
    try:
        with scratch_folder() as build:
            text, target = Path(build, "diagram.c"), Path(build, f"diagram{suffix}")
            text.write_text(source, encoding="utf-8")
            command = [*compiler.command, optimise, *FLAGS, "-o", str(target), str(text), "-lm"]
            try:
                run_compiler([*command, *([NATIVE] if native else [])], compiler.command[0])
            except CompilerError:  # an assembler may be older than the processor
                if not native:
                    raise
                run_compiler(command, compiler.command[0])
            if not target.exists():
                raise compiler_error(compiler.command[0], "wrote no library")
            library = keep(target.read_bytes(), key, suffix)
            try:
                return ctypes.CDLL(str(library or target)), False
            except OSError as error:
                if library is not None:
                    library.unlink(missing_ok=True)
                said = str(error).removeprefix(f"{library or target}: ")
                raise compiler_error(compiler.command[0], f"wrote what is no library: {said}") from None
    except OSError as error:
        raise compiler_error(
            compiler.command[0], f"has no folder to work in: {(error.strerror or str(error)).lower()}"
        ) from None


def run_compiler(command: Sequence[str], subject: str) -> None:
    """Run a compiler. Raises CompilerError with its last lines, whatever their encoding."""
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=TIME_LIMIT, check=False)
    except subprocess.TimeoutExpired:
        raise compiler_error(subject, f"took longer than {TIME_LIMIT:.0f} s") from None
    except OSError as error:
        raise compiler_error(subject, f"cannot be started: {(error.strerror or str(error)).lower()}") from None
    if done.returncode == 0:
        return
    lines = (done.stderr.strip() or done.stdout.strip()).decode("utf-8", "replace").splitlines()[-COMPILER_LINES:]
    why = "failed"
    if done.returncode < 0:
        with suppress(ValueError):
            why = f"was killed ({signal.Signals(-done.returncode).name})"
    raise compiler_error(subject, ": ".join([why, "\n".join(lines)] if lines else [why]))


def compiler_error(subject: str, why: str) -> CompilerError:
    """Return the error of a compiler: why it made nothing that can be used."""
    return CompilerError(
        Problem(
            f"the C compiler {why}",
            subject,
            hint="run with --no-compiler (slower, needs no compiler), or name another one in ROTORSIM_CC",
        )
    )
