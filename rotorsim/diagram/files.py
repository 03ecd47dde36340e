"""Write files so that an interrupted write leaves neither half a file nor a temporary one."""

from __future__ import annotations

import contextlib
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from rotorsim.errors import Place, Problem, RotorsimError

__all__ = ["atomic_target", "write_atomically"]


@contextlib.contextmanager
def atomic_target(path: str | Path) -> Iterator[Path]:
    """Give a temporary file in the folder of ``path``; it takes the place of ``path`` when the block ends well.

    Raises RotorsimError when the folder does not exist or cannot be written.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise RotorsimError(Problem("folder does not exist", place=Place(str(path.parent)), hint="create it first"))
    if path.is_dir():
        raise RotorsimError(Problem("is a folder", place=Place(str(path)), hint="give the name of a file"))
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix)
    except OSError as error:
        why = error.strerror or str(error)
        raise RotorsimError(
            Problem(f"file cannot be written: {why}", place=Place(str(path)), hint="choose another folder")
        ) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(_mode(path))
        with temporary.open("rb") as written:
            os.fsync(written.fileno())  # else a power cut after the rename may leave an empty file
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _mode(path: Path) -> int:
    """Return the permissions of the file that is replaced, or those of any new file (mkstemp makes private ones)."""
    with contextlib.suppress(OSError):
        return stat.S_IMODE(path.stat().st_mode)
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def write_atomically(path: str | Path, data: str | bytes) -> None:
    """Write text or bytes to a file as a whole or not at all."""
    with atomic_target(path) as temporary:
        temporary.write_bytes(data.encode("utf-8") if isinstance(data, str) else data)
