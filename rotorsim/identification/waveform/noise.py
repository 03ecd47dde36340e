"""Noise of recordings in time: what a model leaves of every signal, stretch by stretch, and how that scatters.

Nothing is known of the noise of a measured run, and what a good model leaves is as a rule its own error. Hence:

- Noise is what is not predictable: of every measured signal, what a black-box model of all that the diagram simulates
  leaves of the residual on stretches left out (`predictability`), or what a flexible model leaves, if that is less: the
  diagram with a force that may be any smooth law of displacement and velocity (`ForceMap`) where motion was measured.
  It is not less than ``resolution``, and not more than ``colour`` times its white part: drift, lines and steps beyond
  that are something at the sensor.
- A misfit is that of ``rows`` independent samples: as many as would scatter between stretches of the runs as the
  residual of the flexible model does, and MOST_ROWS at most, so that what explains less than a percent counts as
  nothing.
- A model is adequate unless it predicts stretches left out of the fit worse than ``no_worse`` times the flexible one
  does, or than that by ``flexible_share`` of the square that the diagram left at first, by a t-test over the stretches;
  and unless all together leave more than ``uneven`` times that.
- Covariances are those of the stretches' own scatter (sandwich), so that they hold for coloured errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import comb

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.left_out import Products
from rotorsim.identification.waveform.driven.equations import clock_ports
from rotorsim.identification.waveform.evaluation import Evaluation, weighted_blocks
from rotorsim.identification.waveform.linearised import places_of, simulated_signals
from rotorsim.identification.waveform.predictability import Predictability, predictability
from rotorsim.identification.waveform.recorded.data import SampledRun, mean_of
from rotorsim.identification.waveform.search import REFIT_EVALUATIONS, OutputErrorSearch
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM
from rotorsim.signals.quantisation import step_of

STRETCHES = 20  # of all runs together; 4 of each run at least
LEAST_STRETCH = 10  # samples, of one of these 4
MOST_ROWS = 2000
LEAST_ROWS = 4  # times the stretches
REWEIGHTED = 4  # times that a fit and the weights follow one another
QUIET_STRETCH = 25  # samples: white noise has 0.76 of its mean square, by differences, in the quietest quarter of such
LOUDER = 2.0  # times that: 1.5 times the mean square of steady noise, which is never cut, with 50 % for its own scatter
MOST_DIFFERENCES = 6  # order, of a shaft that turns: its motion is of low orders, and sampled much faster
INVERTED = 1e-13  # smallest eigenvalue of the scaled information, of the largest, that counts

Stretch = tuple[int, int, int]  # run, first sample, last sample but one
Variance = Mapping[tuple[str, str], float]  # (subsystem, output) -> mean square that counts as noise


def weights_of(variance: Variance, runs: Sequence[SampledRun], rows: int) -> dict[tuple[str, str], float]:
    """Return the weights of squares that make a misfit that of ``rows`` independent samples of unit variance."""
    samples = sum(int(np.isfinite(run.values[name]).sum()) for run in runs for _, name in variance)
    return {signal: rows / samples / value for signal, value in variance.items()}


def variance_scale(search: OutputErrorSearch) -> dict[tuple[str, str], float]:
    """Return the mean squares of all outputs less their regression on the inputs at the same instant.

    A position that follows its reference is no larger than the distance between them. One for what nobody measured.
    """
    scale: dict[tuple[str, str], float] = {}
    for system, measured in zip(search.systems, search.measured, strict=True):
        y = np.concatenate(measured)
        given = np.concatenate([run.inputs(system.equations.inputs, 1)[:, 0] for run in search.runs])
        inputs = np.column_stack([np.ones(len(y)), given])
        for signal, values in zip(system.signals, y.T, strict=True):
            there = np.isfinite(values)
            if not there.any():
                scale[signal] = 1.0
                continue
            own, at = values[there], inputs[there]
            residual = own - at @ np.linalg.lstsq(at, own, rcond=None)[0]
            scale[signal] = max(float((residual**2).mean()), 1e-300)
    return scale


def residual_variance(search: OutputErrorSearch, evaluation: Evaluation) -> dict[tuple[str, str], float]:
    """Return the mean square of the residual of every output, ``resolution`` of its scale at least."""
    scale = variance_scale(search)
    squares: dict[tuple[str, str], float] = {}
    for system, residuals in zip(search.systems, evaluation.residuals, strict=True):
        squares |= zip(system.signals, mean_of(np.concatenate(residuals) ** 2).tolist(), strict=True)
    return {signal: max(value, CRITERIA.resolution**2 * scale[signal]) for signal, value in squares.items()}


@dataclass(frozen=True, eq=False)
class Noise:
    """variance: of what counts as noise, by signal. rows: independent samples. left (B,): misfit of each stretch.

    structure: the largest share of a residual that a black box predicts, 0 where that may be chance. unjudged: why
    such a share would not show; empty where it would.
    """

    variance: Variance
    rows: int
    left: np.ndarray
    structure: float = 0.0
    unjudged: str = ""


def judged_beside(diagram: Diagram, search: OutputErrorSearch, evaluation: Evaluation) -> Predictability:
    """Return how much of the residual of a fit a black-box model of the diagram's signals predicts."""
    first = search.systems[0].equations
    names = [*dict.fromkeys(place.port for place in places_of(diagram, first.outputs))] or [*first.outputs]
    signals = simulated_signals(diagram, search, evaluation, names)
    run = search.runs[0]
    p = first.parameters(search.p[0], evaluation.unknowns[: search.m])
    A = first.matrices[0](run.start, np.zeros(first.n), run.inputs(first.inputs, 1)[0, 0], p)[0]
    poles = np.exp(np.linalg.eigvals(A) * run.dt) if np.isfinite(A).all() else np.zeros(0)
    return predictability(evaluation.residuals[0], signals, poles)


