"""Harmonics together with how 1X drifts within the runs: predictions, derivatives, and rows without a drift."""

import numpy as np
import pytest

from rotorsim.identification.drifting import DriftingLikelihood
from rotorsim.settled.nonlinear import _decay
from tests.diagnosis.test_nothing import bow, source
from tests.identification import shipped

T = 0.4995
NODES, WEIGHTS = np.polynomial.legendre.leggauss(80)
LEGENDRE = {0: np.ones_like(NODES), 1: NODES, 2: 1.5 * NODES**2 - 0.5}


@pytest.mark.parametrize("u", [1e-6, 9.9e-4, 1.01e-3, 0.1, 1.0, 7.0, 80.0, -2.0])
@pytest.mark.parametrize("n", [0, 1, 2])
def test_the_course_of_a_state_in_legendre_polynomials(n, u):
    found, slope = _decay(u, n)
    decay = (1 + NODES) / 2
    integral = (2 * n + 1) / 2 * (WEIGHTS * LEGENDRE[n])
    one = float(n == 0)  # the mean of what decays is 1 / u beside that of what has decayed
    assert found == pytest.approx(integral @ np.expm1(-u * decay) / u + one / u, rel=1e-6)
    exact = integral @ (-decay * np.exp(-u * decay) / u - np.expm1(-u * decay) / u**2) - one / u**2
    assert slope == pytest.approx(exact, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("time_constant", [0.02, 0.05, 0.4, 10.0])
def test_1x_answers_to_what_decays_at_its_own_frequency(time_constant):
    """H(i W - a) of the rotor in its bearing, by its matrices, for H(i W): 1X lags behind a bow that grows."""
    plain, _ = bow(2e-6, time_constant)
    experiment = plain.experiment
    likelihood = DriftingLikelihood(experiment)
    prediction = experiment.motion.predict(experiment.theta0, [np.zeros(known.count) for known in fresh(experiment)])
    course = likelihood._course(experiment.theta0, prediction)
    base = source("jeffcott").load(shipped("jeffcott").document)
    loop = source("jeffcott").open(base, inject=["rotor.force"])
    linear = loop.linear.response(loop.theta0)
    force = 7.6e5 * 2e-6 * np.exp(0.7j) / 2 * np.array([1.0, -1j])  # of x and y at 1X
    decay = (1 + NODES) / 2
    for r, item in enumerate(experiment.runs):

        def answer(s, r=r):
            A, B, C, D = (getattr(linear, key)[r] for key in "ABCD")
            return (C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D) @ force

        s = 1j * item.fit.speed
        decays = -np.exp(-T * decay / time_constant)
        mean = WEIGHTS @ decays / 2 * (answer(s - 1 / time_constant) - answer(s))
        np.testing.assert_allclose(course.values[r, 0], mean, rtol=1e-6, atol=1e-16)
        for n in (1, 2):
            size = (2 * n + 1) / 2 * float(WEIGHTS @ (LEGENDRE[n] * decays))
            np.testing.assert_allclose(course.values[r, n], size * answer(s - 1 / time_constant), rtol=1e-6, atol=1e-16)


def fresh(experiment):
    return experiment.motion.fresh_means(experiment.theta0)


def test_derivatives_are_those_of_differences_and_rows_stand_behind_those_of_each_run():
    plain, places = bow(2e-6, 0.4)
    likelihood = DriftingLikelihood(plain.experiment)
    theta = plain.experiment.theta0
    found, harmonics = likelihood.evaluate(theta), plain.evaluate(theta)
    assert [more - size for more, size in zip(likelihood.sizes, plain.sizes, strict=True)] == [4 * plain.c] * 2
    assert found.rows == harmonics.rows + 2 * (4 * plain.c - 2)  # an angle that is loose takes two of them
    first = found.residual[: likelihood.sizes[0]][: plain.sizes[0]]
    assert np.linalg.norm(first - harmonics.residual[: plain.sizes[0]]) < 0.2 * np.linalg.norm(first)  # but for the lag
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
