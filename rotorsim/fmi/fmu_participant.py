"""An FMU as a participant of a co-simulation."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Node
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.failure import FmuError
from rotorsim.fmi.fmu_block import FmuPort
from rotorsim.fmi.linear import LinearModel
from rotorsim.fmi.model_description import FLOATS, ModelDescription
from rotorsim.fmi.model_exchange import ModelExchange
from rotorsim.fmi.participant import InputHistory
from rotorsim.fmi.slave import Fmu, Slave, open_fmu
from rotorsim.simulate.linear import entry_names

__all__ = ["FmuParticipant", "fmu_participant"]

KEPT = 8  # saved states that a master may come back to
RATE_STEP = 1e-3  # of the last step, over which rates of outputs are taken
MOST_SUBSTEPS = 32
HELD = 1e-12  # relative difference over a step within which inputs count as held


class FmuParticipant:
    """An FMU behind the interface of a participant; its names are those of the ports of its block.

    Co-Simulation: inputs that move during a step are met by substeps of the FMU's own step, each with the inputs of
    its middle. Where all outputs are sampled it is given the inputs of the end of the step, as its new outputs are
    seen from there on. Model Exchange: its states are integrated here, with steps ``internal``, from event to event.

    moving, following: as of a compiled part; outputs of variability discrete do not move between events.
    """

    def __init__(
        self, name: str, fmu: Fmu, slave: Slave, inputs: dict[str, FmuPort], outputs: dict[str, FmuPort],
        parameters: dict[str, Any], stop: float, internal: float,
    ) -> None:  # fmt: skip
        self.name, self.fmu, self.slave, self.parameters, self.stop = name, fmu, slave, parameters, stop
        self.blocks = (name,)
        description = fmu.description
        self.inputs = tuple(n for p in inputs.values() for n in entry_names(f"{name}.{p.name}", p.shape))
        self.outputs = tuple(n for p in outputs.values() for n in entry_names(f"{name}.{p.name}", p.shape))
        self._u_names = [entry for port in inputs.values() for entry in port.entries]
        self._y_names = [entry for port in outputs.values() for entry in port.entries]
        self.kind = description.kinds[slave.kind]
        discrete = [entry.variable.variability != "continuous" for entry in description.resolve(self._u_names)]
        self.integrator = ModelExchange(slave, np.array(discrete, bool)) if slave.kind == "me" else None
        self.can_restore = self.kind.can_get_set_state or (
            self.integrator is not None and not self.integrator.may_have_events
        )
        self.has_rates = self.can_restore and (self.integrator is not None or self.kind.can_vary_step)
        own = self.kind.fixed_step or description.experiment.step
        self.internal = min(internal, own) if own else internal
        self.feedthrough = np.array(
            [[_depends(description.dependencies, y, u) for u in self._u_names] for y in self._y_names], bool
        ).reshape(len(self._y_names), len(self._u_names))
        self.moving = np.array([not port.discrete for port in outputs.values() for _ in port.entries], bool)
        self.following = self.feedthrough & self.moving[:, None]
        self.sampled = bool(self._y_names) and not self.moving.any()
        self._saved: list[int] = []
        self._last = internal
        self._begun = self._started = False

    def initialise(self, t: float, u: np.ndarray) -> None:
        if self._begun:
            self._forget()
            self.slave.reset()
        self._begun, self._started = True, False
        self.slave.setup(
            t, 1.01 * self.stop, parameters=self.parameters, inputs=self._u_names, outputs=self._y_names,
            exit_initialisation=False,
        )  # fmt: skip

    def start(self, t: float, u: np.ndarray) -> None:
        self.output(t, u)
        self.slave.exit_initialisation()
        self._started = True
        if self.integrator is not None:
            self.integrator.begin(t, u)
        elif self.slave.ended:
            raise self._ended(t)

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        if self.integrator is None:
            return np.asarray(self.slave.exchange(u, t))
        return np.asarray(self.integrator.output(t, u) if self._started else self.slave.outputs(t, None, u))

    def output_rate(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return rates of the outputs by a very short step that is taken back."""
        h = RATE_STEP * self._last
        before = self.output(t, u)
        if self.integrator is not None:
            return np.asarray((self.integrator.slope(t, h, lambda tau: u + rate * tau) - before) / h)
        saved = self.slave.save_state()
        after = self._advance(t, h, lambda tau: u + rate * tau, 1)
        self.slave.restore_state(saved)
        self.slave.free_state(saved)
        return np.asarray((after - before) / h)

    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        self._last = h
        if self.integrator is not None:
            self.integrator.advance(t, h, u, min(max(1, int(np.ceil(h / self.internal - 1e-9))), 10_000))
            return self.output(t + h, u(h))
        if self.sampled:
            return self._advance(t, h, lambda _: u(h), 1)
        start, end = u(0.0), u(h)
        moves = bool((np.abs(end - start) > HELD * (np.abs(end) + np.abs(start))).any())
        most = max(1, int(np.ceil(h / self.internal - 1e-9)))
        return self._advance(t, h, u, min(most, MOST_SUBSTEPS) if moves else 1)

    def _advance(self, t: float, h: float, u: Callable[[float], np.ndarray], count: int) -> np.ndarray:
        """Take steps of Co-Simulation. Raises FmuError, also where the FMU asks for the end."""
        width = h / count
        for k in range(count):
            try:
                self.slave.exchange(u((k + 0.5) * width), t + k * width, width)
            except FmuError as failure:
                if failure.kind == "discard" and self.slave.ended:
                    raise self._ended(failure.last if failure.last is not None else t + k * width) from None
                raise
            if self.slave.ended:
                raise self._ended(t + (k + 1) * width)
        return self.slave.exchange(u(h), t + h)

    def next_hit(self, t: float) -> float:
        return np.inf if self.integrator is None else self.integrator.next_time

    def _ended(self, t: float) -> FmuError:
        return self.slave.step_failed("-", "asks for the end of the simulation", "ended", t)

    def save(self) -> Any:
        if self.integrator is not None:
            return self.integrator.save()
        if not self.can_restore:
            return None
        self._saved.append(self.slave.save_state())
        while len(self._saved) > KEPT:
            self.slave.free_state(self._saved.pop(0))
        return self._saved[-1]

    def restore(self, saved: Any) -> None:
        if self.integrator is not None:
            self.integrator.restore(saved)
        elif saved is not None:
            self.slave.restore_state(saved)

    def _forget(self) -> None:
        """Free all saved states."""
        if self.integrator is not None:
            self.integrator.forget()
        while self._saved:
            self.slave.free_state(self._saved.pop())

    def linear(self, used: np.ndarray) -> LinearModel | str:
        """Return the linearisation at the present state by directional derivatives, or why there is none.

        used (n_y,): outputs that others take.
        """
        description = self.fmu.description
        if not self.kind.directional_derivatives:
            return "offers no directional derivatives"
        if self.integrator is not None and self.integrator.next_time < np.inf:
            return "has time events, which directional derivatives do not show"
        sampled = [
            v.name for v in description.by_causality("local")
            if v.variability == "discrete" and v.type in FLOATS  # whole numbers and flags are modes
        ]  # fmt: skip
        sampled += [
            name for name, taken, moves in zip(self._y_names, used, self.moving, strict=True)
            if taken and not moves and not _still(description, name)
        ]  # fmt: skip
        if sampled:
            return f"has values that change at events ({sampled[0]}), which directional derivatives do not show"
        if self.integrator is None and not description.states:
            return "does not tell its states"
        n = len(description.states)
        unknowns, knowns = [*description.derivatives, *self._y_names], [*description.states, *self._u_names]
        try:
            J = self.slave.jacobian(unknowns, knowns) if unknowns and knowns else np.zeros((len(unknowns), len(knowns)))
        except RotorsimError as error:
            return error.problems[0].what
        return LinearModel(J[:n, :n], J[:n, n:], J[n:, :n], J[n:, n:])

    def close(self) -> None:
        """Free the instance and what was unpacked."""
        self.fmu.close()