def unpredicted(
    diagram: Diagram, search: OutputErrorSearch, evaluation: Evaluation, stretches: Sequence[Stretch]
) -> Noise:
    """Return what no black-box model of the diagram's signals predicts of the residual of a fit."""
    judged = judged_beside(diagram, search, evaluation)
    rest = replace(evaluation, residuals=[judged.rest, *evaluation.residuals[1:]])
    turns = bool({*clock_ports(diagram)} & {*search.systems[0].equations.inputs})
    changes = white_part(judged.rest, MOST_DIFFERENCES) if turns else sensor_noise(judged.rest, search.measured[0])
    white = dict(zip(search.systems[0].signals, changes.tolist(), strict=True))
    most = CRITERIA.faint if judged.structure else CRITERIA.colour  # beside physics that are missing, less is certain
    variance = {
        signal: min(value, max(most * white.get(signal, np.inf), CRITERIA.resolution**2 * scale))
        for (signal, value), scale in zip(
            residual_variance(search, rest).items(), variance_scale(search).values(), strict=True
        )
    }
    energies = block_misfit(replace(search, weights={signal: 1 / v for signal, v in variance.items()}), rest, stretches)
    rows = independent(energies, stretches)
    weighed = [np.isfinite(part) for residuals in rest.residuals for part in residuals]
    runs = len(search.runs)
    samples = np.array([sum(int(own[a:b].sum()) for own in weighed[r::runs]) for r, a, b in stretches])
    left = np.minimum(energies, CRITERIA.model_error * samples) * rows / samples.sum()
    return Noise(variance, rows, left, judged.structure, _unjudged(search, evaluation, variance))


def white_part(parts: Sequence[np.ndarray], order: int) -> np.ndarray:
    """Return the mean squares (c,) of the white part of signals (N, c), by differences up to an order K.

    min_k mean((d^k y)^2) / C(2 k, k): white noise gives its variance; motion that is sampled n times in a period at
    least keeps (2 sin(pi / n))^2k / C(2 k, k) of its own, which for 16 samples is 8 % at k = 1, and 1e-8 at k = 6.
    Source: J. von Neumann, Ann. Math. Stat. 12 (1941) 367, of higher order.
    """
    squares = (np.concatenate([np.diff(part, k, axis=0) for part in parts]) ** 2 for k in range(1, order + 1))
    return np.asarray(np.min([mean_of(square) / comb(2 * k, k) for k, square in enumerate(squares, start=1)], axis=0))


