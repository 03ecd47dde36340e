"""Least squares on the error of simulated runs: Levenberg-Marquardt with exact slopes, starts of runs as nuisances."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagnosis.evidence.waveform.data import TimeRun
from rotorsim.diagnosis.evidence.waveform.views import View

__all__ = ["Evaluation", "Point", "TimeSearch", "View"]

MOST_EVALUATIONS = 60
CLOSE = 1e-8  # relative fall of the cost below which a step was the last, twice
MOST_STEPS = 64  # between samples
LEAP = 4.0  # factor by which a positive parameter may change in a step
STABLE = 2.0  # largest |eigenvalue| times step
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-12, 1e8
AMPLITUDES = tuple(10.0**-k for k in range(0, 25, 2))
NEARBY = (100.0, 30.0, 10.0, 3.0, 0.3, 0.1)
WORSE = 4.0  # times the cost without the effect, of a start that is taken


@dataclass(frozen=True, eq=False)
class Point:
    """Where a search is: the free parameters theta (m,), and of each view the states at first samples (R, n)."""

    theta: np.ndarray
    starts: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Weighted errors and their slopes at a point.

    cost: sum of squares with priors. errors: of each view and run (N, c), measured less simulated, not weighted.
    gradient, information: J^T r and J^T J of all unknowns (theta, then starts). slopes: of each view and run
    (N, c, m + n) by theta and its start, not weighted; empty without slopes.
    """

    cost: float
    errors: tuple[tuple[np.ndarray, ...], ...]
    gradient: np.ndarray = field(default_factory=lambda: np.zeros(0))
    information: np.ndarray = field(default_factory=lambda: np.zeros(0))
    slopes: tuple[tuple[np.ndarray, ...], ...] = ()


