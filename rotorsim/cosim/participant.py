"""Who takes part in a co-simulation: a compiled part of the diagram, or an FMU; to the master they are alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np

from rotorsim.linear.linearisation import entry_names
from rotorsim.model.instance import Instance, make_instance
from rotorsim.model.part import Part

__all__ = ["CompiledParticipant", "Held", "InputHistory", "Participant"]

AHEAD = 1e-6  # of an internal step: what is left to be taken when the inputs of a sample hit are set


class InputHistory(Protocol):
    """Inputs during a step: u(tau) for tau = t - start of the step."""

    def __call__(self, tau: float) -> np.ndarray: ...


class Held:
    """Inputs that stay as they are during a step."""

    def __init__(self, value: np.ndarray) -> None:
        self.value = value

    def __call__(self, tau: float) -> np.ndarray:
        return self.value


class Participant(Protocol):
    """A subsystem that a master advances from one communication point to the next.

    inputs, outputs: flat names, in the order of the vectors u (n_u,) and y (n_y,). feedthrough: (n_y, n_u), whether an
    output follows an input at the same instant. can_restore: a step can be taken back. has_rates: it tells the rates
    of its outputs. moving (n_y,): outputs that change between sample hits by themselves; following (n_y, n_u): those
    that move when an input does. The order of calls: `initialise`, `output` until the inputs fit, `start`, steps.
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    feedthrough: np.ndarray
    can_restore: bool
    has_rates: bool
    moving: np.ndarray
    following: np.ndarray

    def initialise(self, t: float, u: np.ndarray) -> None:
        """Begin at time t with inputs u, which may still change; sample hits wait for `start`."""

    def start(self, t: float, u: np.ndarray) -> None:
        """End the initialisation with inputs u: sample hits due at t are carried out."""

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        """Return the outputs of the present state for inputs u."""

    def output_rate(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return the rates of the outputs of the present state, for inputs u that move at a rate."""

    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        """Advance from t to t + h with inputs u(tau); return the outputs there for the inputs u(h)."""

    def next_hit(self, t: float) -> float:
        """Return the time of the next sample hit after t that it knows of, infinity if there is none."""

    def save(self) -> Any:
        """Return the state, to be given to `restore`."""

    def restore(self, saved: Any) -> None:
        """Go back to a saved state."""

    def close(self) -> None:
        """Free what it holds."""


class CompiledParticipant:
    """A compiled part of the diagram, advanced by its own Runge-Kutta steps.

    Within an internal step the inputs are those of its middle, so that moving inputs are met to second order; at a
    sample hit they are those of that time. An output that follows an input in steps only, as a relay does, does not
    move with it.
    """

    can_restore = True
    has_rates = True

    def __init__(
        self, name: str, part: Part, record: Sequence[str], p: np.ndarray, step: float, *, use_compiler: bool = True
    ) -> None:
        self.name, self.part, self.p, self.internal = name, part, p, step
        self.inputs = tuple(n for signal in part.inputs.values() for n in entry_names(signal.name, signal.shape))
        self.outputs = tuple(n for port in record for n in entry_names(port, part.shape_of(port)))
        self.instance: Instance = make_instance(part, tuple(record), p, use_compiler=use_compiler)
        self.n_z = part.n_z - len(self.inputs)
        self.feedthrough = self._feedthrough(record)
        self._row = np.zeros((1, self.instance.n_y))
        self.blocks = part.blocks
        self._longest = max((float(p[sampler.period]) for sampler in part.trace.samplers), default=0.0)

    def _feedthrough(self, record: Sequence[str]) -> np.ndarray:
        column = ca.vertcat(*[self.part.expression(port) for port in record]) if record else ca.SX(0, 1)
        trace, u = self.part.trace, self.part.trace.z[self.n_z :]
        rate = ca.SX.sym("rate", len(self.inputs))
        moving = ca.jtimes(column, ca.vertcat(trace.t, trace.x), ca.vertcat(ca.SX(1), trace.xdot))
        if self.inputs:
            moving += ca.jtimes(column, u, rate)
        self._rate = ca.Function("rate", [trace.t, trace.x, trace.z, trace.p, rate], [ca.densify(moving)])
        self.moving = np.asarray(_pattern(ca.jacobian(column, ca.vertcat(trace.t, trace.x))).any(axis=1))
        self.following = _pattern(ca.jacobian(column, u))
        found = np.zeros((column.numel(), len(self.inputs)), bool)
        if found.size:
            rows, columns = ca.jacobian_sparsity(ca.densify(column), u).get_triplet()
            found[np.array(rows, int), np.array(columns, int)] = True
        return found

    def initialise(self, t: float, u: np.ndarray) -> None:
        self.instance.x[:], z = self.part.initial(self.p)
        self.instance.z[:] = z
        self.instance.z[self.n_z :] = u

    def start(self, t: float, u: np.ndarray) -> None:
        self.instance.z[self.n_z :] = u
        self.instance.start(t)

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        self.instance.z[self.n_z :] = u
        return self.instance.record(t, self.instance.x)[: len(self.outputs)]

    def output_rate(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        self.instance.z[self.n_z :] = u
        return np.array(self._rate(t, self.instance.x, self.instance.z, self.p, rate)).ravel()

    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        count = max(1, math.ceil(h / self.internal - 1e-9))
        width = h / count
        for k in range(count):
            if self.part.trace.samplers:
                self._to_hits(t + k * width, width, u, k * width)
            else:
                self._run(t + k * width, width, u((k + 0.5) * width))
        return self.output(t + h, u(h))

    def _run(self, t: float, h: float, u: np.ndarray) -> None:
        self.instance.z[self.n_z :] = u
        self.instance.run(0, 1, t, h, 1, self._row)

    def _to_hits(self, start: float, h: float, u: InputHistory, before: float) -> None:
        """Take an internal step that stops just ahead of every sample hit, to set the inputs that are sampled there."""
        t, end = start, start + h
        ahead = min(0.5 * h, AHEAD * h + 4e-9 * self._longest)
        while end - t > 1e-12 * h:
            hit = self.instance.next_hit()
            due = hit <= end + 1e-9 * h
            goal = min(hit, end)
            short = goal - ahead if due else goal
            if short > t:
                self._run(t, short - t, u(before + 0.5 * (t + short) - start))
                t = short
            if due:
                self._run(t, max(goal - t, 0.0), u(before + max(goal, t) - start))
                t = max(goal, t)

    def next_hit(self, t: float) -> float:
        return self.instance.next_hit()

    def save(self) -> Any:
        return self.instance.save()

    def restore(self, saved: Any) -> None:
        self.instance.restore(saved)

    def close(self) -> None:
        """Nothing is held."""


def _pattern(jacobian: Any) -> np.ndarray:
    """Return where a matrix of expressions is not zero."""
    found = np.zeros(jacobian.shape, bool)
    rows, columns = ca.sparsify(ca.densify(jacobian)).sparsity().get_triplet()
    found[np.array(rows, int), np.array(columns, int)] = True
    return found
