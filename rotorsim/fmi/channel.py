"""How two processes hand a block of numbers to and fro: a little spinning, then sleep on a pipe.

Each side has a counter in the block that only it writes. Whoever waits looks at the other's counter for some
microseconds, then says in the block that it sleeps, and reads from its pipe; whoever has news rings there if the other
sleeps. Messages that do not fit the block go through the pipes too: 4 bytes of length, then as many bytes.
An empty message is the bell.
"""

from __future__ import annotations

import os
import platform
import select
import struct
import threading
import time

__all__ = ["BELL", "ClosedError", "Fence", "LateError", "Patience", "Pipe", "ordered"]

BELL = b"\0\0\0\0"
LONGEST = 1 << 28  # bytes of a message
_SLICE = 0.2  # s, between looks at whether the other side still lives
_yield = getattr(os, "sched_yield", lambda: None)


class ClosedError(Exception):
    """The other side is gone."""


class LateError(Exception):
    """The other side does not answer in time."""


def ordered() -> bool:
    """Return whether another processor sees stores in their order without barriers: on x86 only.

    Elsewhere every message goes through the pipes, which are barriers. One processor alone cannot look at another.
    """
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return platform.machine() in ("x86_64", "AMD64") and cpus > 1


class Fence:
    """A full memory barrier: taking a lock is one on x86."""

    def __init__(self) -> None:
        lock = threading.Lock()
        self.take, self.free = lock.acquire, lock.release

    def __call__(self) -> None:
        self.take()
        self.free()


class Patience:
    """Whether to look at the block for a while before sleeping: as long as that has paid lately.

    It pays when the other side works on another processor. When both share one, or all are busy, whoever looks only
    keeps the other from working.
    """

    LOOKS = 500  # some 200 us: longer than it takes to wake a process on another processor
    MOST, LOSS, START, REST = 64, 8, 16, 2000

    def __init__(self, looks: bool) -> None:
        self._trust, self._rest = self.START, 0 if looks else -1

    def see(self, head: memoryview, place: int, old: int) -> bool:
        """Look for another number than the old one; return whether it came."""
        if self._rest:
            if self._rest > 0:
                self._rest -= 1
            return head[place] != old
        for _ in range(self.LOOKS):
            if head[place] != old:
                if self._trust < self.MOST:
                    self._trust += 1
                return True
            _yield()  # where processes outnumber processors, the one that is waited for may want this one
        self._trust -= self.LOSS
        if self._trust < 0:
            self._trust, self._rest = self.START, self.REST
        return False


class Pipe:
    """Messages on two file descriptors."""

    def __init__(self, source: int, sink: int) -> None:
        self.source, self.sink = source, sink
        self._poll = select.poll()
        self._poll.register(source, select.POLLIN)

    def send(self, message: bytes) -> None:
        """Send a message. Raises ClosedError."""
        self._write(struct.pack("<I", len(message)) + message)

    def ring(self) -> None:
        """Wake the other side up. Raises ClosedError."""
        self._write(BELL)

    def _write(self, data: bytes) -> None:
        try:
            while data:
                data = data[os.write(self.sink, data) :]
        except (BrokenPipeError, ConnectionError):
            raise ClosedError from None

    def receive(self, deadline: float | None = None) -> bytes:
        """Return the next message; b"" for the bell. Raises ClosedError, LateError (deadline: of time.monotonic)."""
        size = struct.unpack("<I", self._exactly(4, deadline))[0]
        if size > LONGEST:
            raise ClosedError
        return self._exactly(size, deadline) if size else b""

    def _exactly(self, size: int, deadline: float | None) -> bytes:
        data = b""
        while len(data) < size:
            if deadline is not None and not self._ready(deadline):
                raise LateError
            piece = os.read(self.source, size - len(data))
            if not piece:
                raise ClosedError
            data += piece
        return data

    def _ready(self, deadline: float) -> bool:
        while True:
            left = deadline - time.monotonic()
            if self._poll.poll(1000 * max(0.0, min(left, _SLICE))):
                return True
            if left <= 0.0:
                return False
            self.look()

    def look(self) -> None:
        """Called now and then while waiting; may raise ClosedError."""