class TimeSearch:
    """Views of a diagram beside R runs.

    weights: of the squares of the errors, for each view and run, (c,) or (N, c); zero leaves a sample out.
    least: steps between samples, at least. hold: "theta" or "starts" are not searched.
    """

    def __init__(
        self,
        views: Sequence[View],
        runs: Sequence[TimeRun],
        weights: Sequence[Sequence[np.ndarray]],
        *,
        least: int = 1,
        hold: str = "",
    ) -> None:
        self.views, self.runs = tuple(views), tuple(runs)
        self.weights = [list(each) for each in weights]
        self.measured = [[run.measured(view.outputs) for run in runs] for view in views]
        self.p = [views[0].equations.model.parameter_vector(run.settings) for run in runs]
        self.least, self.sub, self.hold = least, least, hold
        self._inputs: dict[tuple[int, int], tuple[int, np.ndarray]] = {}
        first = views[0].equations
        self.free, self.m = first.free, first.m
        extra = self.m - len(self.free)
        self.low = np.array([item.low for item in self.free] + [-np.inf] * extra)
        self.high = np.array([item.high for item in self.free] + [np.inf] * extra)
        self.prior = [j for j, item in enumerate(self.free) if item.prior_std is not None]

    def first(self, known: Mapping[str, Sequence[float]] | None = None) -> Point:
        """Return the point that the diagram states. known: "view:state" -> value at the start of each run."""
        theta = np.array([item.value for item in self.free] + [0.0] * (self.m - len(self.free)))
        every = []
        for view in self.views:
            eq = view.equations
            starts = np.array([eq.model.x0(p)[eq.kept] for p in self.p]).reshape(len(self.runs), eq.n)
            for k, name in enumerate(eq.state_names):
                given = (known or {}).get(f"{view.name}:{name}", ())
                if len(given) == len(self.runs):
                    starts[:, k] = given
                elif k in view.measured_states:
                    starts[:, k] = self._measured_start(view, k)
            every.append(starts)
        return Point(theta, tuple(every))

    def _measured_start(self, view: View, k: int) -> list[float]:
        """Return the first samples of a state that is measured as it is."""
        name, factor = view.measured_states[k]
        return [float(run.values[name][0]) / factor for run in self.runs]

    def shortened(self, samples: int) -> TimeSearch:
        """Return the search on the beginning of every run, as many samples in all; itself if there are no more."""
        total = sum(run.size for run in self.runs)
        if total <= samples:
            return self
        sizes = [max(round(run.size * samples / total), 2) for run in self.runs]
        runs = [run.first(size) for run, size in zip(self.runs, sizes, strict=True)]
        weights = [
            [w if w.ndim < 2 else w[:size] for w, size in zip(each, sizes, strict=True)] for each in self.weights
        ]
        return TimeSearch(self.views, runs, weights, least=self.least, hold=self.hold)

    def inputs(self, k: int, r: int) -> np.ndarray:
        """Return the inputs of a view in a run at the steps in use."""
        if (k, r) not in self._inputs or self._inputs[k, r][0] != self.sub:
            self._inputs[k, r] = self.sub, self.runs[r].inputs(self.views[k].equations.inputs, self.sub)
        return self._inputs[k, r][1]

    @cached_property
    def _rates(self) -> list[Any]:
        found = []
        for view in self.views:
            a, f = view.equations.arguments, view.equations.f
            found.append(ca.Function("A", [a["t"], a["x"], a["v"], a["p"]], [ca.densify(ca.jacobian(f, a["x"]))]))
        return found

    def resolve(self, point: Point) -> None:
        """Take as many steps between samples as the fastest mode at a point needs to be stable."""
        fastest = 0.0
        for k, view in enumerate(self.views):
            eq = view.equations
            for r, run in enumerate(self.runs):
                p = eq.parameters(self.p[r], point.theta[: eq.m])
                for x in (np.zeros(eq.n), point.starts[k][r]):
                    A = np.array(self._rates[k](run.start, x, self.inputs(k, r)[0, 0], p))
                    if A.size and np.isfinite(A).all():
                        fastest = max(fastest, float(np.abs(np.linalg.eigvals(A)).max()) * run.dt)
        wanted = self.least
        while wanted < fastest / STABLE and wanted < MOST_STEPS:
            wanted *= 2
        self.sub = wanted

    @np.errstate(over="ignore", invalid="ignore")
    def evaluate(self, point: Point, slopes: bool = True) -> Evaluation:
        """Return errors and slopes at a point; the cost is infinite where a run diverges."""
        m, R = self.m, len(self.runs)
        size = m + sum(starts.size for starts in point.starts)
        cost, at = 0.0, m
        errors, kept = [], []
        gradient, information = np.zeros(size), np.zeros((size, size))
        for k, view in enumerate(self.views):
            eq = view.equations
            found, sloped = [], []
            for r, run in enumerate(self.runs):
                p = eq.parameters(self.p[r], point.theta[: eq.m])
                y, dy = view.kernel.simulate(
                    p, point.starts[k][r], self.inputs(k, r), run.dt, t0=run.start, slopes=slopes
                )
                error = self.measured[k][r] - y
                if not np.isfinite(error).all() or (slopes and not np.isfinite(dy).all()):
                    return Evaluation(np.inf, ())
                root = np.sqrt(np.broadcast_to(self.weights[k][r], error.shape))
                e = (root * error).ravel()
                cost += float(e @ e)
                found.append(error)
                if slopes:
                    J = (-root[:, :, None] * dy).reshape(len(e), eq.m + eq.n)
                    where = np.r_[0 : eq.m, at + r * eq.n : at + (r + 1) * eq.n]
                    gradient[where] += J.T @ e
                    information[np.ix_(where, where)] += J.T @ J
                    sloped.append(-dy)
            at += R * eq.n
            errors.append(tuple(found))
            kept.append(tuple(sloped))
        if not np.isfinite(information).all():
            return Evaluation(np.inf, ())
        for j in self.prior:
            mean, std = float(self.free[j].prior_mean or 0.0), float(self.free[j].prior_std or 1.0)
            off = (point.theta[j] - mean) / std
            cost += off**2
            gradient[j] += off / std
            information[j, j] += 1 / std**2
        return Evaluation(cost, tuple(errors), gradient, information, tuple(kept) if slopes else ())

    def minimise(self, point: Point, most: int = MOST_EVALUATIONS) -> tuple[Point, Evaluation]:
        """Return the point of least cost that is found from one, within the bounds, and the evaluation there."""
        self.resolve(point)
        here = self.evaluate(point)
        damping, calm, used = FIRST_DAMPING, 0, 1
        while np.isfinite(here.cost) and used < most and calm < 2:
            step = self._step(point, here, damping)
            new = self._moved(point, step)
            after = self.evaluate(new, slopes=False)
            if after.cost < here.cost:
                calm = calm + 1 if after.cost > here.cost * (1 - CLOSE) else 0
                point, here = new, self.evaluate(new)
                damping = max(damping / 10, LEAST_DAMPING)
            else:
                damping *= 10
                calm += damping > MOST_DAMPING or bool(np.abs(step).max(initial=0.0) == 0.0)
            used += 1
        return point, here

    def _step(self, point: Point, here: Evaluation, damping: float) -> np.ndarray:
        m = self.m
        scale = np.sqrt(np.diag(here.information))
        scale = np.where(scale > 0, scale, 1.0)
        held = np.zeros(len(scale), bool)
        held[:m] = self.at_bound(point) & (np.where(point.theta <= self.low, 1, -1) * here.gradient[:m] > 0)
        held[:m] |= self.hold == "theta"
        held[m:] = self.hold == "starts"
        H = here.information / np.outer(scale, scale) + damping * np.eye(len(scale))
        g = np.where(held, 0.0, here.gradient / scale)
        H[held], H[:, held] = 0.0, 0.0
        H[held, held] = 1.0
        return np.asarray(-np.linalg.lstsq(H, g, rcond=1e-14)[0] / scale)

    def _moved(self, point: Point, step: np.ndarray) -> Point:
        at, every = self.m, []
        for starts in point.starts:
            every.append(starts + step[at : at + starts.size].reshape(starts.shape))
            at += starts.size
        size = np.where(self.low > 0, point.theta, np.inf)  # what is positive goes down a factor at a time
        low = np.maximum(self.low, np.where(self.low > 0, size / LEAP, -np.inf))
        return Point(np.clip(point.theta + step[: self.m], low, np.minimum(self.high, size * LEAP)), tuple(every))

    def at_bound(self, point: Point) -> np.ndarray:
        """Return which free parameters are at a bound, (m,)."""
        return np.asarray((point.theta <= self.low) | (point.theta >= self.high))

    def started(self, point: Point, values: Mapping[str, float], old: Collection[str] = ()) -> Point | None:
        """Return a point with some free parameters set, an effect made small enough that the runs stay as they were.

        Blocks state their starts for machines of usual size; an effect that is absent at zero is made smaller until
        its cost is within WORSE times that without it, and from there takes the size of NEARBY that costs least. None
        where no start is found. old: names that are no effect.
        """
        names = [item.name for item in self.free]
        theta = point.theta.copy()
        named = [names.index(name) for name in values if name in names]
        for j in named:
            theta[j] = np.clip(values[names[j]], self.low[j], self.high[j])
        new = [j for j in named if names[j] not in old]
        amplitudes = [j for j in new if theta[j] != 0 and self.low[j] <= 0 <= self.high[j]]
        groups = [*([j] for j in amplitudes), *([amplitudes] if len(amplitudes) > 1 else [])]
        absent = [self._cost(_put(theta, group, 0.0), point) for group in groups]
        least = min(absent, default=np.inf)
        shrunk = groups[int(np.argmin(absent))] if np.isfinite(least) else []
        for factor in AMPLITUDES if shrunk else (1.0,):
            scaled = theta.copy()
            scaled[shrunk] *= factor
            cost = self._cost(scaled, point)
            if not np.isfinite(cost) or (shrunk and cost > WORSE * least):
                continue
            trials = [(cost, scaled)]
            for nearby in NEARBY if shrunk else ():
                other = scaled.copy()
                other[shrunk] *= nearby
                other = np.clip(other, self.low, self.high)
                trials.append((self._cost(other, point), other))
            return Point(min(trials, key=lambda pair: pair[0])[1], point.starts)
        return None

    def _cost(self, theta: np.ndarray, point: Point) -> float:
        trial = Point(theta, point.starts)
        self.resolve(trial)
        return self.evaluate(trial, slopes=False).cost


def _put(theta: np.ndarray, where: Sequence[int], value: float) -> np.ndarray:
    new = theta.copy()
    new[list(where)] = value
    return new
