"""An FMU as a participant of a co-simulation."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from dataclasses import dataclass
from itertools import compress
from typing import Any

import numpy as np

from rotorsim.cosim.inputs import Held, InputHistory, Polynomial
from rotorsim.cosim.participant import Participant
from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.model import FLOATS, ModelDescription
from rotorsim.fmi.ports import FmuPort
from rotorsim.fmi.runtime.binding import CallError
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.model_exchange import SAVED_STATES, ModelExchange
from rotorsim.fmi.runtime.slave import Fmu, Slave
from rotorsim.linear.linear_model import LinearModel
from rotorsim.linear.linearisation import entry_names

MOST_INTERNAL_STEPS = 10_000  # of Model Exchange, in one step
RATE_STEP = 1e-3  # of the last step, over which rates of outputs are taken
MOST_SUBSTEPS = 32
LISTED_MESSAGES = 5  # messages
HELD = 1e-12  # relative difference over a step within which inputs count as held


@dataclass(eq=False, kw_only=True)
class FmuParticipant(Participant):
    """An FMU behind the interface of a participant; its names are those of the ports of its block.

    moving, following: as of a compiled part; outputs of variability discrete do not move between events.
    Inputs and outputs are in SI units here. internal: step [s] within which inputs are seen as held.
    """

    name: str
    fmu: Fmu
    slave: Slave
    input_ports: dict[str, FmuPort]
    output_ports: dict[str, FmuPort]
    parameters: dict[str, Any]
    stop: float | None
    internal: float
    tolerance: float | None = None

    def __post_init__(self) -> None:
        self._last = self.internal  # step taken
        name, description = self.name, self.fmu.description
        ports = self.input_ports.values(), self.output_ports.values()
        self.blocks = (name,)
        self.inputs, self.outputs = (
            tuple(n for p in own for n in entry_names(f"{name}.{p.name}", p.shape)) for own in ports
        )
        self._u_names, self._y_names = ([entry for port in own for entry in port.entries] for own in ports)
        starts = [
            np.zeros(len(port.entries)) if port.start is None else np.ravel(port.start)
            for port in self.input_ports.values()
        ]
        self.u_starts = np.concatenate([np.zeros(0), *starts])
        self.u_scales, self.y_scales = _scales(self.input_ports), _scales(self.output_ports)
        self.kind = description.kinds[self.slave.kind]
        own = self.kind.fixed_step or description.experiment.step
        self.internal = min(self.internal, own) if own else self.internal
        shape = len(self._y_names), len(self._u_names)
        depends = [description.follows(y, u) for y in self._y_names for u in self._u_names]
        self.feedthrough = np.array(depends, bool).reshape(shape)
        self.moving = np.array([not port.discrete for port in ports[1] for _ in port.entries], bool)
        self.following = self.feedthrough & self.moving[:, None]
        self._begun = self._started = False

    def initialise(self, t: float, u: np.ndarray) -> None:
        if self._begun:
            self.slave.free_states()
            self.slave.reset()
        self._begun, self._started = True, False
        self.slave.setup(
            t,
            self.stop,
            self.tolerance,
            parameters=self.parameters,
            inputs=self._u_names,
            outputs=self._y_names,
            exit_initialisation=False,
        )

    def start(self, t: float, u: np.ndarray) -> None:
        self.output(t, u)
        self.slave.exit_initialisation()
        self._started = True

    def output_rate(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return rates of the outputs by a very short step that is taken back."""
        h = RATE_STEP * self._last
        before = self.output(t, u)
        return np.asarray((self._output_after(t, h, Polynomial([u, rate * h], h)) - before) / h)

    @abstractmethod
    def _output_after(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        """Return the outputs a very short time h later; the state stays as it is."""

    def _of_fmu(self, u: np.ndarray) -> np.ndarray:
        """Return inputs (n_u,) in the units of the FMU."""
        return u if self.u_scales is None else (u - self.u_scales[:, 1]) / self.u_scales[:, 0]

    def _si(self, y: np.ndarray) -> np.ndarray:
        """Return outputs (n_y,) in SI units."""
        return y if self.y_scales is None else self.y_scales[:, 0] * y + self.y_scales[:, 1]

    def in_loop(self) -> Slave:
        return self.slave

    @property
    def loop_is_exact(self) -> bool:
        return not self.equal_steps  # to the last bit

    @property
    def has_log(self) -> bool:
        return self.slave.log is not None

    def report(self) -> dict[str, Any]:
        """Return what is to be known of its run.

        do_steps; most_parts: of one step of the master; warnings: calls that returned a warning; messages: how many, by
        status; said: the last that are no mere news; texts: its outputs that are texts.
        """
        lines: list[tuple[str, str, str]] = []
        counts: dict[str, int] = {}
        texts: dict[str, str] = {}
        names = [v.name for v in self.fmu.description.by_causality("output") if v.type == "String" and not v.clocked]
        with contextlib.suppress(RotorsimError, CallError):
            lines, counts = self.slave.messages()
            texts = {name: ", ".join(self.slave.get([name])) for name in names if self._started}
        said = list(dict.fromkeys(f"{status}: {text}" for status, _, text in lines if status != "OK" and text))
        return {
            "interface": self.slave.kind,
            "do_steps": self.do_steps,
            "most_parts": self.most_parts,
            "warnings": self.slave.warned,
            "messages": counts,
            "said": said[-LISTED_MESSAGES:],
            "texts": texts,
        }

    def final(self) -> np.ndarray:
        """Return the outputs (n_y,) as they are, whatever the FMU is at. Raises RotorsimError."""
        return np.asarray(self._si(np.array(self.slave.get(self._y_names), float)))

    def linear(self, used: np.ndarray) -> LinearModel | str:
        """Return the linearisation at the present state by directional derivatives, or why there is none.

        used (n_y,): outputs that others take.
        """
        description = self.fmu.description
        if not self.kind.directional_derivatives:
            return "offers no directional derivatives"
        if self.next_hit(0.0) < np.inf:
            return "has time events, which directional derivatives do not show"
        local = [v for v in description.by_causality("local") if v.variability == "discrete"]
        outputs = zip(self._y_names, used, self.moving, strict=True)
        sampled = [v.name for v in local if v.type in FLOATS]  # whole numbers and flags are modes
        sampled += [name for name, taken, moves in outputs if taken and not (moves or _still(description, name))]
        if sampled:
            return f"has values that change at events ({sampled[0]}), which directional derivatives do not show"
        if self.slave.kind == "cs" and not description.states:
            return "does not tell its states"
        n = len(description.states)
        rows, columns = (
            np.array([True] * n + [entry.variable.type in FLOATS for entry in description.resolve(names)], bool)
            for names in (self._y_names, self._u_names)
        )
        stepped = np.flatnonzero(used.astype(bool) & ~rows[n:])
        if stepped.size:
            name = self._y_names[stepped[0]]
            return f"gives others whole numbers or flags ({name}), which have no derivatives"
        unknowns = list(compress([*description.derivatives, *self._y_names], rows))
        knowns = list(compress([*description.states, *self._u_names], columns))
        J = np.zeros((len(rows), len(columns)))
        try:
            if unknowns and knowns:
                J[np.ix_(rows, columns)] = self.slave.jacobian(unknowns, knowns)
        except RotorsimError as error:
            return error.problems[0].what
        if self.y_scales is not None:
            J[n:] *= self.y_scales[:, :1]
        if self.u_scales is not None:
            J[:, n:] /= self.u_scales[:, 0]
        return LinearModel(J[:n, :n], J[:n, n:], J[n:, :n], J[n:, n:])

    def close(self) -> None:
        """Free the instance and what was unpacked."""
        self.fmu.close()


class CoSimulationFmu(FmuParticipant):
    """An FMU that steps itself.

    Inputs that move during a step are met by substeps of its own step, each with the inputs of its middle, if it can
    vary its communication step; if it cannot, each step is one, and all must be equal. Where all outputs are sampled
    it is given the inputs of the end of the step, as its new outputs are seen from there on.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self.can_restore = self.kind.can_get_set_state
        self.has_rates = self.can_restore and self.kind.can_vary_step
        self.equal_steps = not self.kind.can_vary_step
        self._width = 0.0  # of all steps, where these must be equal
        self._sampled = bool(self._y_names) and not self.moving.any()

    def initialise(self, t: float, u: np.ndarray) -> None:
        super().initialise(t, u)
        self._width = 0.0

    def start(self, t: float, u: np.ndarray) -> None:
        super().start(t, u)
        if self.slave.ended:
            raise self.slave.end_asked(t)

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        return self._si(self.slave.exchange(self._of_fmu(u), t))

    def _output_after(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        saved = self.slave.save_state()
        after = self._advance(t, h, u, 1)
        self.slave.restore_state(saved)
        self.slave.free_state(saved)
        return after

    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        self._last = h
        if self.equal_steps:
            h = self._equal(t, h)
        if u.is_held or self._sampled:
            return self._advance(t, h, u if u.is_held else Held(u(h)), 1)
        start, end = u(0.0), u(h)
        moves = bool((np.abs(end - start) > HELD * (np.abs(end) + np.abs(start))).any())
        most = max(1, int(np.ceil(h / self.internal - 1e-9)))
        return self._advance(t, h, u, min(most, MOST_SUBSTEPS) if moves and not self.equal_steps else 1)

    def _equal(self, t: float, h: float) -> float:
        """Return the step that all steps have. Raises FmuError if this is another."""
        self._width = self._width or h
        if abs(h - self._width) <= 1e-9 * self._width + 8.0 * np.finfo(float).eps * abs(t):
            return self._width
        what = f"cannot vary its communication step: the first was {self._width:.9g} s, this would be one of {h:.9g} s"
        hint = "take fixed steps (no --adaptive) that divide the stop time and the sample times of the others"
        raise self.slave.step_failed("-", what, "refused", t, hint)

    def _advance(self, t: float, h: float, u: InputHistory, count: int) -> np.ndarray:
        """Take equal steps. Raises FmuError, also where the FMU asks for the end."""
        width = h / count
        self.most_parts = max(self.most_parts, count)
        for k in range(count):
            self.do_steps += 1
            try:
                y = self.slave.exchange(self._of_fmu(u((k + 0.5) * width)), t + k * width, width)
            except FmuError as failure:
                raise self.slave.end_of(failure, t + k * width) from None
            if self.slave.ended:
                raise self.slave.end_asked(t + (k + 1) * width)
        return self._si(y if u.is_held else self.slave.exchange(self._of_fmu(u(h)), t + h))

    def next_hit(self, t: float) -> float:
        return np.inf

    def save(self) -> Any:
        if not self.can_restore:
            return None
        handle = self.slave.save_state()
        self.slave.free_states(but=SAVED_STATES)
        return handle

    def restore(self, saved: Any) -> None:
        if saved is not None:
            self.slave.restore_state(saved)


class ModelExchangeFmu(FmuParticipant):
    """An FMU whose states are integrated here, from event to event."""

    def __post_init__(self) -> None:
        super().__post_init__()
        entries = self.fmu.description.resolve(self._u_names)
        discrete = [entry.variable.variability != "continuous" for entry in entries]
        self.integrator = ModelExchange(self.slave, np.array(discrete, bool))
        self.can_restore = self.has_rates = self.kind.can_get_set_state or not self.integrator.may_have_events

    def start(self, t: float, u: np.ndarray) -> None:
        super().start(t, u)
        self.integrator.method = self.method
        self.integrator.begin(t, self._of_fmu(u))

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        u = self._of_fmu(u)
        return self._si(self.integrator.output(t, u) if self._started else self.slave.outputs(t, None, u))

    def _output_after(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        return self._si(self.integrator.output_after(t, h, lambda tau: self._of_fmu(u(tau))))

    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        self._last = h
        own = u if self.u_scales is None else lambda tau: self._of_fmu(u(tau))
        self.integrator.advance(t, h, own, min(max(1, int(np.ceil(h / self.internal - 1e-9))), MOST_INTERNAL_STEPS))
        return self.output(t + h, u(h))

    def next_hit(self, t: float) -> float:
        return self.integrator.next_time

    def save(self) -> Any:
        return self.integrator.save()

    def restore(self, saved: Any) -> None:
        self.integrator.restore(saved)

    def unstable_step(self) -> str:
        return self.integrator.unstable_step()


def _still(description: ModelDescription, output: str) -> bool:
    """Return whether an output depends on parameters at most."""
    known = description.dependencies.get(output)
    return known is not None and all(description.variables[k].causality == "parameter" for k in known)


def _scales(ports: dict[str, FmuPort]) -> np.ndarray | None:
    """Return factors and offsets (n, 2) of all entries, or None where all are 1 and 0."""
    found = np.concatenate([np.zeros((0, 2)), *(port.scales for port in ports.values())])
    return None if (found == (1.0, 0.0)).all() else found
