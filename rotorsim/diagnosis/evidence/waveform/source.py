"""Recorded runs as samples in time, to which a diagram is fitted by the error of its simulation.

Nothing is known of the noise of a measured run, and what a good model leaves over is as a rule its own error. Hence:

- Every measured signal is weighed by what a flexible model leaves of it: the diagram with a force that may be any
  smooth law of displacement and velocity (`ForceMap`) where motion was measured, and not less than RESOLUTION of it.
- A misfit is that of ``rows`` independent samples: as many as would scatter between stretches of the runs as what the
  flexible model leaves does, and MOST_ROWS at most, so that what explains less than a percent counts as nothing.
- A model is adequate unless it predicts stretches left out of the fit worse than MATERIAL times the flexible one does,
  or than that by MOST of the square that the diagram left at first, by a t-test over the stretches.
- Covariances are those of the stretches' own scatter (sandwich), so that they hold for coloured errors.

The misfits of all fits to one source are in the same units, and so are their criteria.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import process_time
from typing import Any

import numpy as np
from scipy.stats import t as student

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.harmonic import Fit, left_out
from rotorsim.diagnosis.evidence.waveform.data import Channels, OfRuns, TimeRun
from rotorsim.diagnosis.evidence.waveform.search import MOST_EVALUATIONS, Evaluation, Point, TimeSearch
from rotorsim.diagnosis.evidence.waveform.views import View, views_of
from rotorsim.errors import RotorsimError
from rotorsim.recordings.recording import Recording

__all__ = ["MATERIAL", "TimeSource", "block_misfit"]

# times the rms of what the flexible model leaves, that counts as no worse: F-test of 60 and 60 samples at 5 %, 1.24
MATERIAL = 1.25
MOST = 0.01  # of what the diagram left and the flexible model does not, that may be left
FIRST_STEPS = 4  # from each start, before the best is followed
SHORT = 8192  # samples of all runs on which a start is chosen and followed
LAST_STEPS = 12  # on all samples after that
LINEAR_EVALUATIONS = 4  # for one that is asked for: they are cheap
INVERTED = 1e-13  # smallest eigenvalue of the scaled information, of the largest, that counts
Stretch = tuple[int, int, int]  # run, first sample, last sample but one


@dataclass(frozen=True, eq=False)
class TimeSource(OfRuns):
    """What a diagram is fitted to, in the place of `rotorsim.diagnosis.evidence.harmonic.Source`.

    variance: (view, output) -> mean square that counts as noise. rows: independent samples. stretches: into which
    the runs are divided. allowed (B,): what an adequate model may leave of each when it is left out. least: steps
    between samples. starts: "view:state" -> value at the start of each run. sizes: flat name -> largest magnitude.
    old: names of the parameters that were free at first.
    """

    recording: Recording
    runs: tuple[TimeRun, ...]
    channels: Channels
    views: tuple[str, ...]
    variance: Mapping[tuple[str, str], float]
    rows: int
    stretches: tuple[Stretch, ...]
    allowed: np.ndarray
    least: int
    starts: Mapping[str, Sequence[float]] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)
    old: frozenset[str] = frozenset()
    folder: str | None = None
    trust_blocks: bool = False

    def largest(self) -> dict[str, float]:
        """Return the largest magnitude of every signal, recorded or simulated, by its flat name."""
        return dict(self.sizes)

    def search(self, document: Mapping[str, Any]) -> TimeSearch:
        """Return the search for the free parameters of a document. Raises RotorsimError."""
        views = views_of(self.load(document), self.channels, expected=self.views)
        return TimeSearch(views, self.runs, self.weights(views), least=self.least)

    def weights(self, views: Sequence[View]) -> list[list[np.ndarray]]:
        """Return the weights of squares that make a misfit that of ``rows`` independent samples of unit variance."""
        samples = sum(run.size for run in self.runs) * len(self.variance)
        return [
            [np.array([self.rows / samples / self.variance[view.name, name] for name in view.outputs])] * len(self.runs)
            for view in views
        ]

    def fit(
        self,
        document: Mapping[str, Any],
        starts: Sequence[Sequence[Mapping[str, float]]],
        *,
        most: int | None = None,
        linear_only: bool = False,
    ) -> Fit:
        """Return the best fit of a diagram from the best of each group of starts {free parameter: SI value}.

        What a start does not name begins as written. most: a limit of evaluations, times LINEAR_EVALUATIONS.
        linear_only is not heeded: a nonlinear diagram costs no more.
        """
        began = process_time()
        limit = MOST_EVALUATIONS if most is None else LINEAR_EVALUATIONS * most
        try:
            search = self.search(document)
            found = self._best(search, starts, limit)
        except (RotorsimError, np.linalg.LinAlgError) as error:
            what = error.problems[0].what if isinstance(error, RotorsimError) else str(error)
            return Fit(document, failure=what, seconds=process_time() - began)
        if found is None:
            return Fit(document, failure="the simulation diverges", seconds=process_time() - began)
        return self.summary(document, search, *found, process_time() - began)

    def at(self, fit: Fit) -> Fit:
        """Return a fit of another source as this one judges it, at the same parameters."""
        search = self.search(values_in(fit.document, fit.values))
        search.hold = "theta"
        point, found = search.minimise(search.first(self.starts))
        return self.summary(fit.document, search, point, found, fit.seconds)

    def promise(self, document: Mapping[str, Any], starts: Sequence[Sequence[Mapping[str, float]]]) -> float:
        """Return the misfit after FIRST_STEPS steps from the best start, per sample as on all samples."""
        try:
            search = self.search(document)
            tried = self._followed(search, search.shortened(SHORT), starts[:1])
        except (RotorsimError, np.linalg.LinAlgError):
            return np.inf
        return min((found.cost for _, found in tried), default=np.inf)

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return the weighted errors of a diagram as it is, starts of runs at their best; None where it diverges."""
        try:
            search = self.search(document)
        except RotorsimError:
            return None
        search.hold = "theta"
        found = search.minimise(search.first(self.starts))[1]
        return stacked(search, found, self.stretches)[0] if np.isfinite(found.cost) else None

    def _best(
        self, search: TimeSearch, groups: Sequence[Sequence[Mapping[str, float]]], most: int
    ) -> tuple[Point, Evaluation] | None:
        short = search.shortened(SHORT)
        ends = []
        for group in groups or [[{}]]:
            tried = self._followed(search, short, [group])
            if tried:
                ends.append(short.minimise(min(tried, key=_cost)[0], most))
        if not ends:
            return None
        point = min(ends, key=_cost)[0]
        return search.minimise(point, most if short is search else min(most, LAST_STEPS))

    def _followed(
        self, search: TimeSearch, short: TimeSearch, groups: Sequence[Sequence[Mapping[str, float]]]
    ) -> list[tuple[Point, Evaluation]]:
        """Return where a few steps lead from each start on the beginning of the runs."""
        first = search.first(self.starts)
        tried: list[tuple[Point, Evaluation]] = []
        seen: set[bytes] = set()
        for start in (start for group in groups for start in group):
            point = short.started(first, start, self.old)
            if point is None or point.theta.tobytes() in seen:
                continue
            seen.add(point.theta.tobytes())
            found = short.minimise(point, FIRST_STEPS)
            if np.isfinite(found[1].cost):
                tried.append(found)
        return tried

    def summary(
        self, document: Mapping[str, Any], search: TimeSearch, point: Point, found: Evaluation, seconds: float
    ) -> Fit:
        """Return a fit from the end of a search."""
        if not np.isfinite(found.cost):
            return Fit(document, failure="the simulation diverges", seconds=seconds)
        m, free = search.m, search.free
        energies = block_misfit(search, found, self.stretches)
        rows, J, sizes = stacked(search, found, self.stretches)
        held = search.at_bound(point)
        loo = left_out(rows, J[:, :m][:, ~held], sizes)
        return Fit(
            document=document,
            free=free,
            theta=point.theta[: len(free)],
            covariance=self._covariance(found, rows, J, sizes, held)[: len(free), : len(free)],
            at_bound=held[: len(free)],
            misfit=float(energies.sum()),
            rows=self.rows,
            run_misfit=energies,
            left_out=loo,
            goodness=self.goodness(loo),
            nonlinear=False,
            seconds=seconds,
        )

    def _covariance(
        self, found: Evaluation, rows: np.ndarray, J: np.ndarray, sizes: Sequence[int], held: np.ndarray
    ) -> np.ndarray:
        """Return H^-1 (sum_b g_b g_b^T) H^-1 B / (B - 1) of all unknowns, g_b = J_b^T r_b; held parameters are known.

        Where a model leaves less than the resolution, H^-1 of what is missing to that is added.
        """
        ends = np.cumsum(sizes)
        scores = np.array([J[end - n : end].T @ rows[end - n : end] for end, n in zip(ends, sizes, strict=True)])
        scale = np.sqrt(np.diag(found.information))
        scale = np.where(scale > 0, scale, 1.0)
        fixed = np.zeros(len(scale), bool)
        fixed[: len(held)] = held
        H = found.information / np.outer(scale, scale)
        H[fixed], H[:, fixed] = 0.0, 0.0
        values, vectors = np.linalg.eigh(H)
        kept = np.maximum(values, INVERTED * values[-1])
        inverse = (vectors / kept) @ vectors.T / np.outer(scale, scale)
        inverse[fixed], inverse[:, fixed] = 0.0, 0.0
        count = len(sizes)
        robust = inverse @ (scores.T @ scores) @ inverse * (count / max(count - 1, 1))
        below = max(1 - float(rows @ rows) / self.rows, 0.0)
        weak = values <= INVERTED * values[-1]  # directions that the data say nothing about
        weak &= np.abs(vectors[fixed]).sum(axis=0) < 0.5
        unknown = (vectors[:, weak] / kept[weak]) @ vectors[:, weak].T / np.outer(scale, scale)
        return np.asarray(robust + below * inverse + unknown)

    def goodness(self, left: np.ndarray) -> float:
        """Return the probability of such misfits of stretches left out (B,) if a model is adequate; see the module."""
        ratio = np.log(np.maximum(left, 1e-300) / np.maximum(self.allowed, 1e-300))
        spread = float(ratio.std(ddof=1)) / np.sqrt(len(ratio)) if len(ratio) > 1 else 0.0
        if spread <= 1e-12:
            return float(ratio.mean() <= 1e-9)
        return float(student.sf(float(ratio.mean()) / spread, len(ratio) - 1))


