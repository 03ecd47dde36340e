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
from rotorsim.fmi.runtime.calls import FUNCTIONS, Calls, address, references
from rotorsim.fmi.runtime.memory import Block, Head
from rotorsim.fmi.runtime.steps import Member, Steps

__all__ = ["FUNCTIONS", "Session"]


class Session:
    """An instance: loaded by the command "instantiate", given its inputs and outputs by "begin"."""

    def __init__(self, block: Block) -> None:
        self.block = block
        self.calls: Calls | None = None
        self.steps: Steps | None = None
        self.saved: dict[int, Any] = {}
        self.run: Callable[[int], None] = _not_yet
        self.member: Member | None = None  # of c/loop.c, which does plain steps then

    def serve(self, seen: int, looks: int, bell: int) -> tuple[int, int]:
        """Do plain steps in C after the request ``seen``, until something else is asked, or nothing in so many looks.

        Return what failed, for `fail` (0: nothing), and the last request that was taken up.
        """
        if self.member is None or self.steps is None:
            return 0, seen
        self.member.unbound, self.member.count = self.steps.unbound, seen
        self.member.looks, self.member.bell = looks, bell
        return int(self._serve(ctypes.byref(self.member))), int(self.member.count)

    def fail(self, what: int) -> None:
        """Raise what failed in C, as `run` does. Raises CallError."""
        self._steps().fail(what)

    def command(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out a command. Raises CallError."""
        method = getattr(self, f"_do_{name}", None)
        if method is None:
            raise CallError("refused", name, "no such command")
        try:
            return method(**arguments) or {}
        except (TypeError, ValueError, OverflowError, KeyError, ctypes.ArgumentError) as error:
            raise CallError("refused", name, f"{type(error).__name__}: {error}") from None

    # -- from instance to steps ----------------------------------------------------------------------------------------

    def _do_instantiate(
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
        self.calls = calls = Calls(self.block, path, version, kind)
        calls.instantiate(name, token, resources)
        if categories:
            wanted = (ctypes.c_char_p * len(categories))(*(text.encode() for text in categories))
            calls.call("-", "SetDebugLogging", 1, len(categories), address(wanted))

    def _do_begin(
        self,
        start: float,
        stop: float | None,
        tolerance: float | None,
        values: Sequence[Any],
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        sizes: Sequence[Any] = (),
    ) -> None:
        calls = self._calls()
        self.block.head[Head.SAID] = 0
        if sizes:
            calls.call("EnterConfigurationMode", "EnterConfigurationMode")
            self._set_all(calls, sizes, 0)
            calls.call("ExitConfigurationMode", "ExitConfigurationMode")
        self.steps = Steps(calls, self.n_x, self.n_z, inputs, outputs)
        self.steps.unbound = int(not self.saved)
        self.run = self.steps.run
        self._set_all(calls, values, len(sizes))
        end = (1, stop) if stop is not None else (0, 0.0)
        accuracy = (1, tolerance) if tolerance is not None else (0, 0.0)
        if calls.two:
            calls.call("SetupExperiment", "SetupExperiment", *accuracy, start, *end)
            calls.call("EnterInitializationMode", "EnterInitializationMode")
        else:
            calls.call("EnterInitializationMode", "EnterInitializationMode", *accuracy, start, *end)
            self._check_counts(calls)

    @staticmethod
    def _set_all(calls: Calls, values: Sequence[Any], first: int) -> None:
        """Set variables one after the other; a failure says which it was, counted from ``first``."""
        for k, (run, numbers) in enumerate(values, first):
            try:
                calls.set(run, numbers)
            except CallError as error:
                error.more["at"] = k
                raise

    def _check_counts(self, calls: Calls) -> None:
        """FMI 3.0: compare the numbers of states and event indicators with the description."""
        if calls.kind == "me":
            for name, told in (("GetNumberOfContinuousStates", self.n_x), ("GetNumberOfEventIndicators", self.n_z)):
                count = ctypes.c_size_t()
                calls.call("-", name, address(count))
                if count.value != told:
                    raise CallError("error", name, f"says {count.value}, its model description says {told}")

    def _do_exit_initialisation(self) -> None:
        calls, steps = self._calls(), self._steps()
        calls.call("ExitInitializationMode", "ExitInitializationMode")
        steps.begin()

    def _do_terminate(self) -> None:
        self._calls().call("Terminate", "Terminate")

    def _do_reset(self) -> None:
        self._calls().call("Reset", "Reset")
        self.steps, self.run, self.member = None, _not_yet, None

    def _do_in_c(self, library: str) -> None:
        steps = self._steps()
        with contextlib.suppress(OSError):  # what cannot be loaded is done here
            self._serve = ctypes.CDLL(library)["rs_serve"]
            self._serve.restype = ctypes.c_int64
            self.member = steps.in_c() if steps.all_float and self._calls().kind == "cs" else None

    def _do_free(self) -> dict[str, Any]:
        if self.calls is None:
            return {}
        if self.calls.instance:
            for handle in list(self.saved):
                self._do_free_state(handle)
            self.calls.free()
        self.run, self.member = _not_yet, None
        return {"log": self.calls.log.taken()}

    def _do_log(self) -> dict[str, Any]:
        log = self._calls().log
        return {"log": log.taken(), "counts": dict(log.counts)}

    # -- values --------------------------------------------------------------------------------------------------------

    def _do_get(self, run: Any) -> dict[str, Any]:
        return {"values": self._calls().get(run)}

    def _do_set(self, run: Any, numbers: Sequence[Any]) -> None:
        calls, steps = self._calls(), self.steps
        event = calls.kind == "me" and steps is not None and not steps.initialising
        if event:
            calls.call("EnterEventMode", "EnterEventMode")
        calls.set(run, numbers)
        if event and steps is not None:
            steps.settle()

    def _do_directional(
        self, unknowns: Sequence[int], knowns: Sequence[int], seeds: Sequence[Sequence[float]], n: int
    ) -> dict[str, Any]:
        calls = self._calls()
        of, by, found = references(unknowns), references(knowns), (ctypes.c_double * n)()
        rows = []
        for seed in seeds:
            given = (ctypes.c_double * len(seed))(*seed)
            arguments: list[Any] = [address(of), len(of), address(by), len(by), address(given)]
            arguments += [address(found)] if calls.two else [len(seed), address(found), n]
            calls.call("GetDirectionalDerivative", "GetDirectionalDerivative", *arguments)
            rows.append(list(found))
        return {"values": rows}

    def _do_output_derivatives(self, refs: Sequence[int], order: int, n: int) -> dict[str, Any]:
        calls = self._calls()
        of, orders, found = references(refs), (ctypes.c_int * len(refs))(*[order] * len(refs)), (ctypes.c_double * n)()
        name = "GetRealOutputDerivatives" if calls.two else "GetOutputDerivatives"
        arguments = (address(of), len(of), address(orders), address(found), *(() if calls.two else (n,)))
        calls.call("GetOutputDerivatives", name, *arguments)
        return {"values": list(found)}

    # -- states --------------------------------------------------------------------------------------------------------

    def _do_save(self, handle: int) -> None:
        calls = self._calls()
        pointer = self.saved.get(handle) or ctypes.c_void_p()
        calls.call("GetFMUState", self._word("Get"), address(pointer))
        self._note(handle, pointer)

    def _do_restore(self, handle: int) -> None:
        self._calls().call("SetFMUState", self._word("Set"), self._saved(handle))

    def _do_free_state(self, handle: int) -> None:
        pointer = self.saved.pop(handle, None)
        if pointer is not None:
            self._calls().call("FreeFMUState", self._word("Free"), address(pointer))
        if self.steps is not None:
            self.steps.unbound = int(not self.saved)

    def _do_serialise(self, handle: int) -> dict[str, Any]:
        calls, state, size = self._calls(), self._saved(handle), ctypes.c_size_t()
        name = "SerializedFMUstateSize" if calls.two else "SerializedFMUStateSize"
        calls.call("SerializeFMUState", name, state, address(size))
        data = ctypes.create_string_buffer(size.value)
        calls.call("SerializeFMUState", self._word("Serialize"), state, address(data), size.value)
        return {"data": base64.b64encode(data.raw).decode()}

    def _do_deserialise(self, handle: int, data: str) -> None:
        raw, pointer = base64.b64decode(data), ctypes.c_void_p()
        calls, text = self._calls(), ctypes.create_string_buffer(raw, len(raw))
        name = "DeSerializeFMUstate" if calls.two else "DeserializeFMUState"
        calls.call("DeserializeFMUState", name, address(text), len(raw), address(pointer))
        self._note(handle, pointer)

    def _note(self, handle: int, pointer: Any) -> None:
        self.saved[handle] = pointer
        if self.steps is not None:
            self.steps.unbound = 0

    def _saved(self, handle: int) -> Any:
        if handle not in self.saved:
            raise CallError("refused", "SetFMUState", "there is no such saved state")
        return self.saved[handle]

    def _word(self, verb: str) -> str:
        return f"{verb}FMUstate" if self._calls().two else f"{verb}FMUState"

    def _calls(self) -> Calls:
        if self.calls is None:
            raise CallError("refused", "-", "the FMU is not instantiated")
        return self.calls

    def _steps(self) -> Steps:
        if self.steps is None:
            raise CallError("refused", "-", "the FMU is not set up")
        return self.steps


def _not_yet(_: int) -> None:
    raise CallError("refused", "-", "the FMU is not set up")
