"""An FMU as a participant of a co-simulation."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Node
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.fmu_block import FmuPort
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
    its middle (or their slope where the FMU interpolates). Model Exchange: its states are integrated here by RK4 with
    steps ``internal``; state events end a step and are located by halving.
    """

    def __init__(
        self, name: str, fmu: Fmu, slave: Slave, inputs: dict[str, FmuPort], outputs: dict[str, FmuPort],
        parameters: dict[str, Any], stop: float, internal: float,
    ) -> None:  # fmt: skip
        self.name, self.fmu, self.slave, self.parameters, self.stop = name, fmu, slave, parameters, stop
        description = fmu.description
        self.inputs = tuple(n for p in inputs.values() for n in entry_names(f"{name}.{p.name}", p.shape))
        self.outputs = tuple(n for p in outputs.values() for n in entry_names(f"{name}.{p.name}", p.shape))
        self._u_names = [entry for port in inputs.values() for entry in port.entries]
        self._y_names = [entry for port in outputs.values() for entry in port.entries]
        self.kind = description.kinds[slave.kind]
        self.exchange_mode = slave.kind
        self.can_restore = self.kind.can_get_set_state or slave.kind == "me"
        self.has_rates = self.can_restore and (slave.kind == "me" or self.kind.can_vary_step)
        own = self.kind.fixed_step or description.experiment.step
        self.internal = min(internal, own) if own else internal
        self.feedthrough = np.array(
            [[_depends(description.dependencies, y, u) for u in self._u_names] for y in self._y_names], bool
        ).reshape(len(self._y_names), len(self._u_names))
        self._saved: list[int] = []
        self._last = internal
        self.x = np.zeros(0)
        self._begun = False

    def initialise(self, t: float, u: np.ndarray) -> None:
        if self._begun:
            self.slave.reset()
        self._begun = True
        self.slave.setup(
            t, 1.01 * self.stop, parameters=self.parameters, inputs=self._u_names, outputs=self._y_names
        )  # fmt: skip
        if self.exchange_mode == "me":
            self.x = self.slave.states()

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        if self.exchange_mode == "me":
            return np.asarray(self.slave.outputs(t, self.x, u))
        return np.asarray(self.slave.exchange(u, t))

    def output_rate(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return rates of the outputs by a very short step that is taken back."""
        h = RATE_STEP * self._last
        saved = self._hold()
        before = self.output(t, u)
        after = self._advance(t, h, lambda tau: u + rate * tau, 1)
        self._back(saved)
        return np.asarray((after - before) / h)

    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        start, end = u(0.0), u(h)
        moves = bool((np.abs(end - start) > HELD * (np.abs(end) + np.abs(start))).any())
        count = 1
        if moves or self.exchange_mode == "me":
            count = min(
                max(1, int(np.ceil(h / self.internal - 1e-9))), 10_000 if self.exchange_mode == "me" else MOST_SUBSTEPS
            )
        self._last = h
        return self._advance(t, h, u, count)

    def _advance(self, t: float, h: float, u: Callable[[float], np.ndarray], count: int) -> np.ndarray:
        width = h / count
        if self.exchange_mode == "me":
            for k in range(count):
                self._runge_kutta(t + k * width, width, u, k * width)
            return self.output(t + h, u(h))
        for k in range(count):
            self.slave.exchange(u((k + 0.5) * width), t + k * width, width)
        return self.slave.exchange(u(h), t + h)

    def _runge_kutta(self, t: float, h: float, u: Callable[[float], np.ndarray], tau: float) -> None:
        """Take one RK4 step of Model Exchange; at a state event it is halved until the event is closed in on."""
        done = 0.0
        while done < h * (1 - 1e-12):
            width = h - done
            before = self.slave.event_indicators(t + done, self.x, u(tau + done)) if self._events else None
            x = self._rk4(t + done, width, u, tau + done)
            if before is not None:
                for _ in range(40):
                    after = self.slave.event_indicators(t + done + width, x, u(tau + done + width))
                    if not ((before > 0) != (after > 0)).any() or width < 1e-12 * h:
                        break
                    width /= 2
                    x = self._rk4(t + done, width, u, tau + done)
            self.x = x
            done += width
            wanted = self.slave.completed_step(t + done, self.x, u(tau + done))
            crossed = before is not None and width < h - (done - width)
            if wanted or crossed:
                update = self.slave.event_update(t + done, self.x, u(tau + done))
                if update.states_changed:
                    self.x = self.slave.states()

    def _rk4(self, t: float, h: float, u: Callable[[float], np.ndarray], tau: float) -> np.ndarray:
        f = self.slave.derivatives
        k1 = f(t, self.x, u(tau))
        middle = u(tau + h / 2)
        k2 = f(t + h / 2, self.x + h / 2 * k1, middle)
        k3 = f(t + h / 2, self.x + h / 2 * k2, middle)
        k4 = f(t + h, self.x + h * k3, u(tau + h))
        return np.asarray(self.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))

    @property
    def _events(self) -> int:
        return self.fmu.description.n_events

    def _hold(self) -> Any:
        return self.x.copy() if self.exchange_mode == "me" else self.slave.save_state()

    def _back(self, saved: Any) -> None:
        if self.exchange_mode == "me":
            self.x = saved
            return
        self.slave.restore_state(saved)
        self.slave.free_state(saved)

    def save(self) -> Any:
        if self.exchange_mode == "me":
            return self.x.copy()
        if not self.can_restore:
            return None
        self._saved.append(self.slave.save_state())
        while len(self._saved) > KEPT:
            self.slave.free_state(self._saved.pop(0))
        return self._saved[-1]

    def restore(self, saved: Any) -> None:
        if self.exchange_mode == "me":
            self.x = saved.copy()
        elif saved is not None:
            self.slave.restore_state(saved)

    def linear(self) -> tuple[np.ndarray, ...] | None:
        """Return A, B, C, D at the present state from directional derivatives, or None where they are not offered."""
        description = self.fmu.description
        if not self.kind.directional_derivatives or not description.states:
            return None
        unknowns = [*description.derivatives, *self._y_names]
        try:
            J = self.slave.jacobian(unknowns, [*description.states, *self._u_names])
        except RotorsimError:
            return None
        n = len(description.states)
        return J[:n, :n], J[:n, n:], J[n:, :n], J[n:, n:]

    def close(self) -> None:
        """Free the instance and what was unpacked."""
        self.fmu.close()


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
    kind = option.interface or ("cs" if "cs" in kinds else "me")
    if kind not in kinds:
        offered = ", ".join(kinds) or "neither"
        fmu.close()
        raise RotorsimError(Problem(f"the FMU offers no '{kind}'", name, node.place, f"it offers {offered}"))
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
