"""What runs that took no part say about a fit, by linear theory."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from rotorsim.diagnose.scoring import surprise


def prediction(residual: np.ndarray, slopes: np.ndarray, *stds: float | None) -> SimpleNamespace:
    free = [SimpleNamespace(prior_std=std) for std in stds or [None] * slopes.shape[1]]
    experiment = SimpleNamespace(free=free)
    return SimpleNamespace(evaluation=SimpleNamespace(residual=residual, slopes=slopes), experiment=experiment)


def test_surprise_is_what_a_fit_to_all_runs_leaves_more():
    """The misfit of held-out runs beside uncertain parameters is what a joint fit adds to that of the fitted runs."""
    random = np.random.default_rng(3)
    S, y = random.standard_normal((30, 4)), random.standard_normal(30)
    J, z = random.standard_normal((12, 4)), random.standard_normal(12)
    best = np.linalg.lstsq(S, y, rcond=None)[0]
    alone = float(np.sum((S @ best - y) ** 2))
    both, ends = np.vstack([S, J]), np.concatenate([y, z])
    joint = float(np.sum((both @ np.linalg.lstsq(both, ends, rcond=None)[0] - ends) ** 2))
    fitted, held = prediction(S @ best - y, S), [prediction((J @ best - z)[k : k + 6], J[k : k + 6]) for k in (0, 6)]
    assert surprise(fitted, held) == pytest.approx(joint - alone, rel=1e-10)


def test_surprise_is_chi_squared_where_the_structure_is_true():
    """Parameters of any scale, one of which the fitted runs do not show: nothing is called surprising too often."""
    random = np.random.default_rng(5)
    scale = np.array([1e-6, 1.0, 1e8, 1.0])
    found = []
    for _ in range(400):
        S, J = random.standard_normal((30, 4)) * scale, random.standard_normal((12, 4)) * scale
        S[:, 3] = J[:, 3] = 0.0
        noise = random.standard_normal(30)
        wrong = np.linalg.pinv(S) @ noise
        held = prediction(J @ wrong - random.standard_normal(12), J)
        found.append(surprise(prediction(S @ wrong - noise, S), [held]))
    assert kstest(found, chi2(12).cdf).pvalue > 0.01


def test_no_surprise_is_known_without_a_settled_motion():
    S = np.ones((3, 1))
    assert surprise(prediction(np.zeros(3), S), [prediction(np.full(2, np.nan), np.ones((2, 1)))]) is None


def test_what_is_known_beforehand_holds_a_parameter_that_no_run_shows():
    S, J = np.zeros((5, 1)), np.ones((4, 1))
    far = np.full(4, 3.0)
    assert surprise(prediction(np.zeros(5), S), [prediction(far, J)]) == pytest.approx(0.0, abs=1e-9)
    held = surprise(prediction(np.zeros(5), S, 0.1), [prediction(far, J)])
    assert held == pytest.approx(36 * (1 - 4 / 104))  # e^T (I + J 0.01 J^T)^-1 e
