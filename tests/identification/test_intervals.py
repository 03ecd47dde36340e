"""Every 90 % interval reaches 1.644854 standard deviations to either side; and errors are those of signals in time."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.diagnosis.evidence.fit import Fit, is_adequate
from rotorsim.identification import advice, identification
from rotorsim.identification.advice import advise
from rotorsim.identification.harmonic.estimate import Estimate, Search
from rotorsim.identification.harmonic.profile import profile_intervals
from rotorsim.identification.identification import _about, _scores
from rotorsim.identification.study.runs import Bench
from rotorsim.identification.study.study import StudyResult
from rotorsim.identification.verdict import judge
from tests.identification.test_bounds import Straight

Z = 1.644853627
FREE = (-np.inf, np.inf)


def straight(J: np.ndarray, best: list[float]) -> tuple[Search, Estimate]:
    """Return the search of J theta = J best, without bounds, and its estimate."""
    many = len(best)
    simple = Straight(J, J @ best, np.ones(many), np.full(many, -np.inf), np.full(many, np.inf))
    search = object.__new__(Search)
    search.coordinates, search.residual, search.jacobian = simple.coordinates, simple.residual, simple.jacobian
    return search, simple.found(np.array(best))


@pytest.mark.parametrize("widen", [1.0, 2.0])
def test_profiles_of_a_normal_distribution_end_at_its_90_percent(widen):
    """Standard deviations of two parameters with correlation -0.8: sqrt(1 / 0.36)."""
    search, found = straight(np.linalg.cholesky(np.array([[1.0, 0.8], [0.8, 1.0]])).T, [2.0, 3.0])
    half = widen * Z / 0.6
    expected = [[2 - half, 2 + half], [3 - half, 3 + half]]
    np.testing.assert_allclose(profile_intervals(search, found, widen), expected, rtol=1e-5)


def test_intervals_of_the_regression_hold_the_unbiased_value_too():
    result = SimpleNamespace(theta=np.array([5.0, 5.0, 5.0]))
    found = _about(result, np.array([1.0, 1.0, 2.0]), np.array([0.0, 0.5, -0.5]))
    expected = [[5 - Z, 5 + Z], [4.5 - Z, 5 + Z], [5 - 2 * Z, 5.5 + 2 * Z]]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_intervals_of_a_study_are_widened_by_what_the_noise_does_not_explain():
    _, found = straight(np.array([[2.0]]), [3.0])
    for misfit, times in ((15.1, 1.0), (15.2, np.sqrt(15.2))):  # chi-squared of one, 0.0001: 15.14
        some = Estimate(found.free, found.theta, found.coordinates, None, found.information, found.at_bound, misfit, 1)
        assert some.adequate == (times == 1.0)
        intervals, _ = Bench._judged(SimpleNamespace(profile=False), None, some)
        np.testing.assert_allclose(intervals, [[3 - times * Z / 2, 3 + times * Z / 2]], rtol=1e-6)


def test_a_coverage_of_100_seeds_is_known_to_five_percent():
    """sqrt(0.9 0.1 / 100) = 0.03."""
    result = SimpleNamespace(study=SimpleNamespace(seeds=100))
    assert StudyResult.coverage_tolerance.fget(result) == pytest.approx(0.03 * Z, rel=1e-6)


@pytest.mark.parametrize(("half", "identified"), [(0.0999, True), (0.1001, False)])
def test_five_percent_of_the_value_is_identified(half, identified):
    _, found = straight(np.array([[1.0]]), [2.0])
    [verdict] = judge(found, np.array([[2 - half, 2 + half]]))
    assert verdict.identifiable is identified


def test_a_verdict_says_what_would_be_known_if_all_others_were():
    """Correlation -0.8, std 1 / 0.6; with the other known std 1: 1.644854 of 2."""
    _, found = straight(np.linalg.cholesky(np.array([[1.0, 0.8], [0.8, 1.0]])).T, [2.0, 2.0])
    verdict = judge(found, np.array([[1.0, 3.0], [1.0, 3.0]]))[0]
    assert verdict.reason == (
        "the data say too little about it: its 90 % interval is +-50 %, and would be +-82 % if all other parameters "
        "were known"
    )


@pytest.mark.parametrize(
    ("correlation", "words"), [(0.942, "the data say too little"), (0.944, "cannot be told from p1")]
)
def test_partners_are_named_where_knowing_them_leaves_a_third_of_the_interval(correlation, words):
    """sqrt(1 - rho^2) = 1/3 at rho = 0.9428."""
    _, found = straight(np.linalg.cholesky(np.array([[1.0, correlation], [correlation, 1.0]])).T, [2.0, 2.0])
    half = Z / np.sqrt(1 - correlation**2)
    assert judge(found, np.array([[2 - half, 2 + half]] * 2))[0].reason.startswith(words)


def test_a_combination_is_given_with_its_90_percent():
    """p0 + p1 is known to 1, p0 - p1 to 0.01: with p1 known p0 is, to 1 / sqrt(1 + 1e4)."""
    J = np.array([[1.0, 1.0], [100.0, -100.0]])
    _, found = straight(J, [2.0, 2.0])
    verdict = judge(found, np.array([[1.0, 3.0], [1.0, 3.0]]))[0]
    assert verdict.combination.std == pytest.approx(1 / np.sqrt(1 + 1e4))
    assert verdict.reason.endswith(" +- 0.016 m")  # 1.644854 of it


@pytest.mark.parametrize(("std", "told"), [(0.0303, True), (0.0305, False)])
def test_an_experiment_is_advised_that_makes_the_interval_five_percent(monkeypatch, std, told):
    """0.05 / 1.644854 = 0.030398 of the value."""
    _, found = straight(np.array([[1e-6]]), [1.0])
    monkeypatch.setattr(advice, "_candidates", lambda *_: [("more", np.array([[std**-2]]))])
    assert bool(advise(SimpleNamespace(given=()), found, ["p0"], 0.05)) is told


def test_the_error_of_an_identification_is_that_of_the_signal_in_time(monkeypatch):
    """A signal with mean, 1X, 3X and noise between them, beside a model of other harmonics; a mean that is not used."""
    theta = np.arange(2048) * 2 * np.pi * 4 / 2048
    wave = np.exp(1j * np.outer(theta, np.arange(4)))
    data, model = np.array([0.3, 1 - 2j, 0, 0.4j]), np.array([0.1, 1.2 - 2j, 0.1, 0.1j])

    def signal(values: np.ndarray) -> np.ndarray:
        return np.asarray((wave * np.where(np.arange(4) == 0, 1, 2) * values).real.sum(axis=1))

    measured = signal(data) + 0.07 * np.sqrt(2) * np.cos(1.25 * theta)
    error = measured - signal(model)
    rms = float(np.std(measured))
    run = SimpleNamespace(run=None, fit=SimpleNamespace(residual=np.full(2, 0.07), rms=np.full(2, rms)))
    scored = SimpleNamespace(
        predicted=("rotor.displacement[1]", "coil.current"), columns=[np.arange(2)], use_mean=np.array([True, False])
    )
    likelihood = SimpleNamespace(
        data=np.repeat(data[None, :, None], 2, axis=2),
        evaluate=lambda theta: SimpleNamespace(Y=np.repeat(model[None, :, None], 2, axis=2)),
    )
    monkeypatch.setattr(identification, "open_experiment", lambda *_, **named: scored)
    monkeypatch.setattr(identification, "Likelihood", lambda experiment: likelihood)
    recording = SimpleNamespace(select=lambda use: ())
    fit, floor = _scores(None, recording, [run], None, SimpleNamespace(free=(), theta=None), ())
    wanted = {"rotor.displacement": np.sqrt(np.mean(error**2)) / rms, "coil.current": np.std(error) / rms}
    assert fit == {"identify": {name: pytest.approx(value, rel=1e-12) for name, value in wanted.items()}}
    assert floor == {name: pytest.approx(0.07 / rms, rel=1e-12) for name in wanted}


@pytest.mark.parametrize(("probability", "adequate"), [(1.1e-4, True), (0.9e-4, False)])
def test_a_model_explains_the_data_with_a_probability_of_one_in_ten_thousand_as_in_a_diagnosis(probability, adequate):
    misfit = float(chi2.isf(probability, 200))
    found = Estimate((), np.zeros(0), None, None, np.zeros((0, 0)), np.zeros(0, bool), misfit, 200)
    assert found.adequate == adequate
    assert found.widening == pytest.approx(1.0 if adequate else np.sqrt(misfit / 200))
    assert is_adequate(Fit({}, misfit=misfit, rows=200, goodness=found.goodness)) == adequate
