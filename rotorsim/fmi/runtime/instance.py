"""An instance of an FMU, whatever its kind: set up, values, states, and every failure in words."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.fmi.description.model import ModelDescription
from rotorsim.fmi.runtime.binding import CallError
from rotorsim.fmi.runtime.calls import FUNCTIONS
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.memory import Head, Said
from rotorsim.fmi.runtime.process import Worker
from rotorsim.fmi.runtime.runs import make_run, make_runs
from rotorsim.fmi.runtime.versions import function_name

Log = Callable[[str, str, str], None]  # status, category, message


class Instance:
    """What `Slave` can do for both kinds: begin, end, values of variables, saved states."""

    def __init__(
        self,
        description: ModelDescription,
        worker: Worker,
        kind: str,
        name: str,
        file: str,
        log: Log | None,
        released: Callable[[], None],
    ) -> None:
        self.description, self.worker, self.kind, self.name = description, worker, kind, name
        self.file, self.log = file, log
        self._released = released
        self.owner: object = None  # whose unpacked files it needs
        self.input_names: tuple[str, ...] = ()
        self.output_names: tuple[str, ...] = ()
        self.n_states, self.n_events = len(self.description.states), self.description.n_events
        self.ended = False
        self._phase = "new"
        self._handles = 0  # of saved states, given so far
        self._saved: list[int] = []
        self._head: Any = worker.block.head
        self._numbers: Any = worker.block.numbers
        self._run: Callable[[int], None] = worker.run
        self._begin: Callable[[int], None] = worker.begin
        self._t = 0.0
        self._views(np.frombuffer(worker.block.memory, np.float64), 0, 0)

    def _views(self, all_: np.ndarray, n_u: int, n_y: int) -> None:
        """Make the vectors that lie in the block."""
        block, self._all = self.worker.block, all_
        self._u, self._y = all_[block.u : block.u + n_u], all_[block.y : block.y + n_y]
        n, n_x = block.sizes.n, self.n_states
        self._du = [all_[block.du + k * n : block.du + k * n + n_u] for k in range(block.sizes.order)]
        self._x, self._xdot = all_[block.x : block.x + n_x], all_[block.xdot : block.xdot + n_x]
        self._nominals, self._z = all_[block.nominals : block.z], all_[block.z : block.z + self.n_events]

    # -- begin and end -------------------------------------------------------------------------------------------------

    def setup(
        self,
        start: float = 0.0,
        stop: float | None = None,
        tolerance: float | None = None,
        parameters: Mapping[str, Any] | None = None,
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
        *,
        exit_initialisation: bool = True,
    ) -> None:
        """Set start values, choose inputs and outputs once, and initialise.

        inputs, outputs: scalars, entries of arrays, or arrays (all entries). parameters: values of any variables that
        may be set before the simulation; of an array, one value for each entry. exit_initialisation: False leaves the
        FMU in its initialisation, so that `exchange` without a step can solve a loop; then call that function.
        """
        self._expect("new")
        read = self.description.resolve(outputs, "output")
        written = self.description.resolve(inputs, "input")
        input_runs, output_runs = make_runs(written, "input"), make_runs(read, "output")
        given = dict(parameters or {})
        values = _all_runs(self.description, given)
        self.command(
            "begin",
            start=float(start),
            stop=stop,
            tolerance=tolerance,
            values=values,
            inputs=input_runs,
            outputs=output_runs,
            about=[*self.description.sizes, *given],
            sizes=[make_run(self.description, *size, sizes=True) for size in self.description.sizes.items()],
        )
        self.input_names, self.output_names = tuple(e.name for e in written), tuple(e.name for e in read)
        self._views(self._all, len(self.input_names), len(self.output_names))
        self._phase = "initialising"
        if exit_initialisation:
            self.exit_initialisation()

    def exit_initialisation(self) -> None:
        """End the initialisation; the FMU is ready for steps."""
        self._expect("initialising")
        self.command("exit_initialisation")
        self._phase = "running"
        self._note_end()

    def terminate(self) -> None:
        """End the simulation; values can still be read."""
        self._expect("running")
        self.command("terminate")
        self._phase = "ended"

    def reset(self) -> None:
        """Go back to where the instance was before `setup`."""
        self.command("reset")
        self._phase, self.ended = "new", False

    def free(self) -> None:
        """Free the instance and end its process; may be called twice."""
        if self._phase != "freed":
            self._phase = "freed"
            self.worker.close()
            self._run = self._begin = _freed
            self._head, self._numbers = {Head.SAID: 0}, {}
            self._views(np.zeros(0), 0, 0)
            self.worker.block.close()
            self._released()

    # -- values --------------------------------------------------------------------------------------------------------

    def get(self, names: Sequence[str]) -> list[Any]:
        """Return the values of variables; an array gives all its entries."""
        values: list[Any] = []
        for run in make_runs(self.description.resolve(names), ""):
            values += self.command("get", run=run, about=list(names))["values"]
        return values

    def set(self, names: Sequence[str], values: Sequence[Any]) -> None:
        """Set variables: tunable parameters, discrete inputs, what the FMU allows now."""
        for name, value in zip(names, values, strict=True):
            run, numbers = make_run(self.description, name, value)
            self.command("set", run=run, numbers=numbers, about=[name])

    def directional(self, unknowns: Sequence[str], knowns: Sequence[str], seed: np.ndarray) -> np.ndarray:
        """Return the derivatives (n_unknowns,) of the unknowns in the direction ``seed`` (n_knowns,) of the knowns."""
        return self._derivatives("directional", unknowns, knowns, np.atleast_2d(np.asarray(seed, float))).ravel()

    def jacobian(self, unknowns: Sequence[str], knowns: Sequence[str], kind: str = "directional") -> np.ndarray:
        """Return the derivatives (n_unknowns, n_knowns) of the unknowns by the knowns.

        kind: directional, a call for each known, or adjoint, one for each unknown.
        """
        found = self._derivatives(kind, unknowns, knowns, None)
        return found.T if kind == "directional" else found

    def _derivatives(
        self, kind: str, unknowns: Sequence[str], knowns: Sequence[str], seeds: np.ndarray | None
    ) -> np.ndarray:
        """Return one row for each row of seeds; None: the unit vectors."""
        if not getattr(self.description.kinds[self.kind], f"{kind}_derivatives"):
            raise self._refused(f"offers no {kind} derivatives")
        of, by = (make_runs(self.description.resolve(names), "float") for names in (unknowns, knowns))
        if len({run["type"] for run in (*of, *by)}) > 1 or len(of) != 1 or len(by) != 1:
            raise self._refused(f"{kind} derivatives are of variables of one type by variables of one type")
        here, there = (by[0], of[0]) if kind == "directional" else (of[0], by[0])  # what seeds, and results, belong to
        inside = np.arange(here["n"]) if here["index"] is None else np.array(here["index"])
        given = np.eye(len(inside)) if seeds is None else seeds
        whole = np.zeros((len(given), here["n"]))
        whole[:, inside] = given
        arguments = {"unknowns": of[0]["refs"], "knowns": by[0]["refs"], "seeds": whole.tolist(), "n": there["n"]}
        answer = self.command("derivatives", function=f"Get{kind.capitalize()}Derivative", **arguments)
        found = np.array(answer["values"], float)
        return found if there["index"] is None else found[:, there["index"]]

    def save_state(self) -> int:
        """Return a handle of the whole state of the instance."""
        if not self.description.kinds[self.kind].can_get_set_state:
            raise self._refused("its state cannot be saved")
        return self._saved_by("save")

    def _saved_by(self, command: str, **arguments: Any) -> int:
        """Return the new handle of a state that a command saves."""
        self._handles += 1
        self.command(command, handle=self._handles, **arguments)
        self._saved.append(self._handles)
        return self._handles

    def restore_state(self, handle: int) -> None:
        """Go back to a saved state, which stays saved."""
        self.command("restore", handle=handle)

    def serialise_state(self, handle: int) -> bytes:
        """Return a saved state as bytes, which `deserialise_state` takes in any instance of the same FMU."""
        if not self.description.kinds[self.kind].can_serialise_state:
            raise self._refused("its state cannot be serialised")
        return base64.b64decode(self.command("serialise", handle=handle)["data"])

    def deserialise_state(self, data: bytes) -> int:
        """Return the handle of a state made of bytes."""
        if not self.description.kinds[self.kind].can_serialise_state:
            raise self._refused("its state cannot be serialised")
        return self._saved_by("deserialise", data=base64.b64encode(data).decode())

    def free_state(self, handle: int) -> None:
        """Forget a saved state."""
        self.command("free_state", handle=handle)
        self._saved = [other for other in self._saved if other != handle]

    def free_states(self, *, but: int = 0) -> None:
        """Forget all saved states but so many of the newest."""
        for handle in self._saved[: max(len(self._saved) - but, 0)]:
            self.free_state(handle)

    # -- help ----------------------------------------------------------------------------------------------------------

    def command(self, name: str, /, about: Sequence[str] = (), **arguments: Any) -> dict[str, Any]:
        """Ask for something that is no step; about: the variables it concerns. Raises FmuError."""
        if self._phase == "freed":
            raise self._refused("the instance is freed")
        try:
            answer = self.worker.command(name, **arguments)
        except CallError as failure:
            at = failure.more.get("at")
            concerned = about[at : at + 1] if isinstance(at, int) else about
            raise self._failed(failure, about=concerned) from None
        if self.log and name != "log":
            self._forward_log()
        return answer

    @property
    def time(self) -> float:
        """The time of the last call that has one [s]."""
        return self._t

    @property
    def is_running(self) -> bool:
        """Whether it is set up and past its initialisation."""
        return self._phase == "running"

    @property
    def warned(self) -> int:
        """How many calls have returned a warning."""
        return int(self._head[Head.WARNED]) if self._phase != "freed" else 0

    def messages(self) -> tuple[list[tuple[str, str, str]], dict[str, int]]:
        """Return the last messages that nobody has taken yet, and how many there have been by status."""
        answer = self.worker.command("log")
        return [(str(a), str(b), str(c)) for a, b, c in answer.get("log", ())], dict(answer.get("counts", {}))

    def _forward_log(self) -> None:
        """Hand new messages over to the user's function."""
        self._tell(self.messages()[0])

    def _tell(self, lines: Sequence[tuple[str, ...]]) -> None:
        """Hand messages (status, category, text) that were taken over to the user's function."""
        for line in lines if self.log else ():
            self.log(*line)  # type: ignore[misc]

    def step_failed(self, function: str, what: str, kind: str, time: float, hint: str = "") -> FmuError:
        """Return the failure of a step that was taken elsewhere, with the messages of the FMU."""
        log = self.worker.command("log").get("log", [])
        return self._failed(CallError(kind, function, what, log=log, hint=hint), time)

    def end_asked(self, time: float) -> FmuError:
        """Return what ends a run where the FMU asks for it."""
        return self.step_failed("-", "asks for the end of the simulation", "ended", time)

    def _expect(self, *phases: str) -> None:
        if self._phase not in phases:
            words = {
                "new": "is not set up",
                "initialising": "is initialising",
                "running": "is set up already",
                "ended": "is terminated",
                "freed": "is freed",
            }
            raise self._refused(f"the instance {words[self._phase]}")

    @property
    def _said(self) -> int:
        said: int = self._head[Head.SAID]
        return said

    def _note_end(self) -> None:
        if self._said & Said.TERMINATE:
            self.ended = True

    def _finite(self, values: np.ndarray, names: Sequence[str], t: float | None) -> np.ndarray:
        """Return values that are finite. Raises FmuError that names those that are not."""
        if not is_finite(values):
            bad = np.flatnonzero(~np.isfinite(values))
            shown = ", ".join(f"{names[k]} = {values[k]}" for k in bad[:5]) + (", ..." if len(bad) > 5 else "")
            raise self._error(f"gives {shown}", kind="value", time=t)
        return values

    def _refused(self, what: str) -> FmuError:
        return self._error(what, kind="refused")

    def _error(self, what: str, **more: Any) -> FmuError:
        return FmuError(what, name=self.name, place=Place(self.file), **more)

    def _failed(self, failure: CallError, time: float | None = None, about: Sequence[str] = ()) -> FmuError:
        more = failure.more
        log = [tuple(map(str, line)) for line in more.get("log", ()) if len(line) == 3]
        self._tell(log)
        known = failure.function in FUNCTIONS[2:]
        function = function_name(self.description.version, self.kind, failure.function) if known else ""
        accessed = {"Set": self.input_names, "Get": self.output_names}.get(failure.function, ())
        concerned = list(about or accessed) if failure.function in ("Set", "Get") else []
        shown = " of " + ", ".join([*concerned[:5], *(["..."] if len(concerned) > 5 else [])]) if concerned else ""
        what = {
            "load": f"its library cannot be loaded: {failure.what}",
            **dict.fromkeys(("crash", "hang"), failure.what + (f", in {function}" if function else "")),
        }.get(failure.kind, f"{function}{shown} {failure.what}".strip())
        last = more.get("last")
        return self._error(
            what,
            kind=failure.kind,
            function=function,
            time=time,
            log=log,
            printed=str(more.get("printed", "")).splitlines(),
            last=float(last) if isinstance(last, int | float) else None,
            hint=str(more.get("hint", "")),
        )


def _all_runs(description: ModelDescription, values: Mapping[str, Any]) -> list[Any]:
    """Return runs and values of variables. Raises RotorsimError with every one that is wrong."""
    runs: list[Any] = []
    problems: list[Problem] = []
    for name, value in values.items():
        try:
            runs.append(make_run(description, name, value))
        except RotorsimError as error:
            problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    return runs


def is_finite(values: np.ndarray) -> bool:
    """Return whether all values (n,) are finite; fast for a few, which is usual."""
    return all(map(math.isfinite, values.tolist())) if len(values) < 32 else bool(np.isfinite(values).all())


def _freed(_: int) -> None:
    raise CallError("refused", "-", "the instance is freed")