def _cost(end: tuple[Point, Evaluation]) -> float:
    return end[1].cost


def block_misfit(search: TimeSearch, found: Evaluation, stretches: Sequence[Stretch]) -> np.ndarray:
    """Return the weighted sum of squares of each stretch, (B,)."""
    out = np.zeros(len(stretches))
    for k, errors in enumerate(found.errors):
        for b, (r, first, last) in enumerate(stretches):
            weights = np.broadcast_to(search.weights[k][r], errors[r].shape)[first:last]
            out[b] += float((weights * errors[r][first:last] ** 2).sum())
    return out


def stacked(
    search: TimeSearch, found: Evaluation, stretches: Sequence[Stretch]
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return weighted errors (n,) and slopes (n, q) by all unknowns, stretch by stretch, and the rows of each.

    Starts of runs are among the unknowns, after the parameters.
    """
    size = len(found.gradient)
    parts, slopes, sizes = [], [], []
    offsets, at = [], search.m
    for view in search.views:
        offsets.append(at)
        at += len(search.runs) * view.equations.n
    for r, first, last in stretches:
        count = 0
        for k, view in enumerate(search.views):
            eq = view.equations
            error = found.errors[k][r][first:last]
            root = np.sqrt(np.broadcast_to(search.weights[k][r], found.errors[k][r].shape)[first:last])
            parts.append((root * error).ravel())
            J = np.zeros((error.size, size))
            where = np.r_[0 : eq.m, offsets[k] + r * eq.n : offsets[k] + (r + 1) * eq.n]
            J[:, where] = (root[:, :, None] * found.slopes[k][r][first:last]).reshape(error.size, -1)
            slopes.append(J)
            count += error.size
        sizes.append(count)
    return np.concatenate(parts), np.concatenate(slopes), sizes