def _still(description: ModelDescription, output: str) -> bool:
    """Return whether an output depends on parameters at most."""
    known = description.dependencies.get(output)
    return known is not None and all(description.variables[k].causality == "parameter" for k in known)


def _depends(dependencies: Any, output: str, name: str) -> bool:
    """Return whether an output follows an input at once, as the model structure says (not said: it does)."""
    base = output.partition("[")[0]
    known = dependencies.get(output, dependencies.get(base, ()))
    return known is None or name in known or name.partition("[")[0] in known


def fmu_participant(name: str, node: Node, wired: Collection[str], stop: float, internal: float) -> FmuParticipant:
    """Open the FMU of a block and return it as a participant.

    wired: its input ports that something feeds; the others keep the values that the block gives them.
    Raises RotorsimError.
    """
    block: Any = node.block
    option = block.option
    fmu = open_fmu(block.fmu_path, in_process=bool(option.in_process))
    kinds = fmu.description.kinds
    kind = option.interface if option.interface != "any" else "cs" if "cs" in kinds else "me"
    if kind not in kinds:
        offered = ", ".join(kinds) or "neither"
        fmu.close()
        what = f"the FMU offers no interface '{kind}'"
        raise RotorsimError(Problem(what, name, node.place, f"it offers {offered}"))
    given = {**block.fmu_parameters, **{key: port for key, port in block.fmu_inputs.items() if key not in wired}}
    parameters = {
        entry: float(value)
        for key, port in given.items()
        if key in node.values
        for entry, value, start in zip(
            port.entries, np.ravel(node.values[key]), np.ravel(port.start), strict=True
        )
        if value != start
    }  # fmt: skip
    try:
        slave = fmu.instantiate(kind, name)
    except BaseException:
        fmu.close()
        raise
    inputs = {key: port for key, port in block.fmu_inputs.items() if key in wired}
    return FmuParticipant(name, fmu, slave, inputs, block.fmu_outputs, parameters, stop, internal)
