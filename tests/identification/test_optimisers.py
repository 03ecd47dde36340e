"""The search for the most likely parameters, where one optimiser creeps and another goes on."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from rotorsim.identification.harmonic import estimate
from rotorsim.identification.harmonic.coordinates import Coordinates
from rotorsim.identification.harmonic.estimate import Search

SHARE, TIME = 0.7, 48e-6
S = 2j * np.pi * np.linspace(5.0, 500.0, 300)
WEIGHT = 3e4


def response(tau: float, share: float) -> np.ndarray:
    """Return 1 - share + share / (1 + s tau): low frequencies tell the product of the two only."""
    return 1 - share + share / (1 + S * tau)


@dataclass
class Lag:
    """A search of its own: the lag of part of a force, by two parameters that trade."""

    scale: np.ndarray = field(default_factory=lambda: np.array([1e-4, 0.3]))
    evaluations: int = 0

    def search(self) -> Search:
        found = object.__new__(Search)
        low, high = np.array([1e-12, 0.0]), np.array([np.inf, 1.0])
        found.coordinates = Coordinates(self.scale, (), low, high)
        found.residual, found.jacobian = self.residual, self.jacobian
        return found

    def residual(self, q: np.ndarray) -> np.ndarray:
        self.evaluations += 1
        wrong = WEIGHT * (response(*(q * self.scale)) - response(TIME, SHARE))
        return np.concatenate([wrong.real, wrong.imag])

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        tau, share = q * self.scale
        by = np.array([-share * S / (1 + S * tau) ** 2, -1 + 1 / (1 + S * tau)]).T * WEIGHT * self.scale
        return np.concatenate([by.real, by.imag])


@pytest.mark.parametrize("start", [(1e-3, 0.2), (2e-4, 0.2)])
def test_where_the_first_runs_out_of_evaluations_the_second_goes_on(start, monkeypatch):
    lag, few = Lag(), 20
    monkeypatch.setattr(estimate, "MOST_EVALUATIONS", few)
    search, q = lag.search(), np.array(start) / lag.scale
    with monkeypatch.context() as alone:
        alone.setattr(estimate, "SEARCH_METHODS", estimate.SEARCH_METHODS[:1])
        alone.setattr(estimate, "PASSES", 1)
        assert search.minimise(q, most=few) * lag.scale != pytest.approx([TIME, SHARE], rel=1e-2)
    lag.evaluations = 0
    assert search.minimise(q, most=few) * lag.scale == pytest.approx([TIME, SHARE], rel=1e-4)
    assert lag.evaluations <= 2 * few * estimate.PASSES
