"""Fit a diagram to harmonics of recordings from several starts, and say how well it predicts runs left out."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import LEAST, LINES, LONGEST
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import RotorsimError
from rotorsim.identification.coordinates import ANGLE_UNIT
from rotorsim.identification.estimate import MOST_EVALUATIONS, NOT_EXPLAINED, Estimate, Search, summary
from rotorsim.identification.experiment import RESOLUTION, Experiment, open_experiment
from rotorsim.identification.likelihood import Likelihood
from rotorsim.identification.profile import Z90, linear_intervals
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording
from rotorsim.signals.asynchronous import Second
from rotorsim.signals.harmonics import RunHarmonics

__all__ = ["LATER", "Fit", "Source", "fit_document", "fit_from_plain", "fit_to_plain", "left_out"]

LATER = "is nonlinear, and not fitted yet"
ANGLES = 8  # values over a turn of a new angle that enters in more than one way
NONLINEAR_TRIALS = 8  # of a group, of which the best is followed
PROMISE_TRIALS = 2  # of a nonlinear diagram, twice as many of a linear one
LINEAR_EVALUATIONS = 12  # for one of a nonlinear diagram
LINEAR_STARTS = 2  # that are followed to the end
LINEAR_FOLLOWED = 4  # one more of a group, from the most promising on, for so many starts that a fault declares
CORNERS, SHARP_EVALUATIONS = 20.0, 8  # misfit over equations that more orders of a law with corners may explain
EXPLAINS = 1.2  # times the number of equations: a misfit that no other start could lower by much
TURN = 2 * np.pi
NOTHING = 1e-12  # of the information about a parameter: rounding
SAME_SPEED = 0.02  # relative
MESH_ACCURACY = 1e-5  # of a signal's rms: how well one mesh stands for another at best
ROUNDED = 1e6  # parts of a radian in which angles are compared
NUMBERS = (
    "misfit",
    "rows",
    "equations",
    "goodness",
    "failure",
    "nonlinear",
    "seconds",
    "standing",
    "line_misfit",
    "line_rows",
)
ARRAYS = ("theta", "covariance", "at_bound", "run_misfit", "left_out", "ends", "alone")


def _nothing() -> np.ndarray:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class Source:
    """What a diagram is fitted to: a recording, its harmonics, and where the diagram's files are.

    second: the frequency of lines that do not follow the shaft, and that the harmonics were fitted with. standing:
    nuisances of the diagram as given (see `Fit.criterion`); given: its free parameters, whose sizes and priors hold in
    every later fit, whatever value that begins from.
    Whatever has ``recorded``, ``load``, ``fit`` and ``largest`` can stand in its place (`naming.name_missing`).
    """

    recording: Recording
    harmonics: tuple[RunHarmonics, ...]
    folder: str | None = None
    trust_blocks: bool = False
    second: Second | None = None
    standing: int | None = None
    given: tuple[Free, ...] = ()

    def load(self, document: Mapping[str, Any]) -> Diagram:
        """Return the diagram of a document; recordings mean what goes into its converters. Raises RotorsimError."""
        folder = Path(self.folder) if self.folder else None
        return load(document, folder=folder, trust_blocks=self.trust_blocks).before_converters()

    def open(self, diagram: Diagram, *, given: Sequence[str] = (), inject: Sequence[str] = ()) -> Experiment:
        """Return a diagram beside the harmonics; see `rotorsim.identification.experiment.open_experiment`."""
        has_mesh = any(node.block.refinement for node in diagram.nodes.values())
        return open_experiment(
            diagram,
            self.recording,
            runs=[item.run for item in self.harmonics],
            given=given,
            inject=inject,
            harmonics=self.harmonics,
            resolution=MESH_ACCURACY if has_mesh else RESOLUTION,
            free=[self._as_given(item) for item in diagram.free],
        )

    def _as_given(self, item: Free) -> Free:
        """Return a free parameter with size and prior of the diagram as given, not of the fit that it starts from."""
        first = next((other for other in self.given if other.name == item.name), None)
        if first is None:
            return item
        return replace(item, scale=first.scale, prior_mean=first.prior_mean, prior_std=first.prior_std)

    @property
    def recorded(self) -> list[str]:
        """The flat names of the recorded signals, without those that are zero throughout: nothing senses there."""
        runs = [item.run.values for item in self.harmonics]
        channels = self.recording.channels.items()
        return [item.name for key, item in channels if not runs or any(key in run and run[key].any() for run in runs)]

    def fit(
        self,
        document: Mapping[str, Any],
        starts: Sequence[Sequence[Mapping[str, float]]],
        *,
        most: int | None = None,
        linear_only: bool = False,
    ) -> Fit:
        """Return the best fit of a diagram; see `fit_document`."""
        return fit_document(document, self, starts, most=most, linear_only=linear_only)

    def promise(self, document: Mapping[str, Any], starts: Sequence[Sequence[Mapping[str, float]]]) -> float:
        """Return the misfit that one step from the best start promises; see `promise_of`."""
        return promise_of(document, self, starts)

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return the whitened residual of a diagram as it is, or None where it has none."""
        try:
            experiment = self.open(self.load(document))
            return Likelihood(experiment).evaluate(experiment.theta0).residual
        except (RotorsimError, ValueError, np.linalg.LinAlgError):
            return None

    @property
    def alike(self) -> bool:
        """Whether all runs have one speed, to SAME_SPEED of it, and the same settings."""
        speeds = [item.fit.speed for item in self.harmonics]
        settings = [{k: v for k, v in item.run.settings.items() if k != "speed"} for item in self.harmonics]
        near = max(speeds) - min(speeds) <= SAME_SPEED * abs(speeds[0])
        return near and all(one == settings[0] for one in settings)

    def largest(self) -> dict[str, float]:
        """Return the largest magnitude of every recorded signal, by its flat name, and of the rates of displacements.

        "least NAME": in the run in which it is smallest. LONGEST: the length of the longest run.
        """
        sizes: dict[str, list[float]] = {}
        for item in self.harmonics:
            rates = item.fit.orders[:, None] * item.fit.speed * item.fit.values
            for c, name in enumerate(item.fit.names):
                size = float(abs(item.fit.values[0, c])) + float(np.sqrt(2) * item.fit.rms[c])
                sizes.setdefault(name, []).append(size)
                port, _, rest = name.partition("[")
                if port.endswith(".displacement"):
                    rate = 2 * float(np.sqrt((np.abs(rates[:, c]) ** 2).sum()))
                    sizes.setdefault(f"{port.removesuffix('displacement')}velocity[{rest}", []).append(rate)
        found = {name: max(values) for name, values in sizes.items()}
        found |= {f"{LEAST} {name}": min(values) for name, values in sizes.items()}
        found[LONGEST] = max(float(np.ptp(item.run.time)) for item in self.harmonics)
        if self.second is not None and not self.second.follows:
            found[LINES] = self.second.value
        return found


