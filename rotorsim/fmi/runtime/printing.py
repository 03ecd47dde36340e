"""What the libraries of FMUs print: sent elsewhere, or read and kept."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from typing import IO, Any

PRINTED = 4000  # characters kept


@contextlib.contextmanager
def printing_elsewhere() -> Iterator[None]:
    """Send what libraries in this process print to where errors go, so that standard output stays ours."""
    libc: Any = ctypes.cdll.msvcrt if sys.platform == "win32" else ctypes.CDLL(None)
    sys.stdout.flush()
    try:
        kept = os.dup(1)
    except OSError:  # there is none
        yield
        return
    try:
        libc.fflush(None)
        os.dup2(2, 1)
        yield
    finally:
        libc.fflush(None)  # what C holds back was printed there
        os.dup2(kept, 1)
        os.close(kept)


class Printed:
    """Reads what a subprocess prints, so that it never waits for a reader; the end of it is kept."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self.text = stream, b""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError, ValueError), self._stream as stream:
            while piece := os.read(stream.fileno(), 1 << 16):
                self.text = (self.text + piece)[-PRINTED:]

    def close(self) -> str:
        """Return the end of what was printed, once the process is gone."""
        self._thread.join(1.0)
        return self.text.decode("utf-8", "replace").strip()
