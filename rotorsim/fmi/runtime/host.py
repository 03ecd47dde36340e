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
from rotorsim.fmi.runtime.channel import ClosedError, Pipe, seen
from rotorsim.fmi.runtime.memory import Block, Head, Op, Sizes
from rotorsim.fmi.runtime.session import Session


def main() -> None:
    """Serve one FMU: arguments are given as JSON in the last argument of the command line."""
    given = json.loads(sys.argv[-1])
    source, sink = os.dup(0), os.dup(1)
    os.dup2(os.open(os.devnull, os.O_RDWR), 0)
    os.dup2(2, 1)  # what the FMU prints goes where its errors go
    _limit(given["memory"])
    threading.Thread(target=_watch, args=(given["lifeline"], given["folder"]), daemon=True).start()
    block = Block(mmap.mmap(given["block"], given["bytes"]), Sizes(**given["sizes"]))
    try:
        serve(block, Pipe(source, sink, given["ordered"]))
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


def serve(block: Block, pipe: Pipe) -> None:
    """Do what is asked, for ever. Raises ClosedError at the end of the pipe."""
    head, session, done = block.head, Session(block), 0
    while True:
        failed, done = session.serve(done, pipe.looks, pipe.sink)
        if not failed:
            looks = pipe.looks if session.member is None else 0
            if not seen(head, Head.REQUEST, done, looks):
                pipe.sleep(head, Head.REQUEST, done, Head.FMU_SLEEPS)
            done = head[Head.REQUEST]
        command = not failed and head[Head.OP] == Op.COMMAND  # who does not wait may have asked for more by now
        try:
            if command:
                asked = json.loads(pipe.message())
                pipe.send(_text({"done": session.command(asked["name"], asked["arguments"])}))
            elif failed:
                session.stepping.fail(failed)
            else:
                session.run(head[Head.OP])
        except Exception as error:
            pipe.send(_text({"failed": _failure(error).data()}))
            head[Head.STATUS] = int(not command)
        head[Head.REPLY] = done
        pipe.wake(head, Head.USER_SLEEPS)


def _text(answer: object) -> bytes:
    return json.dumps(answer).encode()


def _failure(error: Exception) -> CallError:
    if isinstance(error, CallError):
        return error
    if isinstance(error, MemoryError):
        return CallError("error", "-", "there is not enough memory within its limit")
    return CallError("error", "-", f"{type(error).__name__}: {error}")
