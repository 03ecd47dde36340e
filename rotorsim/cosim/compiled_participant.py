"""A compiled part of the diagram as a participant of a co-simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.cosim.inputs import InputHistory
from rotorsim.cosim.loop import PartMember
from rotorsim.cosim.participant import Participant
from rotorsim.linear.linear_model import LinearModel, LinearPart
from rotorsim.linear.linearisation import entry_names
from rotorsim.model.instance import CompiledInstance, Instance, make_instance
from rotorsim.model.part import Part

AHEAD = 1e-6  # of an internal step: what is left to be taken when the inputs of a sample hit are set


class CompiledParticipant(Participant):
    """A compiled part of the diagram, advanced by its own Runge-Kutta steps.

    Within an internal step the inputs are those of its middle, so that moving inputs are met to second order; at a
    sample hit they are those of that time. An output that follows an input in steps only, as a relay does, does not
    move with it.
    """

    def __init__(
        self, name: str, part: Part, record: Sequence[str], p: np.ndarray, step: float, *, use_compiler: bool = True
    ) -> None:
        self.name, self.part, self.p, self.internal, self.blocks = name, part, p, step, part.blocks
        self.inputs = tuple(n for signal in part.inputs.values() for n in entry_names(signal.name, signal.shape))
        self.outputs = tuple(n for port in record for n in entry_names(port, part.shape_of(port)))
        library = part.library(tuple(record)) if use_compiler else None
        self._compiled = CompiledInstance(part, library, p) if library else None
        self.instance: Instance = self._compiled or make_instance(part, tuple(record), p, use_compiler=False)
        self.n_z = part.n_z - len(self.inputs)
        self._row = np.zeros((1, self.instance.n_y))
        self._longest = max((float(p[sampler.period]) for sampler in part.trace.samplers), default=0.0)
        column = ca.vertcat(*[part.expression(port) for port in record]) if record else ca.SX(0, 1)
        trace, u = part.trace, part.trace.z[self.n_z :]
        rate = ca.SX.sym("rate", len(self.inputs))
        moving = ca.jtimes(column, ca.vertcat(trace.t, trace.x), ca.vertcat(ca.SX(1), trace.xdot))
        if self.inputs:
            moving += ca.jtimes(column, u, rate)
        self._rate = ca.Function("rate", [trace.t, trace.x, trace.z, trace.p, rate], [ca.densify(moving)])
        self.moving = np.asarray(_nonzero(ca.jacobian(column, ca.vertcat(trace.t, trace.x))).any(axis=1))
        self.following = _nonzero(ca.jacobian(column, u))
        known = column.numel() and len(self.inputs)
        depends = ca.jacobian_sparsity(ca.densify(column), u) if known else ca.Sparsity(*self.following.shape)
        self.feedthrough = _pattern(depends)

    def initialise(self, t: float, u: np.ndarray) -> None:
        self.instance.x[:], self.instance.z[:] = self.part.initial(self.p)
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

    def linear(self, used: np.ndarray) -> LinearModel | str:
        return LinearPart(self.part, self.n_z, self.outputs).at(self.p)

    def in_loop(self) -> PartMember:
        sizes = self.n_z, len(self.inputs), len(self.outputs)
        return PartMember(self.name, self._compiled, self.internal, *sizes)

    @property
    def loop_is_exact(self) -> bool:
        return not self.part.trace.samplers  # a step here stops at their hits


def _nonzero(jacobian: Any) -> np.ndarray:
    """Return where a matrix of expressions is not zero."""
    return _pattern(ca.sparsify(ca.densify(jacobian)).sparsity())


def _pattern(sparsity: Any) -> np.ndarray:
    """Return a sparsity of CasADi as an array."""
    found = np.zeros(sparsity.shape, bool)
    rows, columns = sparsity.get_triplet()
    found[np.array(rows, int), np.array(columns, int)] = True
    return found
