"""The subprocess of an FMU: loads the library and does what the block and the pipe ask, until the pipe ends.

``main`` is started by `rotorsim.fmi.runtime.process`; only the standard library is loaded, for speed.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import shutil
import signal
import sys
import threading

from rotorsim.fmi.runtime.binding import CallError
from rotorsim.fmi.runtime.channel import LOOKS, ClosedError, Fence, Pipe, seen
from rotorsim.fmi.runtime.memory import Block, Head, Op, Sizes
from rotorsim.fmi.runtime.session import Session

__all__ = ["main"]


def main() -> None:
    """Serve one FMU: arguments are given as JSON in the last argument of the command line."""
    given = json.loads(sys.argv[-1])
    source, sink = os.dup(0), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(2, 1)  # what the FMU prints goes where its errors go
    _limit(given["memory"])
    threading.Thread(target=_watch, args=(given["lifeline"], given["folder"]), daemon=True).start()
    block = Block(mmap.mmap(given["block"], given["bytes"]), Sizes(**given["sizes"]))
    try:
        _Host(block, Pipe(source, sink), given["ordered"]).serve()
    except ClosedError:
        os._exit(0)  # no exit functions: some libraries crash in theirs


def _limit(memory: int | None) -> None:
    """Limit the memory of this process; leave no core files behind."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if memory is not None:
            hard = resource.getrlimit(resource.RLIMIT_AS)[1]
            most = memory if hard == resource.RLIM_INFINITY else min(memory, hard)
            resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _watch(lifeline: int, folder: str) -> None:
    """When the parent is gone without a word, clean up after it and leave, even while the FMU hangs."""
    while os.read(lifeline, 1):
        pass
    shutil.rmtree(folder, ignore_errors=True)
    if os.getpgid(0) == os.getpid():
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


class _Host:
    def __init__(self, block: Block, pipe: Pipe, ordered: bool) -> None:
        self.block, self.pipe, self.ordered = block, pipe, ordered
        self.head = block.head
        self.session = Session(block)
        self.fence, self.looks = Fence(), LOOKS if ordered else 0
        self.seen = 0
        self.waiting: list[bytes] = []

    def serve(self) -> None:
        """Do what is asked, for ever. Raises ClosedError at the end of the pipe."""
        head, session = self.head, self.session
        while True:
            what, self.seen = session.serve(self.seen, self.looks, self.pipe.sink)
            if not what:
                self._wait()
                self.seen = head[Head.REQUEST]
            if not what and head[Head.OP] == Op.COMMAND:
                self._command()
            else:
                try:
                    if what:  # whoever does not wait may have asked for more by now
                        session.fail(what)
                    else:
                        session.run(head[Head.OP])
                except Exception as error:
                    self._tell({"failed": _failure(error).data()})
                    head[Head.STATUS] = 1
            head[Head.REPLY] = self.seen
            self.fence()
            if head[Head.USER_SLEEPS]:
                self.pipe.ring()

    def _wait(self) -> None:
        """Wait until the request changes."""
        head, done = self.head, self.seen
        if seen(head, Head.REQUEST, done, self.looks if self.session.member is None else 0):
            return
        if self.ordered:
            head[Head.FMU_SLEEPS] = 1
            self.fence()
        while head[Head.REQUEST] == done:
            message = self.pipe.receive()
            if message:
                self.waiting.append(message)
        if self.ordered:
            head[Head.FMU_SLEEPS] = 0

    def _command(self) -> None:
        while not self.waiting:
            message = self.pipe.receive()
            if message:
                self.waiting.append(message)
        asked = json.loads(self.waiting.pop(0))
        try:
            answer = {"done": self.session.command(asked["name"], asked["arguments"])}
        except Exception as error:
            answer = {"failed": _failure(error).data()}
        self._tell(answer)

    def _tell(self, answer: object) -> None:
        self.pipe.send(json.dumps(answer).encode())


def _failure(error: Exception) -> CallError:
    if isinstance(error, CallError):
        return error
    if isinstance(error, MemoryError):
        return CallError("error", "-", "there is not enough memory within its limit")
    return CallError("error", "-", f"{type(error).__name__}: {error}")
