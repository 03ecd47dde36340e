"""Errors of simulated outputs beside measured ones, normalised by what the signals are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.recorded.data import mean_of
from rotorsim.identification.waveform.search import OutputErrorSearch


@dataclass(frozen=True, eq=False)
class Errors:
    """Sums over all samples of measured less simulated outputs.

    squares (c,): sum (y - y_model)^2; totals (c,): sum (y - mean)^2; samples (c,): how many.
    """

    outputs: tuple[str, ...]
    squares: np.ndarray
    totals: np.ndarray
    samples: np.ndarray

    @property
    def nrmse(self) -> dict[str, float]:
        """sqrt(sum (y - y_model)^2 / sum (y - mean)^2) of every output that moves."""
        return self._of_moving(self.squares)

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square of the error of every output, SI."""
        values = np.sqrt(self.squares / np.maximum(self.samples, 1))
        return dict(zip(self.outputs, values.tolist(), strict=True))

    def floor(self, variance: Mapping[str, float]) -> dict[str, float]:
        """Return the NRMSE that noise of such mean squares alone makes, of every output that moves."""
        return self._of_moving(np.array([variance[name] for name in self.outputs]) * self.samples)

    def _of_moving(self, squares: np.ndarray) -> dict[str, float]:
        triples = zip(self.outputs, squares.tolist(), self.totals.tolist(), strict=True)
        return {name: float(np.sqrt(square / total)) for name, square, total in triples if total > 0}


def errors_of(search: OutputErrorSearch, fits: Iterable[tuple[Evaluation, Sequence[slice]]]) -> Errors | None:
    """Return the errors of the whole diagram in fits, each on a part of each run; None where one diverges."""
    outputs = search.systems[0].equations.outputs
    squares, totals, samples = np.zeros((3, len(outputs)))
    for evaluation, parts in fits:
        if not np.isfinite(evaluation.cost):
            return None
        for residual, y, part in zip(evaluation.residuals[0], search.measured[0], parts, strict=True):
            squares += np.nansum(residual[part] ** 2, axis=0)
            totals += np.nansum((y - mean_of(y))[part] ** 2, axis=0)
            samples += np.isfinite(residual[part]).sum(axis=0)
    return Errors(outputs, squares, totals, samples)
