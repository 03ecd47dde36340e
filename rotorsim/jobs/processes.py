"""Processes of this machine that perform tasks, each over a pipe of its own: no port, no socket, no file to reach.

Dask's local cluster listens on loopback without asking who calls, and any user of the machine can run code there;
a pipe belongs to the two processes that hold its ends.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import resource_tracker
from threading import Thread
from types import TracebackType
from typing import Any

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.store import Outcome
from rotorsim.jobs.tasks import KILLED, Function, Job, Task, outcomes_in, pack, reply, tasks_of
from rotorsim.jobs.threads import ONE_THREAD

ENVIRONMENT = {**ONE_THREAD, "PYTHONHASHSEED": "0"}  # of the processes: one thread each, and sets in one order
_PATIENCE = 5.0  # s, for a process that has nothing to do to end
_TICK = 1.0  # s; on Windows, Ctrl-C waits for the end of a wait

RETRIES = 2  # of a job whose process died


class Pool:
    """Worker processes, started by spawning; a context manager, which ends them. modules: what they import at once.

    Raises RotorsimError when they do not start.
    """

    def __init__(self, workers: int, modules: Sequence[str] = ()) -> None:
        self._workers: list[_Worker] = []
        self._modules = tuple(modules)
        try:
            for _ in range(workers):
                self._workers.append(_started(self._modules))
        except RotorsimError:
            self._end(at_once=True)
            raise

    @property
    def size(self) -> int:
        """The number of processes."""
        return len(self._workers)

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end(at_once=kind is not None)

    def _end(self, *, at_once: bool) -> None:
        for worker in self._workers:
            worker.stop(at_once=at_once or bool(worker.task))
        for worker in self._workers:
            worker.join()
        self._workers.clear()

    def run(self, function: Function, jobs: Sequence[Job], chunk: int) -> Iterator[tuple[int, Outcome]]:
        """Yield index and outcome of every job as the processes finish them, ``chunk`` jobs handed over at a time.

        The jobs of a task that killed its process are run again one by one; one that kills it each time has failed.
        Raises RotorsimError where the processes have ended, or a job cannot be sent to one.
        """
        if not self._workers:
            raise RotorsimError(Problem("the worker processes have ended", hint="use them inside `local_workers`"))
        tasks = deque(tasks_of(jobs, chunk))
        deaths: Counter[int] = Counter()
        try:
            while tasks or any(worker.task for worker in self._workers):
                for k, worker in enumerate(self._workers):
                    if worker.stopped and tasks:
                        self._workers[k] = worker = _started(self._modules)
                    if worker.ready and not worker.task and tasks:
                        worker.give(tasks[0], pack(function, tasks[0]))
                        tasks.popleft()
                for worker in self._heard():
                    task, was_ready = worker.task, worker.ready
                    answer = worker.answer()
                    if answer is not None:
                        if was_ready:
                            yield from outcomes_in(answer, task)
                    elif not was_ready:
                        raise _not_started("they end at once")
                    elif len(task) > 1:
                        tasks.extendleft([job] for job in reversed(task))
                    elif task:
                        deaths[task[0][0]] += 1
                        if deaths[task[0][0]] <= RETRIES:
                            tasks.appendleft(task)
                        else:
                            yield task[0][0], KILLED
        finally:
            for worker in self._workers:
                if worker.task:  # nobody will want its answer
                    worker.stop(at_once=True)

    def _heard(self) -> list[_Worker]:
        """Wait for workers to say something, or to die."""
        from multiprocessing.connection import wait

        by_pipe = {worker.pipe: worker for worker in self._workers if not worker.stopped}
        heard = wait(list(by_pipe), _TICK if os.name == "nt" else None)
        return [by_pipe[pipe] for pipe in heard]  # type: ignore[index]


class _Worker:
    """One process. task: what it works on, empty while it waits; ready: whether it has said that it runs."""

    def __init__(self, modules: tuple[str, ...]) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, there = context.Pipe()
        self.task: Task = ()
        self.ready = self.stopped = False
        self.process = context.Process(target=_work, args=(there, modules), daemon=True)
        try:
            self.process.start()
        except BaseException:
            self.pipe.close()
            raise
        finally:
            there.close()

    def give(self, task: Task, payload: bytes) -> None:
        self.task = task
        with suppress(OSError):  # it has died: seen when its reply is read
            self.pipe.send_bytes(payload)

    def answer(self) -> bytes | None:
        """Return what it says, None when it has died."""
        try:
            said = self.pipe.recv_bytes()
        except (EOFError, OSError):
            self.stop(at_once=True)
            return None
        self.task, self.ready = (), True
        return said

    def stop(self, *, at_once: bool) -> None:
        """End it: by closing its pipe, or by force."""
        if not self.stopped:
            self.stopped, self.task = True, ()
            if at_once:
                self.process.kill()
            self.pipe.close()

    def join(self) -> None:
        self.process.join(_PATIENCE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def _started(modules: tuple[str, ...]) -> _Worker:
    """Return a new worker. Raises RotorsimError when its process does not start."""
    try:
        with _uninterrupted(), _environment():
            return _Worker(modules)
    except (RuntimeError, OSError) as error:
        raise _not_started(error) from None


def _work(pipe: Any, modules: Sequence[str]) -> None:
    """Perform tasks until the other end of the pipe is closed, by whatever end of that process.

    modules: imported first; one that cannot be is said by the task that needs it.
    """
    Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        pipe.send_bytes(b"")
        for name in modules:
            with suppress(Exception):
                import_module(name)
        while True:
            pipe.send_bytes(reply(pipe.recv_bytes()))


def _end_with_parent() -> None:
    """End this process with the one that started it, also amid a task that nobody waits for any more."""
    from multiprocessing.connection import wait

    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _not_started(why: object) -> RotorsimError:
    if isinstance(why, RuntimeError):  # what multiprocessing says to a script that has no such line
        why = "the script that starts them is itself being read by one"
    return RotorsimError(
        Problem(
            f"the worker processes do not start: {why}",
            hint='in a script, call it under `if __name__ == "__main__":`; or use the scheduler "synchronous"',
        ),
        exit_code=1,
    )


@contextmanager
def _environment() -> Iterator[None]:
    """Set what processes started now inherit."""
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    os.environ.update({**ENVIRONMENT, "PYTHONHASHSEED": before["PYTHONHASHSEED"] or "0"})
    try:
        yield
    finally:
        for name in before:
            os.environ.pop(name, None)
        os.environ.update({name: value for name, value in before.items() if value is not None})


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let Ctrl-C wait; processes that are started here never get it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # else it is started with the first process and unblocks the signal
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
