"""Harmonics together with how 1X drifts within the runs: predictions, derivatives, and rows without a drift."""

import numpy as np
import pytest

from rotorsim.identification.drifting import DriftingLikelihood
from rotorsim.settled.nonlinear import _bend
from tests.diagnosis.test_nothing import bow

T = 0.4995
NODES, WEIGHTS = np.polynomial.legendre.leggauss(80)
LEGENDRE = {1: NODES, 2: 1.5 * NODES**2 - 0.5}


@pytest.mark.parametrize("u", [1e-6, 9.9e-4, 1.01e-3, 0.1, 1.0, 7.0, 80.0, -2.0])
@pytest.mark.parametrize("n", [1, 2])
def test_the_course_of_a_state_in_legendre_polynomials(n, u):
    found, slope = _bend(u, n)
    decay = (1 + NODES) / 2
    integral = (2 * n + 1) / 2 * (WEIGHTS * LEGENDRE[n])
    assert found == pytest.approx(integral @ np.expm1(-u * decay) / u, rel=1e-6)
    exact = integral @ (-decay * np.exp(-u * decay) / u - np.expm1(-u * decay) / u**2)
    assert slope == pytest.approx(exact, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("time_constant", [0.05, 0.4, 10.0])
def test_1x_drifts_as_a_bow_that_grows_drives_it(time_constant):
    """Quasi-statically: by what a bow that stays would add, with each coefficient of the growth."""
    grown, _ = bow(2e-6, time_constant)
    likelihood = DriftingLikelihood(grown.experiment)
    theta = grown.experiment.theta0
    drift, _ = likelihood._predicted(theta, grown.evaluated(theta)[1])
    growth = -np.expm1(-T * (1 + NODES) / 2 / time_constant)
    none = bow(1e-15, 1e-5)[0]
    least = none.evaluated(none.experiment.theta0)[1].Y[:, 1]
    for n in (1, 2):
        size = (2 * n + 1) / 2 * float(WEIGHTS @ (LEGENDRE[n] * growth))
        stays, _ = bow(2e-6 * abs(size), 1e-5)
        there = stays.evaluated(stays.experiment.theta0)[1].Y[:, 1]
        np.testing.assert_allclose(drift[:, n - 1], np.sign(size) * (there - least), rtol=1e-3, atol=1e-14)


def test_derivatives_are_those_of_differences_and_rows_stand_behind_those_of_each_run():
    plain, places = bow(2e-6, 0.4)
    likelihood = DriftingLikelihood(plain.experiment)
    theta = plain.experiment.theta0
    found, harmonics = likelihood.evaluate(theta), plain.evaluate(theta)
    assert [more - size for more, size in zip(likelihood.sizes, plain.sizes, strict=True)] == [4 * plain.c] * 2
    assert found.rows == harmonics.rows + 2 * (4 * plain.c - 2)  # an angle that is loose takes two of them
    first = found.residual[: likelihood.sizes[0]][: plain.sizes[0]]
    np.testing.assert_array_equal(first, harmonics.residual[: plain.sizes[0]])
    for j in places:
        step = 1e-5 * theta[j] * (np.arange(len(theta)) == j)
        slope = likelihood.evaluate(theta + step).residual - likelihood.evaluate(theta - step).residual
        near = found.jacobian[:, j] * 2 * step[j]
        assert np.linalg.norm(slope - near) < 1e-3 * np.linalg.norm(slope)


def test_a_machine_in_which_nothing_grows_has_no_drift():
    plain, _ = bow(2e-6, 0.4)
    likelihood = DriftingLikelihood(plain.experiment)
    theta = plain.experiment.theta0.copy()
    theta[[item.name.endswith(".growth") for item in plain.experiment.free].index(True)] = 1e-15
    found = likelihood.evaluate(theta)
    drift = found.misfit - plain.evaluate(theta).misfit
    assert (drift < 2 * (4 * plain.c - 2)).all()  # noise alone: chi-squared
