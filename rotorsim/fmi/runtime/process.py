"""An FMU in a subprocess: its crash, hang or hunger for memory ends with a message, and this process stays clean.

This protects against faults, not against malice: a library of another's making can do what its user can.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import mmap
import os
import signal
import subprocess
import sys
import tempfile
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import rotorsim
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.runtime.binding import CallError
from rotorsim.fmi.runtime.calls import FUNCTIONS
from rotorsim.fmi.runtime.channel import ClosedError, LateError, Pipe, ordered, seen
from rotorsim.fmi.runtime.memory import Block, Head, Op, Sizes
from rotorsim.fmi.runtime.printing import Printed
from rotorsim.fmi.runtime.session import Session
from rotorsim.fmi.runtime.steps import PROCESS, Member, State

START = 60.0  # s for Python itself to start on a busy machine
GRACE = 2.0  # s to leave, before it is killed
_CODE = "import sys; sys.path.append(sys.argv[1]); from rotorsim.fmi.runtime.host import main; main()"


class Asked(ctypes.Structure):
    """What equations.c knows of a process of its own: ``rs_remote``. count: of the last request, whoever made it."""

    _fields_ = [
        ("head", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("count", "looks", "bell", "u", "y", "x", "xdot", "z")),
        ("picked", ctypes.c_void_p),
    ]


class Worker(ABC):
    """Where an FMU works; `run` does steps on the block, `command` everything else. Both raise CallError."""

    block: Block

    def run(self, op: int) -> None:
        """Do what the bits of ``op`` say."""
        self.begin(op)
        self.finish()

    @abstractmethod
    def begin(self, op: int) -> None:
        """Ask for steps; where the FMU has its own process, it works while others do."""

    @abstractmethod
    def finish(self) -> None:
        """Wait for what `begin` asked."""

    @abstractmethod
    def command(self, name: str, /, **arguments: Any) -> dict[str, Any]:
        """Carry out a command of `Session`."""

    @abstractmethod
    def close(self) -> None:
        """Free what it holds; may be called twice."""

    @abstractmethod
    def why_not_in_c(self) -> str:
        """Return why its steps cannot be taken by loop.c, or ""."""

    @abstractmethod
    def in_c(self, library: str) -> Member:
        """Return its steps for loop.c, whose library is at a path."""

    @abstractmethod
    def enter_c(self, member: Member) -> None:
        """Say before loop.c is called what it goes on from. Raises CallError."""

    @abstractmethod
    def leave_c(self, member: Member) -> None:
        """Take over from loop.c when it returns."""

    @abstractmethod
    def finish_in_c(self, member: Member, what: int) -> None:
        """Do what loop.c left to be done: wait, or raise what failed as CallError."""


class LocalWorker(Worker):
    """An FMU in this process: fast, and its faults are ours."""

    def __init__(self, sizes: Sizes) -> None:
        self.block = Block(mmap.mmap(-1, max(sizes.bytes, mmap.PAGESIZE)), sizes)
        self.session = Session(self.block)

    def run(self, op: int) -> None:
        self.session.run(op)

    def begin(self, op: int) -> None:
        self.session.run(op)

    def finish(self) -> None:
        """It is done."""

    def command(self, name: str, /, **arguments: Any) -> dict[str, Any]:
        return self.session.command(name, arguments)

    def close(self) -> None:
        with contextlib.suppress(CallError):
            self.session.command("free", {})

    def why_not_in_c(self) -> str:
        return "" if self.session.stepping.all_float else "has inputs or outputs that are not Float64"

    def in_c(self, library: str) -> Member:
        return self.session.stepping.in_c()

    def enter_c(self, member: Member) -> None:
        member.unbound = self.session.stepping.unbound

    def leave_c(self, member: Member) -> None:
        """All is in the block."""

    def finish_in_c(self, member: Member, what: int) -> None:
        self.session.stepping.fail(what)


class RemoteWorker(Worker):
    """An FMU in a subprocess. folder: the unpacked FMU, removed by the child if this process dies."""

    def __init__(self, sizes: Sizes, folder: Path, library: Path, timeout: float, memory: int | None) -> None:
        if sys.platform == "win32":
            hint = 'use it in process: "in_process": true among its parameters'
            raise RotorsimError(Problem("FMUs in a subprocess are not supported on Windows yet", hint=hint))
        self.timeout, self.memory = timeout, memory
        size = max(sizes.bytes, mmap.PAGESIZE)
        descriptor = _shared(size)
        self.block = Block(mmap.mmap(descriptor, size), sizes)
        self.head = self.block.head
        self.commanded = False
        in_order = ordered()
        self.head[Head.FMU_SLEEPS] = self.head[Head.USER_SLEEPS] = int(not in_order)
        end, self._lifeline = os.pipe()
        scratch = tempfile.mkdtemp(prefix="scratch-", dir=folder)
        given = {
            "memory": memory,
            "lifeline": end,
            "folder": str(folder),
            "block": descriptor,
            "bytes": size,
            "ordered": in_order,
            "sizes": asdict(sizes),
        }
        root = str(Path(rotorsim.__file__).resolve().parent.parent)
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", _CODE, root, json.dumps(given)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                pass_fds=(end, descriptor),
                cwd=scratch,
                bufsize=0,
                env=_environment(library.parent),
                start_new_session=True,
            )
        except BaseException:
            os.close(self._lifeline)
            raise
        finally:
            os.close(end)
            os.close(descriptor)
        assert self.process.stderr
        self.pipe = _Watched(self.process, in_order)
        block, looks, bell = self.block, self.pipe.looks, self.pipe.sink
        first = block.u, block.y, block.x, block.xdot, block.z
        self.asked = Asked(block.at(0), 0, looks, bell, *first)
        self.printed = Printed(self.process.stderr)
        self._finalizer = weakref.finalize(self, _end, self.process, self._lifeline)
        self.limit = START  # of the first command
        self.dead: CallError | None = None

    @property
    def count(self) -> int:
        """The number of the last request."""
        return int(self.asked.count)

    @count.setter
    def count(self, number: int) -> None:
        self.asked.count = number

    def _expect(self) -> None:
        """Make sure that it can be asked: drop the reply that nobody waited for. Raises CallError if it has ended."""
        if self.dead:
            raise self.dead
        if self.head[Head.REPLY] != self.count:
            self._wait()
        if self.head[Head.STATUS] or self.commanded:
            self.head[Head.STATUS], self.commanded = 0, False
            self._answer()

    def _ask(self, op: int) -> None:
        self.head[Head.OP] = op
        self.head[Head.REQUEST] = self.count = self.count + 1

    def begin(self, op: int) -> None:
        self._expect()
        self._ask(op)
        try:
            self.pipe.wake(self.head, Head.FMU_SLEEPS)
        except ClosedError:
            raise self._died() from None

    def finish(self, looks: int | None = None) -> None:
        if not seen(self.head, Head.REPLY, self.count - 1, self.pipe.looks if looks is None else looks):
            self._wait()
        if self.head[Head.STATUS]:
            self.head[Head.STATUS] = 0
            raise CallError.from_data(self._answer()["failed"])

    def command(self, name: str, /, **arguments: Any) -> dict[str, Any]:
        self._expect()
        text = json.dumps({"name": name, "arguments": arguments}).encode()
        self.commanded = True
        self._ask(Op.COMMAND)
        with self._alive():
            self.pipe.send(text)
        answer = self._answer(name)
        self.commanded = False
        self._wait()
        self.limit = self.timeout
        if "failed" in answer:
            raise CallError.from_data(answer["failed"])
        return dict(answer["done"])

    def close(self) -> None:
        if self.dead is None:
            with contextlib.suppress(CallError, RotorsimError):
                self.command("free")
            self.dead = CallError("refused", "-", "the FMU is closed")
        self._finalizer()
        self.printed.close()

    # -- in C ----------------------------------------------------------------------------------------------------------

    def why_not_in_c(self) -> str:
        return "" if self.pipe.ordered else "has a process of its own, and this machine cannot look at it"

    def serve_in_c(self, library: str) -> None:
        """Let the process do plain steps by a library of C at a path."""
        if os.path.exists(library):  # a cache that cannot be written to keeps none
            self.command("in_c", library=library)

    def in_c(self, library: str) -> Member:
        self.serve_in_c(library)
        return Member(kind=PROCESS, head=self.block.at(0), looks=self.pipe.looks, bell=self.pipe.sink)

    def enter_c(self, member: Member) -> None:
        self._expect()
        member.count = self.count

    def leave_c(self, member: Member) -> None:
        self.count = member.count

    def finish_in_c(self, member: Member, what: int) -> None:
        member.state = State.DONE
        self.finish(0)

    # -- waiting -------------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _alive(self) -> Iterator[None]:
        """Say that the process has died, or does not answer, where waiting for it says so."""
        try:
            yield
        except ClosedError:
            raise self._died() from None
        except LateError:
            raise self._hangs() from None

    def _wait(self) -> None:
        """Sleep until the reply is there."""
        with self._alive():
            deadline = time.monotonic() + self.limit
            self.pipe.sleep(self.head, Head.REPLY, self.count - 1, Head.USER_SLEEPS, deadline)

    def _answer(self, name: str = "") -> dict[str, Any]:
        with self._alive():
            text = self.pipe.message(time.monotonic() + self.limit)
        try:
            answer = json.loads(text)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict) or not isinstance(answer.get("failed", answer.get("done")), dict):
            self._finalizer()
            self.dead = CallError("crash", name, "its process answers nonsense: its memory is damaged")
            raise self.dead
        return answer

    # -- the end -------------------------------------------------------------------------------------------------------

    def _function(self) -> str:
        """Return the function at work when the process stopped to answer."""
        number = self.head[Head.FUNCTION]
        return FUNCTIONS[number] if 0 < number < len(FUNCTIONS) else ""

    def _died(self) -> CallError:
        if self.dead is None:
            function = self._function()
            code, used = self._ended()
            how = f"was ended by {_signal(-code)}" if code < 0 else f"left with exit code {code}"
            more: dict[str, Any] = {"code": code, "printed": self.printed.close()}
            if self.memory is not None and used > 0.5 * self.memory:
                more["hint"] = f"it held {used / 2**20:.0f} MiB of the {self.memory / 2**20:.0f} MiB that it may have"
            self.dead = CallError("crash", function, f"its process {how}", **more)
        return self.dead

    def _hangs(self) -> CallError:
        function = self._function()
        self._ended(0.0)
        what = f"does not answer within {self.limit:g} s"
        self.dead = CallError("hang", function, what, printed=self.printed.close())
        return self.dead

    def _ended(self, grace: float = GRACE) -> tuple[int, int]:
        """End the process now; return its exit code and the most memory it held [bytes]."""
        self._finalizer.detach()
        return _end(self.process, self._lifeline, grace)


class _Watched(Pipe):
    """The pipe to a subprocess."""

    def __init__(self, process: subprocess.Popen[bytes], in_order: bool) -> None:
        assert process.stdin
        assert process.stdout
        super().__init__(process.stdout.fileno(), process.stdin.fileno(), in_order)
        self.process = process

    def look(self) -> None:
        if _has_ended(self.process):
            raise ClosedError


def _end(process: subprocess.Popen[bytes], lifeline: int, grace: float = GRACE) -> tuple[int, int]:
    """End a process and its children; return its exit code and the most memory it held [bytes]."""
    for stream in filter(None, (process.stdin, process.stdout)):
        with contextlib.suppress(OSError):
            stream.close()
    if process.returncode is not None:
        return process.returncode, 0
    stop, pause = time.monotonic() + grace, 0.0002
    while not _has_ended(process):
        if time.monotonic() >= stop:
            _kill(process.pid)
        time.sleep(pause)
        pause = min(2 * pause, 0.05)
    _kill(process.pid)  # whatever it has started itself
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    os.close(lifeline)
    return process.returncode, usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _has_ended(process: subprocess.Popen[bytes]) -> bool:
    return os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _kill(group: int) -> None:
    with contextlib.suppress(OSError):
        os.killpg(group, signal.SIGKILL)


def _shared(size: int) -> int:
    """Return a descriptor of memory that two processes can share and that neither can cut short, where possible."""
    if hasattr(os, "memfd_create"):
        import fcntl

        descriptor = os.memfd_create("rotorsim-fmu", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(descriptor, size)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        return descriptor
    with tempfile.TemporaryFile(prefix="rotorsim-") as file:
        file.truncate(size)
        return os.dup(file.fileno())


def _environment(folder: Path) -> Mapping[str, str]:
    """Return the environment of the subprocess: libraries beside the FMU's own are found."""
    name = "DYLD_LIBRARY_PATH" if sys.platform == "darwin" else "LD_LIBRARY_PATH"
    paths = [str(folder), *filter(None, [os.environ.get(name)])]
    return {**os.environ, name: os.pathsep.join(paths)}


def _signal(number: int) -> str:
    name = next((known.name for known in signal.Signals if known == number), f"signal {number}")
    words = {"SIGSEGV": "it used memory that is not its own", "SIGABRT": "it gave up", "SIGKILL": "killed from outside"}
    return f"{name} ({words[name]})" if name in words else name
