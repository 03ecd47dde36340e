"""Pulses that are stamped late by the same time in all runs: that time is marginalised, and turns what is predicted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.identification.harmonic.estimate import Search, estimate
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.signals.covariance import real_vector
from rotorsim.signals.harmonic_fit import HarmonicFit
from tests.identification import recorded
from tests.identification.test_likelihood import at, likelihood_of, two_gains, with_noise
from tests.reference.recordings import LOWER

STAMP, DELAY = 5e-4, 4e-4  # s


def late(clean, seed: int, delay: float, stamp: float, model: str = "jeffcott", diagram=None) -> Likelihood:
    """Return the likelihood of runs whose pulses come late by a delay, and are said to by a standard deviation."""
    noisy = recorded([with_noise(run, 0.01, (7, seed, k), "white") for k, run in enumerate(clean)])
    runs = tuple(replace(run, tacho=run.tacho + delay) for run in noisy.runs)
    found = likelihood_of(model, replace(noisy, runs=runs), diagram).experiment
    told = [replace(item, fit=_stamped(item.fit, stamp)) for item in found.runs]
    return type(likelihood_of(model, noisy, diagram))(found.again(told))


def _stamped(fit: HarmonicFit, stamp: float) -> HarmonicFit:
    return replace(fit, stamp=stamp, angle_std=float(np.hypot(fit.angle_std, fit.speed * stamp)))


@pytest.fixture(scope="module")
def clean():
    return two_gains("jeffcott", LOWER["jeffcott"][::4])


def test_a_common_delay_is_one_number_that_all_runs_share(clean):
    """|r|^2 = e^T (I + g g^T)^-1 e and the same of slopes, g = s dy/dtau; `apart` gives e back."""
    likelihood = late(clean, 0, DELAY, STAMP)
    theta = at(likelihood)
    found = likelihood.evaluate(theta)
    e, J = found.apart()
    g = np.concatenate(likelihood.late)
    np.testing.assert_allclose(found.late, g, atol=1e-4)  # but for the means, which slow states take a share of
    inverse = np.linalg.inv(np.eye(len(g)) + np.outer(g, g))
    assert found.residual @ found.residual == pytest.approx(e @ inverse @ e, rel=1e-6)
    np.testing.assert_allclose(found.jacobian.T @ found.residual, J.T @ inverse @ e, rtol=1e-5, atol=1e-3)
    response = likelihood.response(theta)
    rows = [real_vector(Y) for Y in response.outputs(response.states())]
    own = [likelihood.data_rows[r] - white.apply(rows[r]) for r, white in enumerate(likelihood.whiteners)]
    harmonics = np.tile(likelihood.keep >= likelihood.c, len(rows))
    np.testing.assert_allclose(e[harmonics], np.concatenate(own)[harmonics], atol=0.01)  # standard deviations


@pytest.mark.slow
def test_a_delay_is_followed_and_turns_what_is_predicted(clean):
    """0.4 ms at up to 27 Hz: 1X is off by up to 3.9 deg; turned back, by the noise of harmonics alone."""
    for stamp, follows in ((STAMP, True), (0.0, False)):
        likelihood = late(clean, 1, DELAY, stamp)
        found = likelihood.evaluate(at(likelihood))
        count = likelihood.c
        turned = np.angle(found.Y[:, 1, :count] / likelihood.data[:, 1, :count])
        expected = -DELAY * np.array([item.fit.speed for item in likelihood.experiment.runs])
        close = np.abs(turned if follows else turned - expected[:, None]).max()
        assert close < 0.1 * np.abs(expected).max()
        assert bool(found.misfit.sum() < chi2.isf(1e-4, found.rows)) is follows


@pytest.mark.slow
def test_parameters_err_as_much_as_a_delay_makes_them(clean):
    """Chi-squared of the errors of all parameters over places of the stamp in its period, angles included."""
    draws, square, count = 30, 0.0, 0
    for seed in range(draws):
        delay = STAMP * np.sqrt(1.5) * (seed % 3 - 1)  # at the end of the period, its middle or its start
        likelihood = late(clean, seed, delay, STAMP)
        found = estimate(Search(likelihood), at(likelihood))
        off = found.theta - at(likelihood)
        square += float(off @ np.linalg.solve(found.covariance, off))
        count += len(off)
        assert found.goodness > 1e-3 / draws
    assert chi2.ppf(1e-4, count) < square < chi2.isf(1e-4, count)
