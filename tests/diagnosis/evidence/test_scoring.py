"""What runs that took no part say about a fit, by linear theory."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from rotorsim.diagnosis.conclude.shares import share_explained
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.harmonic.evidence import HarmonicEvidence
from rotorsim.diagnosis.evidence.harmonic.scoring import _errors, held_score, standardised, surprise
from rotorsim.diagnosis.evidence.harmonic.separation import _predicted
from rotorsim.signals.harmonics import harmonics_of
from tests.diagnosis.test_diagnosis import RPM, recording
from tests.identification import shipped


def prediction(residual: np.ndarray, slopes: np.ndarray, *stds: float | None) -> SimpleNamespace:
    free = [SimpleNamespace(prior_std=std) for std in stds or [None] * slopes.shape[1]]
    experiment = SimpleNamespace(free=free)
    return SimpleNamespace(evaluation=SimpleNamespace(residual=residual, jacobian=slopes), experiment=experiment)


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


def fitted_runs(residual: np.ndarray, slopes: np.ndarray, sizes: list[int], nuisances: int = 0) -> SimpleNamespace:
    found = prediction(residual, slopes)
    found.likelihood = SimpleNamespace(sizes=sizes)
    found.evaluation.rows = len(residual) - nuisances
    found.experiment.theta0 = np.zeros(slopes.shape[1])
    for item in found.experiment.free:
        item.low, item.high = -np.inf, np.inf
    return found


def test_a_run_left_out_is_judged_as_if_the_others_alone_had_been_fitted():
    """e^T (I + J (S^T S)^-1 J^T)^-1 e of each run, with the fit to the others."""
    random = np.random.default_rng(7)
    sizes = [8, 11, 9]
    J, y = random.standard_normal((28, 4)), random.standard_normal(28)
    residual = J @ np.linalg.lstsq(J, y, rcond=None)[0] - y
    found = standardised(fitted_runs(residual, J, sizes, nuisances=3))
    ends = np.cumsum([0, *sizes])
    for (misfit, rows), first, last in zip(found, ends[:-1], ends[1:], strict=True):
        others = np.r_[0:first, last:28]
        e = J[first:last] @ np.linalg.lstsq(J[others], y[others], rcond=None)[0] - y[first:last]
        spread = np.eye(last - first) + J[first:last] @ np.linalg.inv(J[others].T @ J[others]) @ J[first:last].T
        assert misfit == pytest.approx(e @ np.linalg.solve(spread, e), rel=1e-9)
        assert rows == last - first - 1


def test_what_only_one_run_shows_is_not_predicted_from_the_others():
    J = np.zeros((6, 1))
    J[:2] = 1.0  # the first run alone determines it
    runs = standardised(fitted_runs(np.array([0.5, -0.5, 1.0, 1.0, 2.0, 2.0]), J, [2, 2, 2]))
    np.testing.assert_allclose(runs, [(0.5, 1), (2.0, 2), (8.0, 2)])


def test_the_error_is_that_of_the_signal_in_time():
    """A signal with mean, 1X, 3X and noise between them, beside a model of other harmonics, sampled over turns."""
    theta = np.arange(2048) * 2 * np.pi * 4 / 2048
    wave = np.exp(1j * np.outer(theta, np.arange(4)))
    data, model = np.array([0.3, 1 - 2j, 0, 0.4j]), np.array([0.1, 1.2 - 2j, 0.1, 0.1j])

    def signal(values: np.ndarray) -> np.ndarray:
        return np.asarray((wave * np.where(np.arange(4) == 0, 1, 2) * values).real.sum(axis=1))

    noise = 0.07 * np.sqrt(2) * np.cos(1.25 * theta)
    measured = signal(data) + noise
    rms = np.sqrt(np.mean((measured - measured.mean()) ** 2))
    found = SimpleNamespace(
        experiment=SimpleNamespace(
            predicted=("rotor.displacement[1]",),
            use_mean=np.array([True]),
            columns=np.array([[0]]),
            runs=[SimpleNamespace(fit=SimpleNamespace(residual=np.array([0.07]), rms=np.array([rms])))],
        ),
        evaluation=SimpleNamespace(Y=model[None, :, None]),
        likelihood=SimpleNamespace(data=data[None, :, None]),
    )
    errors, floor = _errors([found])
    error = np.sqrt(np.mean((measured - signal(model)) ** 2))
    assert errors == {"rotor.displacement": pytest.approx(error / rms, rel=1e-12)}
    assert floor == {"rotor.displacement": pytest.approx(0.07 / rms, rel=1e-12)}


def of_runs(*misfits: float, rows: float = 100.0) -> list[tuple[float, float]]:
    return [(value, rows) for value in misfits]


def test_the_share_is_of_what_is_explainable_with_the_scatter_of_runs():
    """Excesses 1000, 3000; left 10, 90: 97.5 %. Without one run each 97 and 99 %: jackknife 1 %, Student 6.31."""
    before, after = of_runs(1100.0, 3100.0), of_runs(110.0, 190.0)
    found = share_explained(before, after)
    assert found.value == pytest.approx(0.975)
    assert found.interval == (pytest.approx(0.975 - 6.3138 * 0.01, rel=1e-4), 1.0)
    some = share_explained(before, after, [(100.0, 100.0), (150.0, 50.0)])  # a free force there leaves 100 of 4000
    assert some.value == pytest.approx(3900 / 3900)
    assert share_explained(of_runs(101.0, 103.0), of_runs(99.0, 99.0)) is None  # there is nothing to explain
    assert share_explained(of_runs(1100.0), of_runs(110.0)).interval is None


def unstable() -> tuple[HarmonicEvidence, dict]:
    """Return runs, and a diagram whose controller drives the rotor instead of damping it."""
    data = recording(False, [900 * RPM, 1800 * RPM])
    diagram = shipped("jeffcott")
    document = {**diagram.document, "blocks": dict(diagram.document["blocks"])}
    controller = dict(document["blocks"]["controller"])
    document["blocks"]["controller"] = {**controller, "parameters": {**controller.get("parameters", {}), "KD": -5.0}}
    runs = tuple(harmonics_of(data, data.runs[:2]))
    return HarmonicEvidence(data, runs), document


def test_a_motion_that_is_not_stable_predicts_nothing_and_is_no_experiment():
    source, document = unstable()
    source = HarmonicEvidence(
        source.recording, tuple(replace(item, run=replace(item.run, settings={})) for item in source.harmonics)
    )
    held = replace(source, harmonics=source.harmonics[:1])
    found = held_score(document, source, [held])
    assert (found.total, found.misfit) == (None, None)
    assert found.reason == "its motion is not stable in run run0"
    free = source.load(document).free
    fit = Fit(document, free, np.array([item.value for item in free]), np.eye(len(free)) * 1e-12, np.zeros(len(free)))
    assert list(_predicted(fit, source, source.harmonics)) == [None, None]
    stable = shipped("jeffcott").document
    assert None not in _predicted(replace(fit, document=stable), source, source.harmonics)
    assert held_score(stable, source, [held]).misfit is not None
