"""Output-error estimation: Levenberg-Marquardt on the residuals of simulated runs, starts of runs as nuisances.

SciPy's `least_squares` ends at the same parameters where the data determine them, with as many simulations. Where they
do not, as of most fault candidates, it leaps along what is undetermined: up to 2.6 times the simulations on the
carriage of EMPS, with parameters beyond all sizes. Here a positive parameter changes by a factor LEAP at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from math import pi, tau

import numpy as np

from rotorsim.diagram.diagram import Free
from rotorsim.errors import RotorsimError
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.evaluation import Evaluation, Label, weighted_blocks
from rotorsim.identification.waveform.recorded.data import STABLE_STEP, SampledRun
from rotorsim.jobs.threads import several_threads, side_by_side
from rotorsim.model.heard import BARRED, gives_up

MOST_SIMULATIONS = 60  # what data determine takes up to 25
REFIT_EVALUATIONS = 15  # of a fit that starts where a similar one ended
SEARCH_COST_TOLERANCE = (
    1e-8  # relative fall of the cost below which a step was the last, twice: far below one unit of a misfit
)
SIMULATION_SUBSTEPS = 64  # between samples: a matter of time
LEAP = 4.0  # factor by which a positive parameter may change in a step
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-12, 1e8  # of the scaled information: nearly none, none, no step
WEAK = (
    1e-8  # times the information on the state that shows best: to show as much, it would have to move 1e4 times as far
)


def _promised(here: Evaluation, step: np.ndarray) -> float:
    """Return by how much the cost falls in a step if the outputs are linear in the unknowns."""
    return -float(2 * here.gradient @ step + step @ here.information @ step)


@dataclass(frozen=True, eq=False)
class OutputErrorSearch:
    """Subsystems of a diagram beside R runs.

    weights: of the squares of residuals by (subsystem, output). least: steps between samples, at least. hold: "theta"
    or "starts" are not searched. unused: samples of each run that count nothing. stepped: whether linear subsystems are
    simulated in steps, too. continued: whether laws go on beyond where they are defined. within: limits of some free
    parameters, narrower than their bounds.
    """

    systems: tuple[Simulation, ...]
    runs: Sequence[SampledRun]
    weights: Mapping[tuple[str, str], float]
    least: int = 1
    hold: str = ""
    unused: Sequence[slice] = ()
    stepped: bool = False
    continued: bool = False
    within: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def free(self) -> tuple[Free, ...]:
        """The free parameters."""
        return self.systems[0].equations.free

    @property
    def m(self) -> int:
        """The number of free parameters, with the coefficients of a force map."""
        return self.systems[0].equations.m

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Subsystems and runs."""
        return [*product(range(len(self.systems)), range(len(self.runs)))]

    @cached_property
    def measured(self) -> list[list[np.ndarray]]:
        """The measured outputs of each subsystem and run, (N, c)."""
        return [[run.measured(system.equations.outputs) for run in self.runs] for system in self.systems]

    @cached_property
    def _ranges(self) -> dict[str, tuple[float, float]]:
        """The least and the largest value of what drives the runs, in all of them."""
        names = {name for run in self.runs for name in run.kinds if name in run.values}
        every = {name: [run.values[name] for run in self.runs if name in run.values] for name in names}
        return {name: (min(map(np.min, own)), max(map(np.max, own))) for name, own in every.items()}

    @cached_property
    def p(self) -> list[np.ndarray]:
        """The parameters of the model in each run, (n_p,)."""
        return [self.systems[0].equations.model.parameter_vector(run.settings) for run in self.runs]

    @cached_property
    def bounds(self) -> np.ndarray:
        """The lower and upper bounds of the unknowns, (2, q); those of starts are infinite."""
        size = self.m + len(self.runs) * sum(system.equations.n for system in self.systems)
        bounds = np.repeat([[-np.inf], [np.inf]], size, axis=1)
        limits = [self.within.get(item.name, (item.low, item.high)) for item in self.free]
        bounds[:, : len(self.free)] = np.array(limits).reshape(-1, 2).T
        return bounds

    def at_bound(self, unknowns: np.ndarray) -> np.ndarray:
        """Return which unknowns are at a bound, (q,)."""
        return np.asarray((unknowns <= self.bounds[0]) | (unknowns >= self.bounds[1]))

    def columns(self, k: int, r: int) -> np.ndarray:
        """Return which unknowns a subsystem depends on in a run: its parameters, then its states at the first sample.

        Parameters of subsystems are the first of those of the whole.
        """
        n = self.systems[k].equations.n
        first = self.m + len(self.runs) * sum(system.equations.n for system in self.systems[:k]) + r * n
        return np.concatenate([np.arange(self.systems[k].equations.m), np.arange(first, first + n)])

    def root(self, k: int, r: int) -> np.ndarray:
        """Return the square roots of the weights of a subsystem's outputs in a run, (N, c)."""
        system = self.systems[k]
        weights = [self.weights[signal] for signal in system.signals]
        root: np.ndarray = np.where(np.isfinite(self.measured[k][r]), np.sqrt(weights), 0.0)
        if self.unused:
            root[self.unused[r]] = 0.0
        return root

    @cached_property
    def labels(self) -> list[Label]:
        """The names of the states at the first samples among the unknowns."""
        pairs = product(self.systems, range(len(self.runs)))
        return [(system.name, state, r) for system, r in pairs for state in system.equations.state_names]

    def first(self, known: Mapping[Label, float] | None = None) -> np.ndarray:
        """Return the unknowns that the diagram states; known: states at the first samples, as `starts` returns them."""
        starts: list[float] = []
        known, theta = known or {}, [item.value for item in self.free] + [0.0] * (self.m - len(self.free))
        for system, (r, run) in product(self.systems, enumerate(self.runs)):
            eq = system.equations
            start = eq.model.x0(self.p[r])[eq.kept]
            for k, (output, factor) in eq.measured_states.items():
                there = np.flatnonzero(np.isfinite(run.values.get(output, ())))
                start[k] = run.values[output][there[0]] / factor if len(there) else start[k]
            given = {
                k: known[label] for k, name in enumerate(eq.state_names) if (label := (system.name, name, r)) in known
            }
            start[[*given]] = [*given.values()]
            p, v = eq.parameters(self.p[r], np.array(theta[: eq.m])), run.inputs(eq.inputs, 1)[0, 0]
            starts += eq.beginning(run.start, start, v, p, given.keys() | eq.measured_states.keys()).tolist()
        return np.array([*theta, *starts])

    def starts(self, unknowns: np.ndarray) -> dict[Label, float]:
        """Return the states at the first samples."""
        return dict(zip(self.labels, unknowns[self.m :].tolist(), strict=True))

    def shortened(self, samples: int) -> OutputErrorSearch:
        """Return the search on the beginning of every run, as many samples in all; itself if there are no more."""
        total = sum(run.size for run in self.runs)
        if total <= samples:
            return self
        return replace(self, runs=[run.first(max(round(run.size * samples / total), 2)) for run in self.runs])

    def substeps(self, unknowns: np.ndarray) -> int:
        """Return as many steps between samples as the fastest mode at a point needs to be stable."""
        fastest, longest = 0.0, np.array([run.dt if run.steps is None else float(run.steps.max()) for run in self.runs])
        time = np.array([run.start for run in self.runs])
        for k, system in enumerate(self.systems):
            eq = system.equations
            if all(self.is_exact(k, r) for r in range(len(self.runs))):
                continue
            own = [unknowns[self.columns(k, r)] for r in range(len(self.runs))]
            p = np.stack([eq.parameters(given, part[: eq.m]) for given, part in zip(self.p, own, strict=True)], axis=1)
            even = all(run.steps is None for run in self.runs)
            split = system.exponential(p[:, 0], float(longest.max()) / self.least, self._ranges) if even else None
            if not eq.n or (split is not None and not split.laws):
                continue
            v = np.stack([run.inputs(eq.inputs, 1)[0, 0] for run in self.runs], axis=1)
            x = np.stack([part[eq.m :] for part in own], axis=1)
            for at in (np.zeros_like(x), x):
                speed = system.fastest_eigenvalue(time[None], at, v, p, split)
                fastest = max(fastest, float(np.nan_to_num(speed * longest).max()))
        sub = self.least
        while sub < fastest / STABLE_STEP and sub < SIMULATION_SUBSTEPS:
            sub *= 2
        return sub

    def is_exact(self, k: int, r: int) -> bool:
        """Return whether a subsystem is linear and driven by what is held or straight between the samples of a run."""
        eq, run = self.systems[k].equations, self.runs[r]
        return not self.stepped and run.steps is None and run.is_piecewise_linear(eq.inputs) and eq.linear is not None

    def simulated(
        self, unknowns: np.ndarray, k: int, r: int, sub: int, sensitivities: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the outputs of a subsystem in a run (N, c), and their derivatives by parameters and start."""
        system, run, own = self.systems[k], self.runs[r], unknowns[self.columns(k, r)]
        eq = system.equations
        p = eq.parameters(self.p[r], own[: eq.m], continued=self.continued)
        if self.is_exact(k, r):
            v = run.inputs(eq.inputs, 1)[:, ::2]
            return system.exact(p, own[eq.m :], v, run.dt, sensitivities=sensitivities)
        v = run.inputs(eq.inputs, sub)
        if run.steps is None:
            start, ranges = own[eq.m :], self._ranges
            found = system.in_exponential_steps(
                p, start, v, run.dt, t0=run.start, sensitivities=sensitivities, ranges=ranges
            )
            if found is not None:
                return found
        steps = run.dt if run.steps is None else run.steps
        return system.simulate(p, own[eq.m :], v, steps, t0=run.start, sensitivities=sensitivities)

    def _simulations(
        self, unknowns: np.ndarray, sub: int, sensitivities: bool
    ) -> Iterable[tuple[np.ndarray, np.ndarray]]:
        """Return what `simulated` gives of all subsystems and runs; one by one where failures of calls are kept."""

        @np.errstate(over="ignore", invalid="ignore")  # in NumPy 1 each thread has its own
        def of(pair: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
            return self.simulated(unknowns, *pair, sub, sensitivities)

        if several_threads() and not any(system.equations.calls for system in self.systems):
            return side_by_side(of, self.pairs)
        return map(of, self.pairs)

    @np.errstate(over="ignore", invalid="ignore")
    def evaluate(self, unknowns: np.ndarray, sub: int, sensitivities: bool = True) -> Evaluation:
        """Return residuals and Jacobians at a point; the cost is infinite where a run diverges."""
        residuals: list[list[np.ndarray]] = [[] for _ in self.systems]
        jacobians: list[list[np.ndarray]] = [[] for _ in self.systems]
        for (k, r), (y, dy) in zip(self.pairs, self._simulations(unknowns, sub, sensitivities), strict=True):
            known, names = np.isfinite(self.measured[k][r]), self.systems[k].equations.outputs
            residuals[k].append(self.runs[r].beside_nuisances(self.measured[k][r] - y, known, names))
            jacobians[k].append(self.runs[r].beside_nuisances(np.negative(dy, out=dy), known, names))
            if not (np.isfinite(y).all() and np.isfinite(dy).all()):
                return Evaluation(unknowns, sub)
        return self.summed(unknowns, sub, residuals, jacobians)

    def summed(
        self,
        unknowns: np.ndarray,
        sub: int,
        residuals: Sequence[Sequence[np.ndarray]],
        jacobians: Sequence[Sequence[np.ndarray]],
    ) -> Evaluation:
        """Return the evaluation of residuals and Jacobians, with what priors say; of infinite cost where it is none."""
        cost = 0.0
        gradient, information = np.zeros(len(unknowns)), np.zeros((len(unknowns), len(unknowns)))
        for k, r in self.pairs:
            own = self.columns(k, r)[: jacobians[k][r].shape[2]]
            square = np.ix_(own, own)
            for e, J in weighted_blocks(self.root(k, r), residuals[k][r], jacobians[k][r]):
                cost += float(e @ e)
                gradient[own] += J.T @ e
                information[square] += J.T @ J
        if not np.isfinite(information).all():
            return Evaluation(unknowns, sub)
        for j, item in enumerate(self.free):
            if item.prior_std is not None:
                off = (unknowns[j] - (item.prior_mean or 0.0)) / item.prior_std
                cost += off**2
                gradient[j] += off / item.prior_std
                information[j, j] += 1 / item.prior_std**2
        return Evaluation(unknowns, sub, cost, residuals, jacobians, gradient, information)

    def change(self, before: Evaluation, other: OutputErrorSearch) -> float:
        """Return the weighted sum of squares by which another diagram of these parameters differs.

        From the starts at which it fits best; infinite where it diverges.
        """
        start = other.first()
        start[: self.m] = before.unknowns[: self.m]
        after = replace(other, hold="theta").minimise(start)
        if not np.isfinite(after.cost):
            return np.inf
        residuals = [
            [a - b for a, b in zip(*pair, strict=True)] for pair in zip(before.residuals, after.residuals, strict=True)
        ]
        return self.squares(replace(before, residuals=residuals))

    def squares(self, found: Evaluation) -> float:
        """Return the weighted sum of squares of residuals."""
        weighted = (self.root(k, r) * np.nan_to_num(found.residuals[k][r]) for k, r in self.pairs)
        return sum(float(np.vdot(own, own)) for own in weighted)

    @cached_property
    def unlimited(self) -> OutputErrorSearch:
        """The search in which laws go on beyond where they are defined; itself where all are defined everywhere."""
        return replace(self, continued=True) if self.limited and not self.continued else self

    @property
    def limited(self) -> bool:
        """Whether there are laws that are not defined everywhere."""
        return any(system.equations.limited for system in self.systems)

    def minimise(self, start: np.ndarray, most: int = MOST_SIMULATIONS, before: Evaluation | None = None) -> Evaluation:
        """Return the evaluation where the cost is least, as found from a start within the bounds.

        On the way laws may go on beyond where they are defined; not in what is found. before: at the start, by other
        weights.
        """
        found = self.unlimited._minimised(start, most, before)
        if self.unlimited is self or np.isfinite(self.evaluate(found.unknowns, found.sub, sensitivities=False).cost):
            return found
        return self._minimised(start, most)

    def _minimised(self, start: np.ndarray, most: int, before: Evaluation | None = None) -> Evaluation:
        sub = self.substeps(start)
        if before is not None and before.sub == sub and np.array_equal(before.unknowns, start):
            here = self.summed(start, sub, before.residuals, before.jacobians)
        else:
            here = self.evaluate(start, sub)
        # outputs are linear in starts, but for laws that are not: their first step may be the last
        damping, calm, used = LEAST_DAMPING if self.hold == "theta" else FIRST_DAMPING, 0, 1
        known = np.zeros(len(start))  # information on starts, the most so far: where none is left they stay
        failed = False
        while np.isfinite(here.cost) and used < most and calm < 2:
            known[self.m :] = np.maximum(known, np.diag(here.information))[self.m :]
            if _promised(here, self._step(here, LEAST_DAMPING, known)) < SEARCH_COST_TOLERANCE * here.cost:
                break  # of trials only their rounding would show
            step = self._step(here, damping, known)
            after = self._tried(self._moved(here.unknowns, step), here.sub)
            if not after.cost < here.cost and (weak := self._weak(here)).any():
                step = self._step(here, damping, known, weak)
                after = self._tried(self._moved(here.unknowns, step), here.sub)
            there = self._tried(after.unknowns, here.sub, True) if after.cost < here.cost else after
            if after.cost < here.cost and there.barred is None:
                calm = calm + 1 if after.cost > here.cost * (1 - SEARCH_COST_TOLERANCE) else 0
                here = there
                damping = max(damping / 10, LEAST_DAMPING)
            else:
                failed |= there.barred is not None
                damping = max(10 * damping, FIRST_DAMPING)
                calm += damping > MOST_DAMPING or not step.any()
            used += 1
        return self._ended(here, known) if failed else here

    def _ended(self, here: Evaluation, known: np.ndarray) -> Evaluation:
        """Return the end of a search in which trials failed: barred where the next step gains, but fails, too."""
        if not np.isfinite(here.cost):
            return here
        step = self._step(here, FIRST_DAMPING, known)
        beyond = self._tried(self._moved(here.unknowns, step), here.sub) if _promised(here, step) > BARRED else here
        return replace(here, barred=beyond.barred)

    def _tried(self, unknowns: np.ndarray, sub: int, sensitivities: bool = False) -> Evaluation:
        """Return the evaluation of a trial; of infinite cost, too, where a part whose equations are elsewhere fails.

        Raises RotorsimError where that part is not asked any more.
        """
        try:
            return self.evaluate(unknowns, sub, sensitivities)
        except RotorsimError as error:
            if gives_up(error):
                raise
            return Evaluation(unknowns, sub, barred=error)

    def _weak(self, here: Evaluation) -> np.ndarray:
        """Return which unknowns are states at first samples that hardly show, (q,): any step there is one too far.

        So is what a play holds before the first reversal, of which the flank leaves exp(-t / time_constant).
        """
        information = np.diag(here.information)
        weak = information < WEAK * information[self.m :].max(initial=0.0)
        weak[: self.m] = False
        return np.asarray(weak)

    def _step(self, here: Evaluation, damping: float, known: np.ndarray, stay: np.ndarray | None = None) -> np.ndarray:
        """Return the step -(J^T J + damping D)^-1 J^T r, D = diag(J^T J), ``known`` at least, of what is not held.

        stay (q,): what is held besides.
        Source of ``known``: J. J. More, Lecture Notes in Mathematics 630 (1978) 105-116, section 6.
        """
        outwards = np.where(here.unknowns <= self.bounds[0], 1, -1) * here.gradient > 0
        held = self.at_bound(here.unknowns) & outwards
        held[: self.m] |= self.hold == "theta"
        held[self.m :] |= self.hold == "starts"
        held |= False if stay is None else stay
        scale = np.sqrt(np.maximum(np.diag(here.information), known))
        scale = np.where(scale > 0, scale, 1.0)
        H = here.information / np.outer(scale, scale) + damping * np.eye(len(scale))
        H[held], H[:, held], H[held, held] = 0.0, 0.0, 1.0
        g = np.where(held, 0.0, here.gradient / scale)
        return np.where(
            held, 0.0, -np.linalg.lstsq(H, g, rcond=1e-14)[0] / scale
        )  # rounding over a small scale is large

    def _moved(self, unknowns: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return the unknowns after a step, within the bounds; what is positive goes up and down a factor at a time."""
        (low, high), positive = self.bounds, self.bounds[0] > 0
        lowest = np.where(positive, np.maximum(low, unknowns / LEAP), low)
        highest = np.where(positive, np.minimum(high, unknowns * LEAP), high)
        moved = np.clip(unknowns + step, lowest, highest)
        far = self.angles[np.abs(moved[self.angles]) > pi]
        moved[far] = (moved[far] + pi) % tau - pi  # after many turns an angle has no digits left
        return np.asarray(moved)

    def stated(self, unknowns: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Return a point with some free parameters set, within the bounds."""
        point = unknowns.copy()
        for j, item in enumerate(self.free):
            point[j] = values.get(item.name, point[j])
        return np.asarray(np.clip(point, *self.bounds))

    @cached_property
    def angles(self) -> np.ndarray:
        """Which unknowns are angles without bounds, (k,)."""
        return np.array(
            [j for j, one in enumerate(self.free) if one.unit == "rad" and np.isinf(one.high - one.low)], int
        )
