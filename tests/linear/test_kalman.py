"""Kalman filters of several systems at once, against dense matrices of all samples, SciPy, and each other."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from rotorsim.linear import kalman_in_c
from rotorsim.linear.kalman import Filters, Systems
from rotorsim.linear.kalman import steady_variance as riccati


def systems(samples: int, count: int, rows: int, n: int = 3, c: int = 2) -> tuple[Systems, np.ndarray]:
    """Systems near the limit of stability, and a signal (rows, c, 3); samples: of matrices that change, or 1."""
    random = np.random.default_rng(8)
    F = np.diag([0.97, 0.9, 0.5])[:n, :n] + 0.05 * random.normal(size=(samples, n, n))
    sizes = (samples, n, count), (samples, c, n), (samples, c, count)
    pole, Q = np.where(np.arange(count) % 2, 0.99, 1.0), random.uniform(0.01, 1.0, size=(count, n + 1))
    return Systems(F, *(random.normal(size=size) for size in sizes), pole, Q), random.normal(size=(rows, c, 3))


@pytest.fixture(params=["in C", "in NumPy"])
def language(request, monkeypatch) -> str:
    if request.param == "in NumPy":
        monkeypatch.setattr(kalman_in_c, "_library", lambda: None)
    return request.param


@pytest.mark.parametrize("samples", [1, 12])
def test_filters_and_smoothers_are_those_of_all_samples_at_once(language, samples):
    """The states of N samples are one Gaussian vector, of which all outputs are linear combinations and noise."""
    N, count, K = 12, 11, 3  # more than go side by side
    some, y = systems(samples, count, N)
    P, steady = some.steady()
    assert steady.all()
    found, log_det = some.products(P, y)
    gain, _, logs = some.gains(P, N)
    states, spread = some.smoothed(P, y)
    np.testing.assert_allclose(logs, log_det, rtol=1e-12)
    assert gain.shape == (samples, count, 4, 2)
    for b in range(count):
        m = 4
        from_all = np.zeros((N * m, N * m))  # of what enters to the states
        variance = np.zeros((N * m, N * m))
        shown = np.zeros((N * 2, N * m))
        for k in range(N):
            H = some.augmented(k)[1]
            own = slice(k * m, (k + 1) * m)
            from_all[own, own] = np.eye(m)
            variance[own, own] = P[b] if k == 0 else np.diag(some.Q[b])
            if k:
                before = some.augmented(k - 1)[0][b]
                from_all[own, : k * m] = before @ from_all[(k - 1) * m : k * m, : k * m]
            shown[k * 2 : (k + 1) * 2, own] = H[b]
        of_states = from_all @ variance @ from_all.T
        V = shown @ of_states @ shown.T + np.eye(2 * N)
        flat = y.reshape(-1, K)
        np.testing.assert_allclose(found[b], flat.T @ np.linalg.solve(V, flat), rtol=1e-9, atol=1e-9)
        assert log_det[b] == pytest.approx(np.linalg.slogdet(V)[1], rel=1e-10)
        given = of_states @ shown.T @ np.linalg.solve(V, flat)
        np.testing.assert_allclose(states[:, b].reshape(-1, K), given, rtol=1e-8, atol=1e-9)
        left = of_states - of_states @ shown.T @ np.linalg.solve(V, shown @ of_states)
        np.testing.assert_allclose(spread[:, b], np.diag(left)[m - 1 :: m], rtol=1e-8, atol=1e-10)


def test_a_system_that_diverges_leaves_the_others_beside_it(language):
    some, y = systems(20, 3, 20)
    P, _ = some.steady()
    products, log_det = some.products(P, y)
    P[1] = -1e3 * np.eye(4)
    after = some.products(P, y)
    assert after[1][1] == np.inf
    for b in (0, 2):
        np.testing.assert_allclose(after[0][b], products[b], rtol=1e-12)
        assert after[1][b] == pytest.approx(log_det[b], rel=1e-12)
    assert np.isfinite(after[0]).all()


def test_some_of_the_systems_are_those_alone(language):
    some, y = systems(20, 5, 20)
    P, _ = some.steady()
    which = np.array([False, True, False, True, True])
    for whole, part in zip(some.products(P, y), some.of(which).products(P[which], y), strict=True):
        np.testing.assert_allclose(part, whole[which], rtol=1e-12)


@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_what_nothing_observes_has_no_steady_filter_in_any_unit(unit):
    """FAULT: a constant added to a servo's speed, where it is read and taken, moves nothing once the speed is its
    opposite; after 40 doublings rounding decided that some of its filters were steady, which ones hung on the unit."""
    F = np.array([[0.97516, -0.0592532, -1.2e-4 * unit], [4.93777e-3, 0.999851, 2.4e-5 * unit], [0.0, 0.0, 1.0]])
    constant = np.array([-0.98 * unit / 202.0, 0.0, 1.0])  # is not read, and stays
    F[:2, 2] = ((np.eye(3) - F) @ constant)[:2] + F[:2, 2]
    H = np.array([[202.0 / unit, 0.0, 0.98], [0.0, 400.0 / unit, 0.0]])
    assert H @ constant == pytest.approx([0, 0], abs=1e-12)
    assert F @ constant == pytest.approx(constant)
    filters = [np.diag([1e-14 * unit**2, 4e-16 * unit**2, q]) for q in 10.0 ** np.arange(-7, 4)]
    for left, steady in ((1.0, False), (0.999, True)):
        F[2, 2] = left
        count = len(filters)
        assert (riccati(np.tile(F, (count, 1, 1)), np.tile(H, (count, 1, 1)), np.stack(filters))[1] == steady).all()


def test_steady_filters_are_those_of_the_riccati_equation():
    """Of SciPy; where two integrators and a free signal leave every eigenvalue at one, too, where SciPy finds none."""
    random = np.random.default_rng(3)
    F, H = random.normal(size=(4, 3, 3)) * 0.4, random.normal(size=(4, 2, 3))
    Q = np.tile(np.diag([1e-3, 1e-2, 4.0]), (4, 1, 1))
    found, steady = riccati(F, H, Q)
    assert steady.all()
    for b in range(4):
        np.testing.assert_allclose(found[b], solve_discrete_are(F[b].T, H[b].T, Q[b], np.eye(2)), rtol=1e-9)
    dt = 0.025
    F = np.array([[[1.0, 0.0, dt], [dt, 1.0, dt**2 / 2], [0.0, 0.0, 1.0]]])
    H, Q = np.array([[[0.0, 10.0, 0.0]]]), np.diag([1e-14, 1e-14, 1e-4])[None]
    [P], steady = riccati(F, H, Q)
    assert steady.all()
    K = F[0] @ P @ H[0].T / (H[0] @ P @ H[0].T + 1)
    np.testing.assert_allclose(F[0] @ P @ (F[0] - K @ H[0]).T + Q[0], P, rtol=1e-9, atol=1e-9 * np.abs(P).max())


def test_a_variance_beyond_rounding_has_no_steady_filter_and_leaves_the_others():
    """FAULT of an earlier version: 1 + 1e20 is 1e20, and a singular matrix ended the diagnosis of a ball on a beam."""
    F, Q = np.tile(0.5 * np.eye(2), (2, 1, 1)), np.tile(np.eye(2), (2, 1, 1))
    H = np.array([[[1.0, 0.0]], [[1e10, 1e10]]])
    found, steady = riccati(F, H, Q)
    assert steady.tolist() == [True, False]
    np.testing.assert_allclose(found[0], solve_discrete_are(F[0].T, H[0].T, Q[0], np.eye(1)), rtol=1e-9)


def test_a_filter_that_diverges_is_none_and_leaves_the_others():
    """FAULT: the variance of one hypothesis that lost all digits stopped a diagnosis with a LinAlgError."""
    F, H = np.tile(0.5 * np.eye(2), (3, 1, 1)), np.tile(np.array([[1.0, 1.0]]), (3, 1, 1))
    good = np.diag([3.0, 0.0])
    filters = Filters.of(F, H, np.stack([np.full((2, 2), np.nan), good, -1e3 * np.eye(2)]))
    assert filters.log_det.tolist() == [np.inf, pytest.approx(np.log(4.0)), np.inf]
    np.testing.assert_allclose(filters.gain[1], [[0.5 * 3 / 4], [0.0]])
    assert np.isfinite(filters.P).all()
    assert np.isfinite(filters.gain).all()


def test_a_variance_that_rounding_spoils_is_that_of_no_filter():
    """FAULT: its eigenvalues looked positive, but it has no Cholesky factor, and a diagnosis of a generator stopped."""
    large = np.array([-77419083.4263313, -441149794.4708472, -815633915.1930069])
    one = np.eye(3)
    filters = Filters.of(np.stack([one, one]), np.stack([one, one]), np.stack([np.outer(large, large), one]))
    assert filters.log_det.tolist() == [np.inf, pytest.approx(3 * np.log(2.0))]
    np.testing.assert_allclose(filters.gain[1], one / 2)
