"""The next experiment: how far apart a run puts two explanations, and that the run named does what is said of it."""

import re

import numpy as np
import pytest

from rotorsim.diagnosis.conclude.wording import _quantity
from rotorsim.diagnosis.diagnosis import Diagnosis, diagnose
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.harmonic.evidence import HarmonicEvidence
from rotorsim.diagnosis.evidence.harmonic.separation import _Predicted, _predicted, _separated, _speeds
from rotorsim.signals.harmonics import harmonics_of
from tests.diagnosis.test_diagnosis import RPM, recording
from tests.identification import TRUTH, shipped
from tests.reference.recordings import THESIS_GAINS

BOWS = ("residual_bow", "runout")
CLOSE = (1500 * RPM, 1800 * RPM)


def test_separation_without_unknowns_is_the_distance():
    a, b = (_Predicted(y, np.zeros((3, 0))) for y in (np.array([3.0, 4.0, 0.0]), np.zeros(3)))
    found = _separated("a run", a, b)
    assert found is not None
    assert (found.separation, found.runs) == (pytest.approx(5.0), 1)


def test_what_the_parameters_imitate_does_not_count():
    """Along the scatter s of a parameter S_n = d / sqrt(1 / n + s^2), across it sqrt(n) d."""
    y, scatter = np.array([6.0, 0.0]), np.array([[2.0], [0.0]])
    along = _separated("a run", _Predicted(y, scatter), _Predicted(np.zeros(2), np.zeros((2, 0))))
    assert along is not None
    assert along.separation == pytest.approx(6 / np.sqrt(1 + 2**2))
    assert along.runs == 0  # 6 / 2 is never exceeded, and odds of e^5 = 148 need sqrt(10) = 3.16
    across = _separated("a run", _Predicted(y[::-1] / 3, scatter), _Predicted(np.zeros(2), scatter))
    assert across is not None
    assert across.runs == 3  # 2 sqrt(2) < sqrt(10) < 2 sqrt(3)
    assert across.separation == pytest.approx(np.sqrt(3) * 2)


@pytest.mark.parametrize(
    ("distance", "scatter", "runs"),
    [
        (3.17, 0.0, 1),  # sqrt(10) = 3.162
        (3.15, 0.0, 2),
        (0.80, 0.0, 16),  # sixteen runs: four times as far
        (0.78, 0.0, None),
        (1.45, 1.0, 0),  # 1.45 / sqrt(1 + 1) is more than one standard deviation, though never enough
        (1.38, 1.0, None),
    ],
)
def test_a_run_is_named_that_tells_odds_of_148_or_at_least_something(distance, scatter, runs):
    found = _separated(
        "a run", _Predicted(np.array([distance]), np.array([[scatter]])), _Predicted(np.zeros(1), np.zeros((1, 0)))
    )
    assert (None if found is None else found.runs) == runs


def test_no_run_is_named_whose_signals_go_twice_as_far_as_any_on_record(monkeypatch):
    """At a speed that no run has passed yet; runs on record are not asked to be smaller than themselves."""
    data = recording(False, [900 * RPM, 1800 * RPM], all_gains=(THESIS_GAINS,))
    slow, fast = harmonics_of(data, data.runs)
    diagram = shipped("jeffcott")
    theta = np.array([TRUTH[item.name] for item in diagram.free])
    fit = Fit(diagram.document, diagram.free, theta, np.eye(len(theta)) * 1e-18)
    sizes = {c.name: np.sqrt(2) * np.std(fast.run.values[key]) for key, c in data.channels.items()}
    for times, proposed in ((1.9, True), (2.1, False), (9.0, False)):
        monkeypatch.setattr(
            HarmonicEvidence, "largest", lambda self, times=times: {k: v / times for k, v in sizes.items()}
        )
        passed, asked = _predicted(fit, HarmonicEvidence(data, (slow, fast)), (slow, fast))
        assert passed is not None
        assert (asked is not None) is proposed


def test_speeds_are_round_and_between_below_and_above_those_on_record():
    found = np.array(_speeds(np.array([898.3, 1207.9, 1210.0, 3303.1]) * RPM)) / RPM
    np.testing.assert_allclose(found, [90, 220, 450, 1000, 2000, 4100])


def found_with(*speeds: float) -> Diagnosis:
    return diagnose(shipped("jeffcott"), recording(True, speeds, all_gains=(THESIS_GAINS,)), physics=BOWS, workers=1)


@pytest.mark.slow
def test_the_run_named_tells_bow_from_runout():
    """With that run recorded too, of the two only the bow is left; the gains of the bearing say nothing of either."""
    found = found_with(*CLOSE)
    assert set(found.effects[0].members) == set(BOWS)
    named = re.fullmatch(
        r"to separate \w+ from \w+: a run at (\d+) rpm \(predictions ([\d.e+]+) standard deviations apart\)",
        found.next_experiment,
    )
    assert named is not None, found.next_experiment
    assert float(named[1]) < 1500
    assert float(named[2]) > 3.16
    assert "which the data do not separate: " in found.statement
    assert "residual_bow at rotor.force" in found.statement
    assert "runout at rotor.displacement" in found.statement
    after = found_with(float(named[1]) * RPM, *CLOSE)
    assert set(after.effects[0].members) == {"residual_bow"}
    assert after.next_experiment == "none is needed: one hypothesis is left"


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (5.99967e-6, 6.6e-10, "m", "5.99967 +- 0.00066 um"),
        (400050.0, 51.0, "N/m", "400.050 +- 0.051 kN/m"),
        (2.1, 0.0012, "rad", "120.321 +- 0.069 deg"),
        (-3e-3, 0.02, "kg", "-0.003 +- 0.020 kg"),
        (12345.0, 678.0, "1", "12340 +- 680"),
        (0.15, 0.0, "1", "0.15"),
        (1.0, np.inf, "m", "1 m, not determined"),
        (0.5, 4.0, "rad", "28.6479 deg, not determined"),
    ],
)
def test_values_stand_beside_their_deviation_in_one_unit(value: float, std: float, unit: str, text: str):
    assert _quantity(value, std, unit) == text
