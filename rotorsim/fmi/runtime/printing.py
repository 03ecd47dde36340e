"""What FMUs print in processes of their own, read and kept."""

from __future__ import annotations

import contextlib
import os
import threading
from typing import IO

PRINTED = 4000  # bytes kept


class Printed:
    """Reads what a subprocess prints, so that it never waits for a reader; its beginning and its end are kept."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._first, self._last, self._lost = stream, b"", b"", 0
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError, ValueError), self._stream as stream:
            while piece := os.read(stream.fileno(), 1 << 16):
                room = PRINTED // 2 - len(self._first)
                self._first, last = self._first + piece[:room], self._last + piece[room:]
                self._last = last[-PRINTED // 2 :]
                self._lost += len(last) - len(self._last)

    def close(self) -> str:
        """Return what was printed, once the process is gone: of much its beginning and its end."""
        self._thread.join(1.0)
        between = f"\n({self._lost} more bytes)\n".encode() if self._lost else b""
        return (self._first + between + self._last).decode("utf-8", "replace").strip()