@dataclass(frozen=True, eq=False)
class Fit:
    """A diagram at its most likely parameters.

    free, theta (m,), covariance (m, m), at_bound (m,). misfit: |r|^2 of the whitened data; equations: real ones, of
    which rows are left after nuisances. run_misfit, left_out (R,): |r|^2 of each run, and when it is predicted from
    the others. goodness: probability of the misfit. failure: why there is none of it. nonlinear: in its states.
    seconds: of CPU time it took. standing: nuisances that any diagram has (default: all of its own). line_misfit,
    line_rows: |r|^2 and equations of the lines beside the harmonics. ends (m, 2): of 90 % intervals within the bounds.
    alone (m,): standard deviations with all other parameters of the same block known.
    """

    document: Mapping[str, Any]
    free: tuple[Free, ...] = ()
    theta: np.ndarray = field(default_factory=_nothing)
    covariance: np.ndarray = field(default_factory=_nothing)
    at_bound: np.ndarray = field(default_factory=_nothing)
    misfit: float = np.inf
    rows: int = 0
    equations: int = 0
    run_misfit: np.ndarray = field(default_factory=_nothing)
    left_out: np.ndarray = field(default_factory=_nothing)
    goodness: float = 0.0
    failure: str = ""
    nonlinear: bool = False
    seconds: float = 0.0
    standing: int | None = None
    line_misfit: float = 0.0
    line_rows: int = 0
    ends: np.ndarray = field(default_factory=_nothing)
    alone: np.ndarray = field(default_factory=_nothing)

    @property
    def freedom(self) -> int:
        """Equations less parameters."""
        return max(self.rows - len(self.free), 1)

    @property
    def criterion(self) -> float:
        """Bayesian information criterion with the noise as it was measured: misfit and a charge per free parameter.

        Nuisances that the diagram as given has cost what noise alone gives them, so that it is no merit to leave fewer
        means of slow states open; those that a law adds cost as much as its parameters.
        """
        added = 0 if self.standing is None else max(self.nuisances - self.standing, 0)
        charged = (len(self.free) + added) * float(np.log(max(self.equations, self.rows, 2)))
        return self.misfit + (self.nuisances - added) + charged

    @property
    def nuisances(self) -> int:
        """Unknowns of no interest, such as the means of states that have not settled."""
        return max(self.equations - self.rows, 0)

    @property
    def widening(self) -> float:
        """The factor on intervals where the diagram does not explain the data."""
        return float(np.sqrt(max(self.misfit / self.freedom, 1.0))) if self.goodness < NOT_EXPLAINED else 1.0

    def interval90(self, j: int) -> tuple[float, float]:
        """Return the 90 % interval of a parameter, within its bounds: one-sided at one, infinite if undetermined."""
        value, item = float(self.theta[j]), self.free[j]
        ends = self.ends[j] if len(self.ends) else value + Z90 * self.std(j) * np.array([-1.0, 1.0]) / self.widening
        low, high = (value + self.widening * (float(end) - value) for end in ends)
        return max(low, item.low), min(high, item.high)

    def std(self, j: int) -> float:
        """Return the standard deviation of a parameter; at a bound, that which its one-sided interval stands for."""
        if self.at_bound[j] and len(self.ends):
            return self.widening * float(np.abs(self.ends[j] - self.theta[j]).max()) / Z90
        return self.widening * float(np.sqrt(max(float(self.covariance[j, j]), 0.0)))

    @property
    def values(self) -> dict[str, float]:
        """The parameters by name, SI."""
        return {item.name: float(v) for item, v in zip(self.free, self.theta, strict=True)}


