"""The search for the most likely parameters, where one optimiser creeps and another goes on."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.optimize import OptimizeResult

from rotorsim.identification.harmonic import estimate
from rotorsim.identification.harmonic.coordinates import Coordinates
from rotorsim.identification.harmonic.estimate import Search, is_least
from rotorsim.identification.harmonic.likelihood import Evaluation

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


def test_steps_within_bounds_end_at_the_minimum_there():
    """r = J x - b + a small bend, three optima outside: no slope inside, and outwards at the bounds."""
    random = np.random.default_rng(3)
    J, low, high = random.standard_normal((40, 5)), np.zeros(5), np.array([np.inf, np.inf, 1.0, np.inf, np.inf])
    J[:, 1] = J[:, 0] + 1e-3 * J[:, 1]
    b = J @ np.array([0.7, 0.4, 1.3, -0.2, 0.5])

    def residual(x):
        return J @ x - b + 0.01 * (J @ x) ** 2

    def jacobian(x):
        return J * (1 + 0.02 * (J @ x))[:, None]

    x = estimate._bounded_steps(residual, jacobian, np.array([0.5, 0.5, 1 - 1e-7, 1e-7, 0.5]), low, high)
    slope = jacobian(x).T @ residual(x) / np.linalg.norm(jacobian(x), axis=0)
    assert x == pytest.approx(np.clip(x, low, high), abs=0)
    assert x[1:4] == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    assert slope[1] > 0
    assert slope[2] < -1
    assert slope[3] > 1
    assert np.abs(slope[[0, 4]]).max() < 1e-6


def test_a_search_that_runs_out_of_evaluations_goes_on_within_bounds(monkeypatch):
    """FAULT: beside a bound both methods crept, and a healthy beam was left at 1.2 times the variance of the noise."""
    lag, begun = Lag(), []

    def creeping(residual, start, *arguments, **options):
        begun.append(options["method"])
        return OptimizeResult(x=start, status=0, cost=0.5 * float(residual(start) @ residual(start)))

    monkeypatch.setattr(estimate, "least_squares", creeping)
    start = np.array([1.1 * TIME, 0.9 * SHARE]) / lag.scale
    assert lag.search().minimise(start) * lag.scale == pytest.approx([TIME, SHARE], rel=1e-9)
    assert lag.search().minimise(start, most=5) == pytest.approx(start, rel=1e-8)  # first steps stay first steps


@pytest.mark.parametrize(("rows", "misfit"), [(100, 118.498), (4000, 4115.045)])
def test_no_other_start_is_followed_below_what_one_noise_in_ten_exceeds(rows, misfit):
    """Of chi-squared; 1.2 times 4000 equations, say, is nine standard deviations more than noise leaves."""

    def left(misfit: float) -> Evaluation:
        return Evaluation(np.zeros(rows), np.zeros((rows, 0)), np.full(2, misfit / 2), np.zeros(0), rows)

    assert is_least(left(misfit - 0.01))
    assert not is_least(left(misfit + 0.01))