def sensor_noise(parts: Sequence[np.ndarray], measured: Sequence[np.ndarray]) -> np.ndarray:
    """Return the mean squares (c,) of the white part of residuals (N, c) that sensors may have made.

    What is white and much larger in some stretches than in the quietest quarter (at rest) is motion that jumps from
    sample to sample: no more than LOUDER times the latter, or q^2 / 12 of readings that are multiples of q, is noise.
    """
    cut = [piece for part in parts for piece in np.array_split(part, max(len(part) // QUIET_STRETCH, 1))]
    quiet = np.nanquantile([white_part([piece], 1) for piece in cut], 0.25, axis=0)
    readings = (column[np.isfinite(column)] for column in np.concatenate(measured).T)
    steps = [0.0 if (step := step_of(column)) is None else step.size for column in readings]
    return np.asarray(np.minimum(white_part(parts, 1), np.maximum(LOUDER * quiet, np.square(steps) / 12)))


def _unjudged(search: OutputErrorSearch, evaluation: Evaluation, variance: Variance) -> str:
    """Return why structure of the residual would not show: too few samples, or nothing that moves; else nothing.

    A share s of the noise makes n s of the misfit of n samples, a law of k parameters by chance less than its
    chi-squared quantile.
    """
    share = 1 - 1 / CRITERIA.model_error
    least = int(np.ceil(chi2.isf(CRITERIA.false_alarm, CRITERIA.law_parameters) / share))
    measured = np.concatenate(search.measured[0])
    samples = int(np.isfinite(measured).sum(axis=0).min())
    if samples < least:
        return f"{samples} samples are too few to tell structure of {100 * share:.0f} % from noise: {least} are needed"
    motion = np.concatenate(
        [y - e - mean_of(y - e) for y, e in zip(search.measured[0], evaluation.residuals[0], strict=True)]
    )
    noise = [variance[signal] for signal in search.systems[0].signals]
    if (mean_of(motion**2) <= noise).all():
        return "nothing moves by more than its noise"
    return ""


def left_over(
    search: OutputErrorSearch, evaluation: Evaluation, stretches: Sequence[Stretch], share: float = 1.0
) -> Noise:
    """Return all that a fit leaves as noise, or a share of its square."""
    variance = {signal: value * share for signal, value in residual_variance(search, evaluation).items()}
    rows = independent(block_misfit(search, evaluation, stretches), stretches)
    weighted = replace(search, weights=weights_of(variance, search.runs, rows))
    return Noise(variance, rows, misfits_left_out(weighted, evaluation, stretches))


def reweighted(search: OutputErrorSearch, start: np.ndarray) -> tuple[OutputErrorSearch, Evaluation]:
    """Return a fit and the search it is of, whose weights of the whole diagram follow the residual, in turns."""
    evaluation = search.minimise(start, REFIT_EVALUATIONS)
    for _ in range(REWEIGHTED - 1):
        if not np.isfinite(evaluation.cost):
            break
        variance = residual_variance(search, evaluation)
        whole = {signal: 1 / value for signal, value in variance.items() if signal[0] == WHOLE_DIAGRAM}
        search = replace(search, weights={**search.weights, **whole})
        evaluation = search.minimise(evaluation.unknowns, REFIT_EVALUATIONS, evaluation)
    return search, evaluation


def stretches_of(runs: Sequence[SampledRun]) -> tuple[Stretch, ...]:
    """Return the stretches into which runs are divided, as many samples in each of a run."""
    return independent_stretches([run.counted for run in runs])


def independent_stretches(counted: Sequence[np.ndarray]) -> tuple[Stretch, ...]:
    """Return stretches of runs of which some samples or rows count, (N,) each."""
    places = [np.flatnonzero(own) for own in counted]
    total = sum(map(len, places))
    stretches: list[Stretch] = []
    for r, own in enumerate(places):
        count = max(min(4, len(own) // LEAST_STRETCH), round(STRETCHES * len(own) / total), 1)
        at = np.linspace(0, len(own), count + 1).astype(int)[1:-1]
        ends = [0, *own[at].tolist(), len(counted[r])]
        stretches += [(r, first, last) for first, last in pairwise(ends)]
    return tuple(stretches)


def independent(energies: np.ndarray, stretches: Sequence[Stretch]) -> int:
    """Return the number of independent samples whose sums of squares would scatter as those of the stretches do.

    The sum over one of B stretches of n independent samples has the relative variance 2 B / n.
    """
    lengths = np.array([last - first for _, first, last in stretches])
    level = energies / lengths
    spread = float((level.std(ddof=1) / level.mean()) ** 2) if level.mean() > 0 else 0.0
    count = 2 * len(level) / max(spread, 1e-9)
    return int(np.clip(count, LEAST_ROWS * len(level), min(MOST_ROWS, lengths.sum())))


def whitened(search: OutputErrorSearch, evaluation: Evaluation, stretches: Sequence[Stretch]) -> list[np.ndarray]:
    """Return the weighted residual of each stretch, (n,)."""
    roots = {pair: search.root(*pair) for pair in search.pairs}
    return [
        np.concatenate([
            (roots[k, r][first:last] * np.nan_to_num(residuals[r][first:last])).ravel()
            for k, residuals in enumerate(evaluation.residuals)
        ])
        for r, first, last in stretches
    ]  # fmt: skip


def stacked(
    search: OutputErrorSearch, evaluation: Evaluation, stretches: Sequence[Stretch]
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return the weighted residual (n,), its Jacobian (n, q) by all unknowns, stretch by stretch, and rows of each."""

    def jacobian(k: int, r: int, first: int, last: int) -> np.ndarray:
        root, J = search.root(k, r)[first:last], evaluation.jacobians[k][r][first:last]
        found = np.zeros((root.size, len(evaluation.unknowns)))
        found[:, search.columns(k, r)] = (root[:, :, None] * J).reshape(root.size, -1)
        return found

    residuals = whitened(search, evaluation, stretches)
    J = [jacobian(k, *stretch) for stretch in stretches for k in range(len(search.systems))]
    return np.concatenate(residuals), np.concatenate(J), [len(own) for own in residuals]


def products_of(search: OutputErrorSearch, evaluation: Evaluation, stretches: Sequence[Stretch]) -> Products:
    """Return what each stretch says of all unknowns."""
    q, roots = len(evaluation.unknowns), {pair: search.root(*pair) for pair in search.pairs}
    squares, gradients, information = np.zeros(len(stretches)), np.zeros((len(stretches), q)), []
    for b, (r, first, last) in enumerate(stretches):
        H = np.zeros((q, q))
        for k in range(len(search.systems)):
            own, here = search.columns(k, r), slice(first, last)
            parts = roots[k, r][here], evaluation.residuals[k][r][here], evaluation.jacobians[k][r][here]
            for e, J in weighted_blocks(*parts):
                squares[b] += float(e @ e)
                gradients[b, own] += J.T @ e
                H[np.ix_(own, own)] += J.T @ J
        information.append(H)
    return Products(squares, gradients, np.array(information).reshape(len(stretches), q, q))


def block_misfit(search: OutputErrorSearch, evaluation: Evaluation, stretches: Sequence[Stretch]) -> np.ndarray:
    """Return the weighted sum of squares of each stretch, (B,)."""
    return np.array([float(own @ own) for own in whitened(search, evaluation, stretches)])


def misfits_left_out(search: OutputErrorSearch, evaluation: Evaluation, stretches: Sequence[Stretch]) -> np.ndarray:
    """Return the misfits of stretches left out, (B,)."""
    return products_of(search, evaluation, stretches).of(np.arange(search.m)).left_out()


def robust_covariance(
    information: np.ndarray, products: Products, searched: np.ndarray, rows: int, prior: np.ndarray | None = None
) -> np.ndarray:
    """Return H^-1 (sum_b g_b g_b^T) H^-1 B / (B - 1) of all unknowns, g_b = J_b^T r_b; held ones are known.

    products: of the B stretches. Where a model leaves less than the resolution, H^-1 of what is missing to ``rows`` is
    added; and all of H^-1 in directions that the data say nothing about. prior (q,): information of priors within H,
    each one more measured value in the sum. Source: K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986) 13-22.
    """
    g, count = products.gradients[:, searched], len(products.squares)
    scores = g.T @ g * (count / max(count - 1, 1))
    scores += np.diag(np.zeros(len(scores)) if prior is None else prior[searched])
    H = information[np.ix_(searched, searched)]
    scale = np.sqrt(np.diag(H))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    least = INVERTED * values.max(initial=0.0)
    vectors = vectors / scale[:, None]
    inverse = vectors / np.maximum(values, least) @ vectors.T
    robust = inverse @ scores @ inverse
    below = max(1 - float(products.squares.sum()) / rows, 0.0)
    weak = vectors[:, values <= least]
    covariance = np.zeros_like(information)
    covariance[np.ix_(searched, searched)] = robust + below * inverse + weak / least @ weak.T
    return covariance


def goodness_left_out(left: np.ndarray, allowed: np.ndarray) -> float:
    """Return the probability of such misfits of stretches left out (B,) if a model is adequate; allowed (B,).

    By a t-test over the stretches; zero where all together leave `Criteria.uneven` times what they may: what acts in
    few stretches makes the logarithms scatter, and a t-test sees nothing.
    """
    ratio = np.log(np.maximum(left, 1e-300) / np.maximum(allowed, 1e-300))
    if left.sum() > CRITERIA.uneven * allowed.sum():
        return 0.0
    spread = float(ratio.std(ddof=1)) / np.sqrt(len(ratio)) if len(ratio) > 1 else 0.0
    if spread <= 1e-12:
        return float(ratio.mean() <= 1e-9)
    return float(student.sf(float(ratio.mean()) / spread, len(ratio) - 1))