def fit_document(
    document: Mapping[str, Any],
    source: Source,
    starts: Sequence[Sequence[Mapping[str, float]]],
    *,
    given: Sequence[str] = (),
    most: int | None = None,
    linear_only: bool = False,
) -> Fit:
    """Return the best fit of a diagram from the best of each group of starts {free parameter: SI value}.

    What a start does not name begins as written; angles that it names are tried all around. most: evaluations of a
    nonlinear diagram from each start, times LINEAR_EVALUATIONS of a linear one (default: until it has converged).
    linear_only: a nonlinear diagram is not fitted, its failure is LATER.
    """
    began = process_time()
    nonlinear = False
    try:
        experiment = source.open(source.load(document), given=given)
        nonlinear = not experiment.motion.is_linear
        if nonlinear and linear_only:
            return Fit(document, failure=LATER, nonlinear=True, seconds=process_time() - began)
        search = Search(Likelihood(experiment))
        best = _best(search, experiment, starts, most)
        if nonlinear and most is None and EXPLAINS < best.misfit / max(best.evaluation.rows, 1) < CORNERS:
            best = _sharpened(search, best)
    except RotorsimError as error:
        return Fit(document, failure=error.problems[0].what, nonlinear=nonlinear, seconds=process_time() - began)
    except (ValueError, np.linalg.LinAlgError) as error:  # no settled motion to start from
        return Fit(document, failure=str(error), nonlinear=nonlinear, seconds=process_time() - began)
    seconds = process_time() - began
    return replace(_fit_of(document, search, best), nonlinear=nonlinear, seconds=seconds, standing=source.standing)


