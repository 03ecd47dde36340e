"""The further run in time that separates two hypotheses most: another amplitude, a further sensor, or the same again.

Both fitted diagrams are simulated through it. Along S, what uncertain parameters and unknown starts of both change,
the difference d of their predictions counts as much as n such runs leave of it (in standard deviations of the noise):

s_n^2 = d^T (I / n + S S^T)^-1 d = n (d^T d - d^T S (I / n + S^T S)^-1 S^T d)
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from rotorsim.diagnosis.evidence.change import Change, best_of, change_of
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.linearised import with_outputs
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch

TRIED_AMPLITUDES = (2.0, 0.5)  # times that of an input on record, about its mean
LARGEST_OUTPUT = 2.5  # times the largest on record: twice is what a linear diagram gives, and a quarter more
MOST_RUNS = 3  # of the recording that are changed
LOOSE = 1e3  # standard deviations of the noise by which unknown starts may change the predictions


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A fitted diagram beside the runs.

    whole: simulates signals of it. root (m, m): L, L L^T the covariance of its parameters; loose (m,): those that
    nothing holds.
    """

    whole: OutputErrorSearch
    unknowns: np.ndarray
    sub: int
    root: np.ndarray
    loose: np.ndarray

    @classmethod
    def of(
        cls, fit: Fit, diagram: Diagram, search: OutputErrorSearch, evaluation: Evaluation, signals: Sequence[str]
    ) -> Hypothesis:
        """Return a fit as it is simulated; signals: flat names."""
        whole, unknowns = with_outputs(diagram, search, evaluation, signals)
        covariance = fit.covariance.copy()
        loose = ~np.isfinite(covariance).all(axis=1)
        covariance[loose] = covariance[:, loose] = 0.0
        values, vectors = np.linalg.eigh(covariance)
        return cls(whole, unknowns, evaluation.sub, vectors * np.sqrt(np.maximum(values, 0.0)), loose)

    def predicted(self, r: int, run: SampledRun, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return signals (N, count) of a run in the place of run r, and their derivatives; None if it diverges.

        By the parameters in standard deviations (N, count, m), and by what nothing holds (N, count, l).
        """
        runs = [run if k == r else other for k, other in enumerate(self.whole.runs)]
        y, by = replace(self.whole, runs=runs).simulated(self.unknowns, 0, r, self.sub)
        if not (np.isfinite(y).all() and np.isfinite(by).all()):
            return None
        m = len(self.root)
        known, starts = by[:, :count, :m], by[:, :count, self.whole.m :]
        return y[:, :count], known @ self.root, np.concatenate([known[:, :, self.loose], starts], axis=2)


@dataclass(frozen=True)
class SensorNoise:
    """The noise of a further sensor, as part of the rms of its signal; level: its weight times that mean square."""

    part: float
    level: float


@dataclass(frozen=True, eq=False)
class Contrast:
    """What each of s signals of a run says of two hypotheses: d^T d (s,), S^T d (s, k), S^T S (s, k, k)."""

    square: np.ndarray
    inner: np.ndarray
    gram: np.ndarray

    @classmethod
    def of(cls, pair: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], root: np.ndarray) -> Contrast:
        """Return the contrast of two predictions; root (s,): of the weights of squares."""
        (y, *held), (other, *beside) = pair
        d = (y - other) * root
        known = np.concatenate([held[0], beside[0]], axis=2) * root[:, None]
        loose = np.concatenate([held[1], beside[1]], axis=2) * root[:, None]
        norm = np.sqrt((loose**2).sum(axis=(0, 1)))
        S = np.concatenate([known, loose * np.where(norm > 0, LOOSE / np.where(norm > 0, norm, 1.0), 0.0)], axis=2)
        return cls((d**2).sum(axis=0), np.einsum("njk,nj->jk", S, d), np.einsum("njk,njl->jkl", S, S))

    def separation(self, signals: Sequence[int], times: int) -> float:
        """Return how far apart a number of such runs put the hypotheses, of which some signals are recorded."""
        which = list(signals)
        e, b, G = self.square[which].sum(), self.inner[which].sum(axis=0), self.gram[which].sum(axis=0)
        return float(np.sqrt(max(times * (e - b @ np.linalg.solve(np.eye(len(b)) / times + G, b)), 0.0)))


def sensors_of(diagrams: Sequence[Diagram], given: Collection[str], recorded: Collection[str]) -> list[str]:
    """Return where a sensor may be put: outputs of all these diagrams that are one number, and not recorded.

    given: signals of the diagram as it was given; what a hypothesis puts in cannot be recorded.
    """
    ports = [
        {str(port) for node in diagram.nodes.values() for port in node.outputs.values() if port.shape == ()}
        for diagram in diagrams
    ]
    return sorted(set.intersection(*ports, set(given)) - set(recorded))


def best_change(
    pair: tuple[Hypothesis, Hypothesis],
    inputs: Sequence[str],
    signals: Sequence[str],
    weights: np.ndarray,
    largest: np.ndarray,
    noise: SensorNoise,
) -> Change | None:
    """Return the further run that separates two hypotheses most; None where none does.

    A sensor is named only where it takes fewer runs than any amplitude. signals: the c recorded ones, then those that
    a sensor might record. weights (c,): of squares; largest (c,) on record. noise: of sensors.
    """
    runs = pair[0].whole.runs
    chosen = np.unique(np.linspace(0, len(runs) - 1, MOST_RUNS).round().astype(int)).tolist()
    driven = best_of(change for r in chosen for change in _driven(pair, r, inputs, weights, largest))
    if driven is not None and driven.runs == 1:
        return driven
    return best_of([driven, *(change for r in chosen for change in _recorded(pair, r, signals, weights, noise))])


def _driven(
    pair: tuple[Hypothesis, Hypothesis], r: int, inputs: Sequence[str], weights: np.ndarray, largest: np.ndarray
) -> Iterator[Change | None]:
    """Yield what run r tells once more, and with other amplitudes of its inputs."""
    run, c = pair[0].whole.runs[r], len(weights)
    for name, factor in [("", 1.0), *product(inputs, TRIED_AMPLITUDES)]:
        again, words = run, f"run {run.id} again"
        if name:
            values = run.values[name]
            again = replace(run, values={**run.values, name: values.mean() + factor * (values - values.mean())})
            words += f" with {name} at {factor:g} times its amplitude"
        found = [one.predicted(r, again, c) for one in pair]
        within = [one for one in found if one is not None and (np.abs(one[0]) <= LARGEST_OUTPUT * largest).all()]
        if len(within) == len(pair):
            yield change_of(words, partial(Contrast.of(within, np.sqrt(weights)).separation, range(c)))


def _recorded(
    pair: tuple[Hypothesis, Hypothesis], r: int, signals: Sequence[str], weights: np.ndarray, noise: SensorNoise
) -> Iterator[Change | None]:
    """Yield what run r tells once more with one more sensor."""
    c, run = len(weights), pair[0].whole.runs[r]
    found = [told for one in pair if (told := one.predicted(r, run, len(signals))) is not None]
    if len(found) == len(pair):
        contrast = Contrast.of(found, np.sqrt(np.append(weights, _of_sensors(found[0][0][:, c:], noise.level))))
        for k, name in enumerate(signals[c:], c):
            words = (
                f"run {run.id} again with {name} recorded as well, with noise of {100 * noise.part:.2g} % of its rms"
            )
            yield change_of(words, partial(contrast.separation, [*range(c), k]))


def _of_sensors(y: np.ndarray, level: float) -> np.ndarray:
    """Return the weights of sensors (s,) of predicted signals y (N, s), whose noise is a part of their spread."""
    spread = y.std(axis=0)
    return np.asarray(np.where(spread > 0, level / np.where(spread > 0, spread, 1.0) ** 2, 0.0))
