"""What the declared laws would explain at their places, before any of them is put into the diagram.

Beside a fit a law y = law(s; eta) adds d(eta) at its place, and the channels answer linearly, as the diagram does about
its settled motion (of one that is not linear, orders answer to one another):

residual = T (d + dd/deta deta) + J dtheta + nuisances + noise

s is what the place carries: as the diagram says where it explains the data, else with the free harmonics at the place
that explain most, so that the law's own effect on the motion is in it. One such step from the best declared start
leaves what a fit leaves, exactly where the diagram is linear, d is linear in eta, and J does not change with theta.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagnosis.catalogue.insertion import (
    LAW_ALONE,
    STARTS_TRIED,
    Insertion,
    fixed_of,
    limits_of,
    scales_of,
    sizes_at,
    starts_of,
)
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Promise
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit, is_adequate
from rotorsim.diagnosis.evidence.harmonic.fitting import START_ANGLES
from rotorsim.diagnosis.evidence.harmonic.periodic_law import PeriodicLaw
from rotorsim.diagnosis.evidence.harmonic.placed_law import PlacedLaw, entries_of, placed_law
from rotorsim.diagnosis.evidence.harmonic.projection import basis_of, lengths_of, with_delay
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.diagram.diagram import Free
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.identification.waveform.driven.equations import driven_equations
from rotorsim.model.compiled import Model
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.balance import samples_of
from rotorsim.settled.equations import Equations, is_linear
from rotorsim.settled.motion import Prediction
from rotorsim.signals.covariance import real_columns

TURN = 2 * np.pi
SAMPLES_PER_ORDER = 8  # of a law in time: of a corner, orders fall with their square, so that folded ones are 2 %
INDEPENDENT = 1e-9  # relative: singular values of slopes that are none
LEFT_BESIDE = 1e-3  # of the effect of a harmonic, or a parameter, that others leave: less is drowned in noise


@dataclass(frozen=True, eq=False)
class LawsBeside:
    """The laws that may be missing beside a fit, for a process of its own."""

    runs: HarmonicRuns
    fit: Fit

    def promises(self, items: Sequence[Insertion]) -> list[Promise | None]:
        """Return what laws leave by linear theory, None where that is not known."""
        try:
            beside = _Beside(self.runs, self.fit, items)
        except FAILURES:
            return [None] * len(items)
        largest = self.runs.largest()
        return [beside.promise(item, largest) for item in items]


class _Beside:
    """A fit of a diagram with every input where a law may act, for R runs; rows: of all of them."""

    def __init__(self, runs: HarmonicRuns, fit: Fit, items: Sequence[Insertion]) -> None:
        diagram = runs.load(values_in(fit.document, fit.values))
        found = {item.key: placed_law(diagram, item) for item in items}
        self.laws = {key: one for key, one in found.items() if one is not None}
        ports = dict.fromkeys(
            name.partition("[")[0] for one in self.laws.values() for some in one.moved for name in some
        )
        self.runs, self.adequate = runs, is_adequate(fit)
        self.experiment = runs.open(diagram, inject=[*ports])
        self.motion, self.theta = self.experiment.motion, self.experiment.theta0
        self.laws = {key: one for key, one in self.laws.items() if not self._is_set(one.item)}
        self.likelihood = Likelihood(self.experiment)
        self.K = self.likelihood.K
        self.inputs = {name: k for k, name in enumerate(name for port in ports for name in entries_of(diagram, port))}
        evaluation, self.prediction = self.likelihood.evaluated(self.theta)
        if not self.prediction.settled.all():
            raise ValueError("no periodic motion was found")
        self.nuisances = [basis_of(columns) for columns in self.likelihood.nuisances(self.prediction, evaluation.Y)]
        self.residual, self.jacobian = with_delay(evaluation)
        self.parameters = basis_of(self.jacobian)
        self.left = self.residual - self.parameters @ (self.parameters.T @ self.residual)
        speeds, count = self.motion.speeds, SAMPLES_PER_ORDER * (self.K + 1)
        start = -np.sign(speeds) * self.motion.phase / np.abs(speeds)  # where the shaft angle is zero
        self.times = start[:, None] + TURN / np.abs(speeds)[:, None] * np.arange(count) / count
        self._driven: dict[Any, PeriodicLaw | None] = {}
        self._along: dict[Any, np.ndarray] = {}

    def _is_set(self, item: Insertion) -> bool:
        """Return whether runs differ in the parameters of the block that an insertion takes the place of."""
        own = f"{item.name}."
        parts = [part for name, part in self.experiment.model.parameters.items() if name.startswith(own)]
        return any(np.ptp(self.experiment.p[:, part], axis=0).any() for part in parts)

    def promise(self, item: Insertion, largest: Mapping[str, float]) -> Promise | None:
        """Return what a law leaves by the step from its best start; None where that is not known."""
        with suppress(*FAILURES):
            return self._promise(item, largest)
        return None

    def _promise(self, item: Insertion, largest: Mapping[str, float]) -> Promise | None:
        one, sizes = self.laws.get(item.key), sizes_at(item, largest)
        given = starts_of(item, sizes)
        values = {**scales_of(item, given[0]), **fixed_of(item, sizes)}
        law = None if one is None else self._law(one, values, limits_of(item, sizes))
        if one is None or law is None or (signals := self._signals(one)) is None:
            return None
        starts = [np.array([*start.values()]) for start in given[:STARTS_TRIED]]
        eta, step = self._best(one, law, starts, signals)
        angles = [free.unit == ANGLE_UNIT and free.low == -np.inf for free in law.equations.free]
        turns = np.eye(len(eta))[angles]
        turned = self._steps(one, law, [*(eta + turns)], signals)
        for turn in (turn for turn, other in zip(turns, turned, strict=True) if not step.spans(other.added)):
            around = [eta + turn * k * TURN / START_ANGLES for k in range(1, START_ANGLES)]
            other = self._best(one, law, around, signals)
            eta, step = other if other[1].misfit < step.misfit else (eta, step)
        std = dict(zip(item.fault.free, step.std.tolist(), strict=True))
        sized = all(angle or key in item.fault.sizes for key, angle in zip(item.fault.free, angles, strict=True))
        exact = sized and self.motion.is_linear and law.is_affine(self._follow_states(one))
        start = {} if exact else self._start(one, law, eta, step, signals)
        return Promise(step.misfit, start, without=float(self.left @ self.left), exact=exact, std=std)

    def _start(
        self, one: PlacedLaw, law: PeriodicLaw, eta: np.ndarray, step: _Step, signals: np.ndarray
    ) -> dict[str, float]:
        """Return the parameters of a law and of the diagram after the step from eta, within their bounds.

        Of a law that is not linear a start beside the parameters of the diagram alone may lead to no motion at all.
        What would change by more than itself is not told by linear theory, but for a parameter that the law is linear
        in: of the diagram it is left out.
        """
        change = step.best(self.left)
        told = _told(law.equations.free, eta, change) | law.linear_in()
        eta = law.within(eta + np.where(told, change, 0.0))
        added = law.added(eta, self.times, signals, self.motion.speeds, self.K)[..., :1]
        white = np.concatenate(self._without_nuisances(self.likelihood.white(real_columns(self._answers(one, added)))))
        rest = self.residual - np.pad(white[:, 0], (0, len(self.residual) - len(white)))
        free, scale = self.experiment.free, lengths_of(self.jacobian)[0]
        moved = (-np.linalg.lstsq(self.jacobian / scale, rest, rcond=LEFT_BESIDE)[0] / scale)[: len(free)]
        theta = np.clip(self.theta + moved, [item.low for item in free], [item.high for item in free]).tolist()
        every = zip(free, theta, _told(free, self.theta, moved), strict=True)
        start = {item.name: value for item, value, known in every if known}
        return start | dict(zip(one.item.free, eta.tolist(), strict=True))

    def _best(
        self, one: PlacedLaw, law: PeriodicLaw, starts: Sequence[np.ndarray], signals: np.ndarray
    ) -> tuple[np.ndarray, _Step]:
        steps = self._steps(one, law, starts, signals)
        return min(zip(starts, steps, strict=True), key=lambda pair: pair[1].misfit)

    def _steps(
        self, one: PlacedLaw, law: PeriodicLaw, starts: Sequence[np.ndarray], signals: np.ndarray
    ) -> list[_Step]:
        """Return the linear steps from some starts (m,) of a law."""
        if not starts:
            return []
        added = [law.added(law.within(eta), self.times, signals, self.motion.speeds, self.K) for eta in starts]
        columns = self._beside(self._answers(one, np.concatenate(added, axis=3)))
        return [_Step(self.left, part) for part in np.split(columns, len(starts), axis=1)]

    def _answers(self, one: PlacedLaw, added: np.ndarray) -> np.ndarray:
        """Return what signals that a law adds (R, K+1, c, k) change in the channels, (R, orders, channels, k)."""
        channels = self.experiment.predicted
        out = np.zeros((len(added), self.likelihood.orders, len(channels), added.shape[3]), complex)
        within = out[:, : self.K + 1]
        if any(one.moved):
            within += self.prediction.answers(*self._moved(one, added))
        for j, read in enumerate(one.read):
            for name in read:
                if name in channels:
                    within[:, :, channels.index(name)] += added[:, :, j]
        return out

    def _moved(self, one: PlacedLaw, added: np.ndarray) -> tuple[np.ndarray, list[int]]:
        """Return what signals that a law adds (R, K+1, c, k) make of inputs, (R, K+1, v, k), and which v these are."""
        pairs = [(j, self.inputs[name]) for j, names in enumerate(one.moved) for name in names]
        return added[:, :, [j for j, _ in pairs]], [k for _, k in pairs]

    def _beside(self, answers: np.ndarray) -> np.ndarray:
        """Return changes of the channels (R, orders, channels, k) whitened, without what is free, (rows, k)."""
        columns = np.concatenate(self._without_nuisances(self.likelihood.white(real_columns(answers))))
        columns = np.pad(columns, ((0, len(self.left) - len(columns)), (0, 0)))
        return np.asarray(columns - self.parameters @ (self.parameters.T @ columns))

    def _without_nuisances(self, white: np.ndarray) -> list[np.ndarray]:
        """Return whitened columns (R, n, k) without the nuisances of each run, R of (n, k)."""
        return [own - base @ (base.T @ own) for own, base in zip(white, self.nuisances, strict=True)]

    # -- what places carry ---------------------------------------------------------------------------------------------

    @cached_property
    def _timed(self) -> dict[str, np.ndarray]:
        """Signals that follow time and parameters alone, (R, N): angle and speed of the shaft."""
        model, p = self.experiment.model, self.motion.p
        trace = model.trace
        names = [name for name in self._sources if name not in self._states]
        if not names:
            return {}
        column = ca.vertcat(*[model.expression(name) for name in names])
        none = [ca.SX(model.z0(model.p0)), ca.SX.zeros(*trace.v.shape)]
        [column] = ca.substitute([column], [trace.z, trace.v], none)
        values = MatrixFunction([trace.t, trace.p], ca.densify(column))
        found = values(self.times.reshape(1, -1), np.repeat(p, self.times.shape[1], 0).T).reshape(*self.times.shape, -1)
        return dict(zip(names, np.moveaxis(found, 2, 0), strict=True))

    @cached_property
    def _sources(self) -> list[str]:
        return list(dict.fromkeys(name for one in self.laws.values() for name in one.sources))

    @cached_property
    def _states(self) -> dict[str, int]:
        """Signals that follow the states, and their order."""
        model = self.experiment.model
        names = [name for name in self._sources if ca.depends_on(model.expression(name), model.trace.x)]
        return {name: k for k, name in enumerate(names)}

    def _follow_states(self, one: PlacedLaw) -> list[int]:
        return [k for k, name in enumerate(one.sources) if name in self._states]

    @cached_property
    def _carried(self) -> Prediction | None:
        """Their settled motion; None where a linear diagram is not linear in them."""
        model, motion = self.experiment.model, self.motion
        plain = Model(replace(model.diagram, measured={}), model.trace)  # as they are, not as recordings read them
        if motion.is_linear and not is_linear(plain, [*self._states]):
            return None
        equations = Equations(plain, [*self._states], self.experiment.free, motion.p, linear=motion.is_linear)
        other = motion.reading(equations)
        if motion.is_linear:
            return other.predict(self.theta)
        other.begin_from(motion, np.arange(len(motion.p)), self.theta)
        means = []
        slow = zip(motion.slow_states(self.theta), other.slow_states(self.theta), self.prediction.means, strict=True)
        for here, there, values in slow:  # other outputs follow other states
            known = dict(zip(motion.equations.kept[here].tolist(), values.tolist(), strict=True))
            means.append(np.array([known.get(k, 0.0) for k in equations.kept[there].tolist()]))
        found = other.predict(self.theta, means)
        return found if found.settled.all() else None

    @cached_property
    def _carried_by_theta(self) -> np.ndarray:
        assert self._carried is not None
        return self._carried.sensitivity()[:, : self.K + 1]

    def _signals(self, one: PlacedLaw) -> np.ndarray | None:
        """Return what drives a law at the samples of a turn, (R, N, n_v); None where that is not linear."""
        if not self._follow_states(one):
            along = np.zeros((*self.times.shape, 0))
        elif (carried := self._carried) is None:
            return None
        else:
            key = () if self.adequate else (one.moved, one.read)
            if key not in self._along:
                harmonics = carried.Y[:, : self.K + 1] if self.adequate else self._freed(one, carried)
                self._along[key] = samples_of(harmonics, self.times.shape[1])
            along = self._along[key]
        states = self._states
        columns = [along[:, :, states[key]] if key in states else self._timed[key] for key in one.sources]
        return np.stack(columns, axis=2) if columns else along

    def _freed(self, one: PlacedLaw, carried: Prediction) -> np.ndarray:
        """Return harmonics of signals with the free ones at a place, and the parameters, that explain most."""
        Y, by_theta = carried.Y[:, : self.K + 1], self._carried_by_theta
        (R, orders, _), c = Y.shape, len(one.moved)
        unit = np.eye(c * orders).reshape(orders, c, -1)
        unit = np.concatenate([unit, 1j * unit[:, :, c:]], axis=2)  # a mean is real
        white = self.likelihood.white(real_columns(self._answers(one, np.broadcast_to(unit, (R, *unit.shape)))))
        size = lengths_of(white)  # as it is: of what nuisances or others take up, nothing is known
        free = self._without_nuisances(white / size)
        n = free[0].shape[0]
        both = np.column_stack([self.jacobian, self.residual])
        pairs = zip(np.split(both[: R * n], R), map(basis_of, free), strict=True)
        rest = [own - base @ (base.T @ own) for own, base in pairs]
        together, scale = np.concatenate([*rest, both[R * n :]]), lengths_of(self.jacobian)[0]
        theta = -np.linalg.lstsq(together[:, :-1] / scale, together[:, -1], rcond=LEFT_BESIDE)[0] / scale
        left = (self.residual + self.jacobian @ theta)[: R * n].reshape(R, n)
        moved = by_theta @ theta[: by_theta.shape[3]]
        best = [np.linalg.lstsq(own, left[r], rcond=LEFT_BESIDE)[0] / size[r, 0] for r, own in enumerate(free)]
        if any(one.moved):
            added = np.stack([unit @ factors for factors in best])
            moved = moved + carried.answers(*self._moved(one, added[..., None]))[..., 0]
        return np.asarray(Y + moved)

    def _law(
        self, one: PlacedLaw, values: Mapping[str, float], limits: Mapping[str, tuple[float, float]]
    ) -> PeriodicLaw | None:
        """Return a law alone; None where it does not stand alone."""
        document = one.document(values, limits)
        key = repr((one.item.kind, document["blocks"], document["wires"], document["identify"], one.outputs))
        if key not in self._driven:
            self._driven[key] = None
            with suppress(*FAILURES):
                diagram = self.runs.load(document)
                outputs = [entries_of(diagram, f"{LAW_ALONE}.{port}")[k] for port, k in one.outputs]
                inputs = [name for port in one.inputs for name in entries_of(diagram, f"{port}.output")]
                taken = np.array([one.sources.index(name) if name else -1 for name in one.taken], int)
                equations = driven_equations(diagram, outputs, inputs, diagram.free)
                self._driven[key] = PeriodicLaw(equations, taken)
        return self._driven[key]


def _told(free: Sequence[Free], value: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return which changes of parameters linear theory tells, (m,): of angles, and those smaller than the value."""
    angle = np.array([item.unit == ANGLE_UNIT for item in free], bool)
    return np.asarray(angle | (np.abs(change) < np.abs(value)))


