"""How two processes hand a block of numbers to and fro: a little spinning, then sleep on a pipe.

Each side has a counter in the block that only it writes. Whoever waits looks at the other's counter for some
milliseconds, then says in the block that it sleeps, and reads from its pipe; whoever has news rings there if the other
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

BELL = b"\0\0\0\0"
LONGEST_MESSAGE = 1 << 28  # bytes of a message
LOOKS = 5000  # some 2 ms, before sleeping
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


def seen(head: memoryview, place: int, old: int, looks: int) -> bool:
    """Look for another number than the old one for a while before sleeping; return whether it came.

    Between two looks whoever else wants this processor has it: where processes outnumber processors, looking would
    keep the other side from working. To be woken costs a hundred looks, in a virtual machine a thousand.
    """
    for _ in range(looks):
        if head[place] != old:
            return True
        _yield()
    return bool(head[place] != old)


class Pipe:
    """Messages on two file descriptors. kept: those that came while something else was waited for.

    ordered: whether the other side may be looked at (`ordered`); else it always sleeps.
    """

    def __init__(self, source: int, sink: int, ordered: bool) -> None:
        self.source, self.sink, self.ordered = source, sink, ordered
        self.looks = LOOKS if ordered else 0
        self.kept: list[bytes] = []
        self._barrier = threading.Lock()  # to take it is a full memory barrier on x86
        self._poll = select.poll()
        self._poll.register(source, select.POLLIN)

    def send(self, message: bytes) -> None:
        """Send a message. Raises ClosedError."""
        self._write(struct.pack("<I", len(message)) + message)

    def wake(self, head: memoryview, sleeps: int) -> None:
        """Ring if the other side says at a place that it sleeps, after a full memory barrier. Raises ClosedError."""
        with self._barrier:
            asleep = head[sleeps]
        if asleep:
            self._write(BELL)

    def sleep(self, head: memoryview, place: int, old: int, sleeps: int, deadline: float | None = None) -> None:
        """Sleep until there is another number at a place than the old one. Raises ClosedError, LateError."""
        head[sleeps] = 1
        with self._barrier:
            pass
        while head[place] == old:
            self._keep(deadline)
        head[sleeps] = int(not self.ordered)

    def message(self, deadline: float | None = None) -> bytes:
        """Return the next message (deadline: of time.monotonic). Raises ClosedError, LateError."""
        while not self.kept:
            self._keep(deadline)
        return self.kept.pop(0)

    def _keep(self, deadline: float | None) -> None:
        """Keep what comes; the bell is no message."""
        size = struct.unpack("<I", self._exactly(4, deadline))[0]
        if size > LONGEST_MESSAGE:
            raise ClosedError
        if size:
            self.kept.append(self._exactly(size, deadline))

    def _write(self, data: bytes) -> None:
        try:
            while data:
                data = data[os.write(self.sink, data) :]
        except (BrokenPipeError, ConnectionError):
            raise ClosedError from None

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
        """Find out now and then while waiting whether the other side still lives. Raises ClosedError."""
