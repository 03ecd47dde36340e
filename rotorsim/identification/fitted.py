"""A diagram fitted to harmonics, and what changes with a finer mesh or more that is free."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.diagram.resolve.settings import with_finer_mesh
from rotorsim.identification.harmonic.estimate import Estimate, Search, estimate
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.identification.held import Estimated


@dataclass(frozen=True, eq=False)
class FittedHarmonics:
    """A diagram fitted to harmonics; opened: what compares another with them."""

    diagram: Diagram
    opened: Callable[[Diagram], Likelihood]
    search: Search
    estimate: Estimate

    def change(self, block: str, parts: int) -> float:
        """Return the square of what a finer mesh changes in the whitened prediction. Raises RotorsimError."""
        finer = self.opened(with_finer_mesh(self.diagram, block, parts)).evaluate(self.estimate.theta)
        change = finer.residual - self.estimate.evaluation.residual
        return float(change @ change)

    def finer(self, block: str, parts: int) -> FittedHarmonics:
        """Return the fit with a finer mesh, from where this one ended. Raises RotorsimError."""
        return fit_harmonics(with_finer_mesh(self.diagram, block, parts), self.opened, self.estimate.theta)

    def worse_by(self, other: FittedHarmonics) -> float:
        """Return how much more another fit leaves."""
        return other.estimate.misfit - self.estimate.misfit

    def freed(self, more: Sequence[Free] = ()) -> Estimated:
        """Return what is estimated with more parameters free, from where this fit ended. Raises RotorsimError."""
        found = self.estimate
        if more:
            start = np.array([*found.theta, *(item.value for item in more)])
            found = fit_harmonics(replace(self.diagram, free=(*found.free, *more)), self.opened, start).estimate
        std = found.widening * found.std
        return Estimated(found.free, found.theta, std, found.at_bound, found.misfit, found.widening)


def fit_harmonics(
    diagram: Diagram, opened: Callable[[Diagram], Likelihood], start: np.ndarray | None = None, *, tries: int = 3
) -> FittedHarmonics:
    """Return the most likely parameters from a start, the best few of the diagram by default. Raises RotorsimError."""
    search = Search(opened(diagram))
    return FittedHarmonics(diagram, opened, search, estimate(search, start, tries=tries))