class _Step:
    """A linear step from a start: columns (rows, 1 + m), what the law adds there and its derivatives.

    misfit: what it leaves. std (m,): of the parameters.
    """

    def __init__(self, left: np.ndarray, columns: np.ndarray) -> None:
        self.added, slopes = columns[:, 0], columns[:, 1:]
        size = lengths_of(slopes)[0]
        U, s, V = np.linalg.svd(slopes / size, full_matrices=False)
        kept = s > INDEPENDENT * s.max(initial=0.0)
        self.base = U[:, kept]
        self._factors = (V[kept] / s[kept, None]).T / size[:, None]
        self.std = np.linalg.norm(self._factors, axis=1)
        rest = self._without(left - self.added)
        self.misfit = float(rest @ rest)

    def best(self, left: np.ndarray) -> np.ndarray:
        """Return the step of the parameters (m,) that leaves the misfit."""
        return np.asarray(self._factors @ (self.base.T @ (left - self.added)))

    def spans(self, added: np.ndarray) -> bool:
        """Return whether the slopes make up what the law adds elsewhere."""
        rest = self._without(added)
        return float(rest @ rest) <= INDEPENDENT * float(added @ added)

    def _without(self, column: np.ndarray) -> np.ndarray:
        for _ in range(2):  # of a start far too large, the first leaves its rounding
            column = column - self.base @ (self.base.T @ column)
        return column
