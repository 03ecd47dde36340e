"""Write files so that an interrupted write leaves neither half a file nor a temporary one."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import math
import os
import platform
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from rotorsim.errors import Place, Problem, RotorsimError

_NO_ROOM = {errno.ENOSPC, errno.EFBIG, *([errno.EDQUOT] if hasattr(errno, "EDQUOT") else [])}
_FOREIGN = 86400.0  # s; what a process of another machine left on a shared disk is swept after a day
HIDDEN = ".rotorsim-"  # start of the names of files and folders that are not yet in their place


@contextlib.contextmanager
def atomic_target(path: str | Path, *, size: int | None = None, mode: int | None = None) -> Iterator[Path]:
    """Give a temporary file in the folder of ``path``; it takes the place of ``path`` when the block ends well.

    size: about how many bytes will be written, for the error of a full disk. mode: permissions of the file
    (default: those of the file that is replaced, or of any new file).
    What killed processes left there by this function is deleted first.
    Raises RotorsimError when the folder does not exist or cannot be written, or has no room.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise RotorsimError(Problem("folder does not exist", place=Place(str(path.parent)), hint="create it first"))
    if path.is_dir():
        raise RotorsimError(Problem("is a folder", place=Place(str(path)), hint="give the name of a file"))
    sweep(path.parent, HIDDEN)
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=temporary_prefix(HIDDEN), suffix=path.suffix)
    except OSError as error:
        if error.errno in _NO_ROOM:
            raise _no_room(path, error.errno, size, 0) from None
        why = error.strerror or str(error)
        raise RotorsimError(
            Problem(f"file cannot be written: {why}", place=Place(str(path)), hint="choose another folder")
        ) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(_mode(path) if mode is None else mode)
        with temporary.open("rb") as written:
            os.fsync(written.fileno())  # else a power cut after the rename may leave an empty file
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        if _number(error) not in _NO_ROOM:
            raise
        done = temporary.stat().st_size if temporary.exists() else 0
        temporary.unlink(missing_ok=True)
        raise _no_room(path, _number(error), size, done) from None
    finally:
        temporary.unlink(missing_ok=True)


def _number(error: OSError | RuntimeError) -> int | None:
    """Return the number of an error of the system; HDF5 writes it into its own."""
    if isinstance(error, OSError):
        return error.errno
    match = re.search(r"\berrno = (\d+)", str(error))
    return int(match[1]) if match else None


def _no_room(path: Path, number: int | None, size: int | None, done: int) -> RotorsimError:
    """Return the error of a disk (or quota, or limit of a file's size) that is full."""
    free = shutil.disk_usage(path.parent).free
    takes = f"it takes about {_shown(size)}, " if size else f"it takes more than {_shown(done)}, " if done else ""
    kept = "the file that was there is kept" if path.exists() else "nothing of it is left there"
    return RotorsimError(
        Problem(
            f"{os.strerror(number or 0).lower()}: {takes}{_shown(free)} are free; {kept}",
            place=Place(str(path)),
            hint="make room there, or write to another disk",
        ),
        exit_code=1,
    )


def _shown(size: int) -> str:
    return f"{size / 1e6:.3g} MB" if size >= 1e6 else f"{size / 1e3:.3g} kB"


def _mode(path: Path) -> int:
    """Return the permissions of the file that is replaced, or those of any new file (mkstemp makes private ones)."""
    with contextlib.suppress(OSError):
        return stat.S_IMODE(path.stat().st_mode)
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def write_atomically(path: str | Path, data: str | bytes, *, mode: int | None = None) -> None:
    """Write text or bytes to a file as a whole or not at all."""
    content = data.encode("utf-8") if isinstance(data, str) else data
    with atomic_target(path, size=len(content), mode=mode) as temporary:
        temporary.write_bytes(content)


def temporary_prefix(prefix: str) -> str:
    """Return the start of a temporary name that says which process uses it: `sweep` deletes it once that is dead."""
    return f"{prefix}{_machine()}-{os.getpid()}-"


@cache
def _machine() -> str:
    """Return what tells apart where process numbers count: the machine, and the container on it."""
    try:
        space = os.stat("/proc/self/ns/pid").st_ino
    except OSError:
        space = 0
    return hashlib.sha256(f"{platform.node()} {space}".encode()).hexdigest()[:8]


@cache
def sweep(folder: str | Path, prefix: str) -> None:
    """Delete the files and folders, named by `temporary_prefix`, that dead processes of this user left in a folder.

    Once in a process for every folder. One that another machine made is deleted when it is a day old.
    """
    named = re.compile(re.escape(prefix) + r"([0-9a-f]{8})-(\d{1,10})-")
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            name = named.match(entry.name)
            with contextlib.suppress(OSError):
                if name and _is_left(entry.stat(follow_symlinks=False), name[1], int(name[2])):
                    if entry.is_dir(follow_symlinks=False):
                        shutil.rmtree(entry.path, ignore_errors=True)
                    else:
                        os.unlink(entry.path)


def _is_left(status: os.stat_result, machine: str, process: int) -> bool:
    if hasattr(os, "geteuid") and status.st_uid != os.geteuid():
        return False
    if sys.platform == "win32" or machine != _machine() or process < 1:  # (on Windows, to ask is to kill)
        return time.time() - status.st_mtime > _FOREIGN
    try:
        os.kill(process, 0)  # asks whether it is there, no more
    except ProcessLookupError:
        return True
    except OSError:
        pass  # of another user
    return False


def json_number(value: float) -> float | str | None:
    """Return a number as JSON can hold it: "infinity" or "-infinity", as text, and null (None) for NaN, not known."""
    if math.isfinite(value):
        return float(value)
    return None if math.isnan(value) else "infinity" if value > 0 else "-infinity"