def promise_of(document: Mapping[str, Any], source: Source, starts: Sequence[Sequence[Mapping[str, float]]]) -> float:
    """Return the misfit that linear theory promises after one step of all parameters from the best start."""
    try:
        experiment = source.open(source.load(document))
        search = Search(Likelihood(experiment))
        least = np.inf
        for group in starts[:1]:
            trials = _different([t for start in group for t in _trials(search, experiment.theta0, start)], search)
            most = 2 * PROMISE_TRIALS if experiment.motion.is_linear else PROMISE_TRIALS
            for theta in trials[:: max(1, -(-len(trials) // most))]:
                least = min(least, search.promise(search.coordinates.inside(theta)))
    except (RotorsimError, ValueError, np.linalg.LinAlgError):
        return np.inf
    return least


def _fit_of(document: Mapping[str, Any], search: Search, best: Estimate) -> Fit:
    evaluation = best.evaluation
    if not np.isfinite(best.misfit):
        return Fit(document, failure="no periodic motion was found")
    assert isinstance(search.likelihood, Likelihood)
    sizes = [len(w.keep) for w in search.likelihood.whiteners]
    lines = np.tile(search.likelihood.is_beside, len(sizes))
    q = search.coordinates.inside(best.theta)
    covariance = best.covariance.copy()
    covariance[best.undetermined, best.undetermined] = np.inf
    loo = left_out(evaluation.residual, search.jacobian(q)[: len(evaluation.residual)], sizes)
    return Fit(
        document=document,
        free=best.free,
        theta=best.theta,
        covariance=covariance,
        at_bound=best.at_bound,
        misfit=best.misfit,
        rows=evaluation.rows,
        equations=sum(sizes),
        run_misfit=evaluation.misfit,
        left_out=loo,
        goodness=best.goodness,
        ends=linear_intervals(search, best),
        alone=_alone(best),
        line_rows=int(lines.sum()),
        line_misfit=float((evaluation.residual[: len(lines)][lines] ** 2).sum()),
    )


def _alone(found: Estimate) -> np.ndarray:
    """Return the standard deviations (m,) with all other parameters of the same block known, and no others.

    Where only a combination is determined, as of the size and the time constant of a drift, each still has one.
    """
    back = np.linalg.inv(found.coordinates.jacobian(found.theta))
    information = back.T @ found.information @ back
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    unit = np.where(size > 0, size, 1.0)
    scaled = information / np.outer(unit, unit)
    blocks = [item.base.rpartition(".")[0] or item.name for item in found.free]
    out = np.full(len(blocks), np.inf)
    for j, block in enumerate(blocks):
        rest = [k for k, other in enumerate(blocks) if other != block and not found.at_bound[k]]
        known = np.linalg.pinv(scaled[np.ix_(rest, rest)], rcond=NOTHING, hermitian=True)
        left = float(scaled[j, j] - scaled[j, rest] @ known @ scaled[rest, j])
        if size[j] > 0 and left > NOTHING:
            out[j] = 1 / (size[j] * np.sqrt(left))
    return out


def _best(
    search: Search, experiment: Experiment, starts: Sequence[Sequence[Mapping[str, float]]], most: int | None
) -> Estimate:
    nonlinear = not experiment.motion.is_linear
    chosen: list[np.ndarray] = []
    assert isinstance(search.likelihood, Likelihood)
    ranking = search.again(search.likelihood.rough())
    if not nonlinear and (most is None or not starts):  # a step costs little: look all around for unknown angles
        chosen += search.starts()[:LINEAR_STARTS]
    for group in starts or ([[{}]] if nonlinear else []):
        trials = _different([t for start in group for t in _trials(search, experiment.theta0, start)], search)
        if nonlinear:
            trials = trials[:: max(1, len(trials) // NONLINEAR_TRIALS)]
        ranked = [ranking.force_step(search.coordinates.inside(theta), []) for theta in trials]
        ranked = sorted((item for item in ranked if np.isfinite(item[0])), key=lambda item: item[0])
        chosen += [q for _, q in ranked[: 1 if nonlinear else 1 + len(group) // LINEAR_FOLLOWED]]
    best: np.ndarray | None = None
    least = np.inf
    for q in chosen:
        if not np.isfinite(search.residual(q)).all():
            continue
        limit = MOST_EVALUATIONS if most is None else most if nonlinear else LINEAR_EVALUATIONS * most
        found = search.minimise(q, most=limit)
        r = search.residual(found)
        cost = float(r @ r) * search.preference(found)
        if cost < least * (1 - 1e-9):
            best, least = found, cost
        if search.evaluation(found).misfit.sum() < EXPLAINS * search.evaluation(found).rows:
            break
    if best is None:
        raise ValueError("no periodic motion was found")
    return summary(search, best)


def _sharpened(search: Search, best: Estimate) -> Estimate:
    """Return a fit carried on with more orders: what is left over may be theirs, where a law has corners."""
    search.likelihood.experiment.motion.sharpen()
    again = search.again(Likelihood(search.likelihood.experiment))
    q = again.coordinates.inside(best.theta)
    if not np.isfinite(again.residual(q)).all():
        return best
    found = summary(again, again.minimise(q, most=SHARP_EVALUATIONS))
    return found if found.misfit < best.misfit else best


def _trials(search: Search, theta0: np.ndarray, start: Mapping[str, float]) -> list[np.ndarray]:
    """Return a start, with the angles named in it that are not part of an amplitude pair all around."""
    theta = theta0.copy()
    names = [item.name for item in search.free]
    for name, value in start.items():
        if name in names:
            item = search.free[names.index(name)]
            theta[names.index(name)] = np.clip(value, item.low, item.high)
    paired = {j for pair in search.coordinates.pairs for j in pair}
    angles = [
        j
        for j, item in enumerate(search.free)
        if item.unit == ANGLE_UNIT and j not in paired and item.name in start and item.low == -np.inf
    ][:2]
    found = []
    for turns in itertools.product(range(ANGLES), repeat=len(angles)):
        trial = theta.copy()
        trial[angles] = theta[angles] + np.array(turns) * TURN / ANGLES
        found.append(trial)
    return found


def _different(trials: Sequence[np.ndarray], search: Search) -> list[np.ndarray]:
    """Return the trials without those that are one already but for whole turns.

    In a linear diagram one step finds the forces, from anywhere: trials that differ in them only are one.
    """
    angles = np.array([item.unit == ANGLE_UNIT for item in search.free], bool)
    same = np.zeros(len(angles), bool)
    if search.likelihood.experiment.motion.is_linear:
        same[[j for pair in search.coordinates.pairs for j in pair]] = True
    kept: dict[bytes, np.ndarray] = {}
    for trial in trials:
        turned = np.where(angles, np.mod(np.round(trial * ROUNDED), np.round(TURN * ROUNDED)), trial)
        kept.setdefault(np.where(same, 0.0, turned).tobytes(), trial)
    return list(kept.values())


def fit_to_plain(found: Fit) -> dict[str, Any]:
    """Return a fit as plain data, without its document."""
    plain = {name: getattr(found, name).tolist() for name in ARRAYS}
    return {**plain, **{name: getattr(found, name) for name in NUMBERS}, "free": [asdict(item) for item in found.free]}


def fit_from_plain(document: Mapping[str, Any], plain: Mapping[str, Any]) -> Fit:
    """Return the fit of a document from plain data."""
    arrays: dict[str, Any] = {name: np.array(plain[name]) for name in ARRAYS}
    numbers = {name: plain[name] for name in NUMBERS}
    return Fit(document, tuple(Free(**item) for item in plain["free"]), **arrays, **numbers)


def left_out(residual: np.ndarray, slopes: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Return the misfit of each run when it is predicted from the others, (R,), by linear theory.

    e_r (left out) = (I - J_r (J^T J)^-1 J_r^T)^-1 e_r
    """
    norm = np.linalg.norm(slopes, axis=0)
    J = slopes / np.where(norm > 0, norm, 1.0)
    inverse = np.linalg.pinv(J.T @ J, rcond=1e-12, hermitian=True)
    out = np.empty(len(sizes))
    at = 0
    for r, size in enumerate(sizes):
        rows, e = J[at : at + size], residual[at : at + size]
        # Woodbury: (I - J C J^T)^-1 = I + J (C^-1 - J^T J)^-1 J^T
        others = J.T @ J - rows.T @ rows
        moved = rows @ (np.linalg.pinv(others, rcond=1e-12, hermitian=True) @ (rows.T @ e)) if len(inverse) else 0.0
        predicted = e + moved
        out[r] = float(predicted @ predicted)
        at += size
    return out
