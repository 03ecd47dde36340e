"""What pulses leave open of the shaft angle, what the motion tells of it, and what that leaves open of parameters.

All sampled pulses are late by one time; between pulses the angle is known but for what its smooth curve leaves open.
Both are errors of the angle of one standard deviation each, c (E,) of them ~ N(0, 1), fitted beside the parameters
theta. With D = dr/dc, J = dr/d theta, all weighted, h = J^T D, H = J^T J:

c = c_0 - K^-1 (D^T r - h^T H^-1 J^T r + c_0),  K = D^T D - h^T H^-1 h + 1;  their covariance is K^-1,
and H^-1 h K^-1 h^T H^-1 is added to that of theta: the scatter of stretches shows nothing of an error of a whole run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.driven.equations import clock_ports
from rotorsim.identification.waveform.evaluation import Evaluation, solved
from rotorsim.identification.waveform.noise import INVERTED, Variance
from rotorsim.identification.waveform.recorded.along_angle import ANGLE_UNITS, turned_later
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM
from rotorsim.recordings.recording import Recording
from rotorsim.signals.pulse_curve import PulseCurve
from rotorsim.signals.turning import turning

ANGLE_SHOWN = (
    0.01  # sum of squares of weighted changes: below, no parameter goes by more than 0.1 of its standard deviation
)
ANGLE_ERRORS = 32  # of a run; of more, so many sums with random signs: a standard deviation is known to 1/8 of itself
LATE_PASSES = 2  # Gauss-Newton steps: what is left is of second order in an angle of a few degrees
CORNER_PASSES = 3  # the first two move a corner: by all that is linear in it, and by the rest
LARGEST_LATE = 2.0  # standard deviations: a period before and after the sample is 2.4
CHANCE = 1e-3  # of errors of a run as large as those found: below, it is the diagram that is wrong, and they stay open


@dataclass(frozen=True, eq=False)
class Changes:
    """What E errors change: gradients (q, E), squares D^T D (E, E), slopes D^T r (E,)."""

    gradients: np.ndarray
    squares: np.ndarray
    slopes: np.ndarray


@dataclass(frozen=True, eq=False)
class OpenAngle:
    """Errors of the angle of runs, of one standard deviation each.

    late: the standard deviation of the time by which all pulses are late [s]. curves: through the pulses of each run,
    with its errors. factor (E, E): by which errors are mixed from independent ones; None: they are independent.
    """

    diagram: Diagram
    late: float = 0.0
    curves: Mapping[str, PulseCurve] = field(default_factory=dict)
    factor: np.ndarray | None = None

    @property
    def has_corners(self) -> bool:
        """Whether an acceleration may jump in any run."""
        return any(curve.spline.jumps for curve in self.curves.values())

    @cached_property
    def errors(self) -> list[str]:
        """The run that each error is of, "" of the one of all."""
        return ["" for _ in range(bool(self.late))] + [
            name for name, curve in self.curves.items() for _ in range(curve.root.shape[1])
        ]

    def of_run(self, run: SampledRun) -> np.ndarray:
        """Return which errors a run has, (E,)."""
        return np.array([not name or _is_part(run, name) for name in self.errors], bool)

    def turned(self, run: SampledRun, c: np.ndarray) -> SampledRun:
        """Return a run whose angle is off by so many standard deviations of each error, c (E,)."""
        if self.late:
            run = turned_later(run, self.diagram, self.late * float(c[0]))
        for name, curve in self.curves.items():
            if _is_part(run, name):
                own = c[[one == name for one in self.errors]]
                alone = replace(curve, root=(curve.root @ own)[:, None])
                orders = self._orders(run).items()
                off = {port: run.values[port] + alone.errors(run.time, k)[:, 0] for port, k in orders}
                run = replace(run, values={**run.values, **off})
        return run

    def with_corners(self, c: np.ndarray) -> OpenAngle | None:
        """Return it where speeds that errors c (E,) give do not jump, of curves that may; None where none may.

        Where a corner is, pulses tell to some of them; an error of that is linear in the angle only beside it.
        """
        own = {name: c[[one == name for one in self.errors]] for name in self.curves}
        found = {name: curve.with_corners(curve.root @ own[name]) for name, curve in self.curves.items()}
        moved = {name: _few(curve) for name, curve in found.items() if curve is not None}
        return replace(self, curves={**self.curves, **moved}) if moved else None

    def instead(self, before: OpenAngle, run: SampledRun) -> SampledRun:
        """Return a run whose angle follows these curves, where it followed those before."""
        values = dict(run.values)
        for name, curve in self.curves.items():
            for port, k in self._orders(run).items() if _is_part(run, name) else ():
                values[port] = values[port] + curve(run.time, k) - before.curves[name](run.time, k)
        return replace(run, values=values)

    def _orders(self, run: SampledRun) -> dict[str, int]:
        """Return which derivative of the angle each port of the clock has."""
        ports = [port for port in clock_ports(self.diagram) if port in run.values]
        return {port: list(ANGLE_UNITS).index(port.rpartition(".")[2]) for port in ports}

    def std(self, run: SampledRun) -> np.ndarray:
        """Return the standard deviation of the angle of a run, (N,) [rad]."""
        speeds = [run.values[port] for port in clock_ports(self.diagram) if port.endswith(".speed")]
        squares = (self.late * speeds[0]) ** 2 if speeds else np.zeros(run.size)
        for name, curve in self.curves.items():
            if _is_part(run, name):
                squares = squares + curve.std(run.time) ** 2
        return np.sqrt(squares)

    def shows(self, runs: Sequence[SampledRun], variance: Variance) -> bool:
        """Return whether signals that lag by as much differ by more than a part of their noise in any run."""
        names = [name for system, name in variance if system == WHOLE_DIAGRAM]
        for run in runs:
            square = float(np.nanmean(self.std(run) ** 2))
            for name in names:
                changed = square * float(np.nanmean(run.values[name] ** 2))
                if changed > CRITERIA.mesh_error * variance[WHOLE_DIAGRAM, name]:
                    return True
        return False

    def estimated(
        self, search: OutputErrorSearch, evaluation: Evaluation, c: np.ndarray
    ) -> tuple[np.ndarray, OpenAngle]:
        """Return the errors (E,) that the motion shows beside all that is searched, and what is open then.

        c (E,): those of the runs of the search. Where a run shows errors that its pulses exclude, they stay open.
        """
        changes = self._changes(search, evaluation)
        searched = ~search.at_bound(evaluation.unknowns)
        searched[: search.m] &= search.hold != "theta"
        h, H = changes.gradients[searched], evaluation.information[np.ix_(searched, searched)]
        moved = solved(H, h, INVERTED) if searched.any() else h
        K = changes.squares - h.T @ moved
        slopes = changes.slopes - moved.T @ evaluation.gradient[searched] + c
        kept, of = np.ones(len(c), bool), np.array(self.errors)
        while True:
            found, factor = np.zeros(len(c)), np.eye(len(c))
            square = np.ix_(kept, kept)
            sizes, turned = np.linalg.eigh((K[square] + K[square].T) / 2)
            factor[square] = turned / np.sqrt(np.maximum(sizes, 0.0) + 1.0)
            found[kept] = c[kept] - factor[square] @ (factor[square].T @ slopes[kept])
            sizes_of = {name: found[of == name] for name in {*of[kept].tolist()} - {""}}
            beyond = [name for name, size in sizes_of.items() if chi2.sf(size @ size, len(size)) < CHANCE]
            if not beyond:
                break
            kept &= ~np.isin(of, beyond)
        found[of == ""] = np.clip(found[of == ""], -LARGEST_LATE, LARGEST_LATE)
        return found, replace(self, factor=factor)

    def covariance(self, search: OutputErrorSearch, evaluation: Evaluation) -> np.ndarray:
        """Return what the angle leaves open of the unknowns of a search, (q, q); zero at bounds."""
        changed = self._changes(search, evaluation).gradients
        u = np.zeros_like(changed)
        if changed.shape[1]:
            searched = ~search.at_bound(evaluation.unknowns)
            H = evaluation.information[np.ix_(searched, searched)]
            u[searched] = solved(H, changed[searched], INVERTED)
        u = u if self.factor is None else u @ self.factor
        return np.asarray(u @ u.T)

    def _changes(self, search: OutputErrorSearch, evaluation: Evaluation) -> Changes:
        """Return what errors change, of runs in which they show."""
        E, q = len(self.errors), len(evaluation.unknowns)
        gradients, squares, slopes = np.zeros((q, E)), np.zeros((E, E)), np.zeros(E)
        for k, r in search.pairs:
            run, root, names = search.runs[r], search.root(k, r), search.systems[k].equations.outputs
            own, which = search.columns(k, r), np.flatnonzero(self.of_run(run))
            y, _ = search.simulated(evaluation.unknowns, k, r, evaluation.sub, sensitivities=False)
            if not len(which) or float(np.sum((root * y * self.std(run)[:, None]) ** 2)) < ANGLE_SHOWN:
                continue
            known = np.isfinite(search.measured[k][r])
            D = np.empty((root.size, len(which)))
            for column, j in enumerate(which):
                other = self.turned(run, np.eye(E)[j])
                there = replace(search, runs=[other if i == r else one for i, one in enumerate(search.runs)])
                changed, _ = there.simulated(evaluation.unknowns, k, r, evaluation.sub, sensitivities=False)
                D[:, column] = (root * np.nan_to_num(run.beside_nuisances(y - changed, known, names))).ravel()
            weighted = (root[:, :, None] * evaluation.jacobians[k][r]).reshape(root.size, -1)
            gradients[np.ix_(own, which)] += weighted.T @ D
            squares[np.ix_(which, which)] += D.T @ D
            slopes[which] += D.T @ (root * np.nan_to_num(evaluation.residuals[k][r])).ravel()
        return Changes(gradients, squares, slopes)


def open_angle(diagram: Diagram, recording: Recording, runs: Iterable[SampledRun], late: float = 0.0) -> OpenAngle:
    """Return what the pulses of a recording, as it was made, leave open of the angle of runs; late: see `OpenAngle`."""
    curves: dict[str, PulseCurve] = {}
    for run in runs:
        own = next((one for one in recording.runs if _is_part(run, one.id)), None)
        curve = None if own is None or own.id in curves else turning(recording, own).curve
        if own is not None and curve is not None:
            curves[own.id] = _few(curve)
    return OpenAngle(diagram, late, curves)


def _is_part(run: SampledRun, name: str) -> bool:
    return run.id == name or run.id.startswith(f"{name} from ")


def _few(curve: PulseCurve) -> PulseCurve:
    few = curve.principal(curve.centre + curve.half * np.linspace(-1.0, 1.0, 4 * len(curve.a)))
    if few.root.shape[1] <= ANGLE_ERRORS:
        return few
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (few.root.shape[1], ANGLE_ERRORS))
    return replace(few, root=few.root @ signs / np.sqrt(ANGLE_ERRORS))


Fitted = Callable[[Sequence[SampledRun]], tuple[OutputErrorSearch, Evaluation]]


def with_estimated_angle(
    angle: OpenAngle, runs: Sequence[SampledRun], fitted: Fitted
) -> tuple[tuple[SampledRun, ...], OpenAngle, float]:
    """Return runs whose angle is as their motion tells, what is open then, and by how much pulses were late [s].

    fitted: what is fitted to runs, and how it ended.
    """
    c, left, turned = np.zeros(len(angle.errors)), angle, tuple(runs)
    passes = max(LATE_PASSES if angle.late else 1, CORNER_PASSES if angle.has_corners else 1)
    for k in range(passes):
        search, evaluation = fitted(turned)
        if not np.isfinite(evaluation.cost):
            return tuple(runs), angle, 0.0
        c, left = angle.estimated(search, evaluation, c)
        moved = angle.with_corners(c) if k < passes - 1 else None
        if moved is not None:
            runs, late = [moved.instead(angle, run) for run in runs], c[: bool(angle.late)]
            c, angle = np.concatenate([late, np.zeros(len(moved.errors) - len(late))]), moved
        turned = tuple(angle.turned(run, c) for run in runs)
    return turned, left, angle.late * float(c[0]) if angle.late else 0.0
