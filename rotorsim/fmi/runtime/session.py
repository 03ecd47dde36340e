"""One instance of an FMU at work on a block of numbers, in the process where its library is loaded.

Two ways to ask: `Session.run` for what happens at every step (numbers in the block, no allocation), and
`Session.command` for everything else (plain data, which can cross from process to process).
"""

from __future__ import annotations

import base64
import contextlib
import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rotorsim.fmi.runtime.binding import CallError
from rotorsim.fmi.runtime.calls import Calls, address, references
from rotorsim.fmi.runtime.memory import Block, Head, Op
from rotorsim.fmi.runtime.steps import CoSimulationSteps, Member, ModelExchangeSteps, Server, Steps
from rotorsim.fmi.runtime.versions import make_calls


class Session:
    """An instance: loaded by the command "instantiate", given its inputs and outputs by "begin"."""

    def __init__(self, block: Block) -> None:
        self.block = block
        self._loaded: Calls | None = None
        self._begun: Steps | None = None
        self._stepping: CoSimulationSteps | None = None
        self.saved: dict[int, Any] = {}
        self.run: Callable[[int], None] = _not_yet
        self.member: Member | Server | None = None  # of loop.c or equations.c, which do plain steps then
        self.commands: dict[str, Callable[..., dict[str, Any] | None]] = {
            "instantiate": self._instantiate,
            "begin": self._begin_with,
            "exit_initialisation": self._exit_initialisation,
            "terminate": lambda: self.calls.call("Terminate"),
            "reset": self._reset,
            "in_c": self._in_c,
            "free": self._free,
            "log": lambda: {"log": self.calls.log.taken(), "counts": dict(self.calls.log.counts)},
            "get": lambda run: {"values": self.calls.get(run)},
            "set": self._set,
            "derivatives": self._derivatives,
            "output_derivatives": self._output_derivatives,
            "save": self._save,
            "restore": lambda handle: self.calls.call("SetFMUState", self._saved(handle)),
            "free_state": self._free_state,
            "serialise": self._serialise,
            "deserialise": self._deserialise,
        }

    @property
    def calls(self) -> Calls:
        """The calls of the instance. Raises CallError before it is instantiated."""
        if self._loaded is None:
            raise CallError("refused", "-", "the FMU is not instantiated")
        return self._loaded

    @property
    def steps(self) -> Steps:
        """The steps of the instance. Raises CallError before its inputs and outputs are chosen."""
        if self._begun is None:
            raise CallError("refused", "-", "the FMU is not set up")
        return self._begun

    @property
    def stepping(self) -> CoSimulationSteps:
        """The steps of Co-Simulation. Raises CallError where it is not set up for these."""
        if self._stepping is None:
            raise CallError("refused", "-", "the FMU is not set up for Co-Simulation")
        return self._stepping

    def serve(self, seen: int, looks: int, bell: int) -> tuple[int, int]:
        """Do plain steps in C after the request ``seen``, until something else is asked, or nothing in so many looks.

        Return what failed, for `CoSimulationSteps.fail` (0: nothing), and the last request that was taken up.
        """
        if self.member is None:
            return 0, seen
        self.member.unbound = self.steps.unbound
        self.member.count = seen
        self.member.looks, self.member.bell = looks, bell
        return int(self._serve(ctypes.byref(self.member))), int(self.member.count)

    def command(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out a command. Raises CallError."""
        if name not in self.commands:
            raise CallError("refused", name, "no such command")
        try:
            return self.commands[name](**arguments) or {}
        except (TypeError, ValueError, OverflowError, KeyError, ctypes.ArgumentError) as error:
            raise CallError("refused", name, f"{type(error).__name__}: {error}") from None

    # -- from instance to steps ----------------------------------------------------------------------------------------

    def _instantiate(
        self,
        path: str,
        version: str,
        kind: str,
        name: str,
        token: str,
        resources: str | None,
        n_x: int,
        n_z: int,
        categories: Sequence[str],
    ) -> None:
        self.n_x, self.n_z = n_x, n_z
        self._loaded = calls = make_calls(self.block, path, version, kind)
        calls.instantiate(name, token, resources)
        if categories:
            wanted = (ctypes.c_char_p * len(categories))(*(text.encode() for text in categories))
            calls.call("-", 1, len(categories), address(wanted), name="SetDebugLogging")

    def _begin_with(self, **given: Any) -> None:
        self._given = given
        self._begin(**given)

    def _begin(
        self,
        start: float,
        stop: float | None,
        tolerance: float | None,
        values: Sequence[Any],
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        sizes: Sequence[Any] = (),
    ) -> None:
        calls = self.calls
        self.block.head[Head.SAID] = 0
        if sizes:
            calls.call("EnterConfigurationMode")
            self._set_all(sizes, 0)
            calls.call("ExitConfigurationMode")
        if calls.kind == "cs":
            self._begun = self._stepping = CoSimulationSteps(calls, inputs, outputs)
        else:
            self._begun = ModelExchangeSteps(calls, self.n_x, self.n_z, inputs, outputs)
        self._note_saved()
        self.run = self.steps.run
        self._set_all(values, len(sizes))
        calls.initialise(start, stop, tolerance, self.n_x, self.n_z)

    def _set_all(self, values: Sequence[Any], first: int) -> None:
        """Set variables one after the other; a failure says which it was, counted from ``first``."""
        for k, (run, numbers) in enumerate(values, first):
            try:
                self.calls.set(run, numbers)
            except CallError as error:
                error.more["at"] = k
                raise

    def _exit_initialisation(self) -> None:
        if self.calls.is_settled and self.steps.fed:
            self._reset()
            self._begin(**self._given)
            self.steps.run(Op.U)  # as they were last
        self.calls.exit_initialisation()
        self.steps.begin()

    def _reset(self) -> None:
        self.calls.reset()
        self._begun, self._stepping, self.run, self.member = None, None, _not_yet, None

    def _in_c(self, library: str) -> None:
        steps = self.steps
        with contextlib.suppress(OSError):  # what cannot be loaded is done here
            self._serve = ctypes.CDLL(library)[steps.served_by]
            self._serve.restype = ctypes.c_int64
            self.member = steps.in_c() if steps.all_float else None

    def _free(self) -> dict[str, Any]:
        if self._loaded is None:
            return {}
        if self.calls.instance:
            for handle in list(self.saved):
                self._free_state(handle)
            self.calls.free()
        self.run, self.member = _not_yet, None
        return {"log": self.calls.log.taken()}

    def _set(self, run: Mapping[str, Any], numbers: Sequence[Any]) -> None:
        if self._begun is not None and self._begun.initialising:
            self._given["values"] = [*self._given["values"], (run, numbers)]
        (self._begun or self.calls).set(run, numbers)

    # -- values --------------------------------------------------------------------------------------------------------

    def _derivatives(
        self, function: str, unknowns: Sequence[int], knowns: Sequence[int], seeds: Sequence[Sequence[float]], n: int
    ) -> dict[str, Any]:
        of, by, found = references(unknowns), references(knowns), (ctypes.c_double * n)()
        rows = []
        for seed in seeds:
            given = (ctypes.c_double * len(seed))(*seed)
            arrays = self.calls.sized((address(given), len(seed)), (address(found), n))
            self.calls.call(function, address(of), len(of), address(by), len(by), *arrays)
            rows.append(list(found))
        return {"values": rows}

    def _output_derivatives(self, refs: Sequence[int], order: int, n: int) -> dict[str, Any]:
        of, orders, found = references(refs), (ctypes.c_int * len(refs))(*[order] * len(refs)), (ctypes.c_double * n)()
        arguments = (address(of), len(of), address(orders), *self.calls.sized((address(found), n)))
        self.calls.call("GetOutputDerivatives", *arguments)
        return {"values": list(found)}

    # -- states --------------------------------------------------------------------------------------------------------

    def _save(self, handle: int) -> None:
        pointer = self.saved.get(handle) or ctypes.c_void_p()
        self.calls.call("GetFMUState", address(pointer))
        self.saved[handle] = pointer
        self._note_saved()

    def _free_state(self, handle: int) -> None:
        pointer = self.saved.pop(handle, None)
        if pointer is not None:
            self.calls.call("FreeFMUState", address(pointer))
        self._note_saved()

    def _serialise(self, handle: int) -> dict[str, Any]:
        state, size = self._saved(handle), ctypes.c_size_t()
        self.calls.call("SerializeFMUState", state, address(size), name="SerializedFMUStateSize")
        data = ctypes.create_string_buffer(size.value)
        self.calls.call("SerializeFMUState", state, address(data), size.value)
        return {"data": base64.b64encode(data.raw).decode()}

    def _deserialise(self, handle: int, data: str) -> None:
        raw, pointer = base64.b64decode(data), ctypes.c_void_p()
        text = ctypes.create_string_buffer(raw, len(raw))
        self.calls.call("DeserializeFMUState", address(text), len(raw), address(pointer))
        self.saved[handle] = pointer
        self._note_saved()

    def _note_saved(self) -> None:
        """Tell the steps whether a state may be set again."""
        if self._begun is not None:
            self._begun.unbound = int(not self.saved)

    def _saved(self, handle: int) -> Any:
        if handle not in self.saved:
            raise CallError("refused", "SetFMUState", "there is no such saved state")
        return self.saved[handle]


def _not_yet(_: int) -> None:
    raise CallError("refused", "-", "the FMU is not set up")
