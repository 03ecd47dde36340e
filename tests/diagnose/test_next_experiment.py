"""The next experiment: how far apart a run puts two explanations, and that the run named does what is said of it."""

import re

import numpy as np
import pytest

from rotorsim.diagnose.diagnosis import Diagnosis, diagnose
from rotorsim.diagnose.next_experiment import MOST_ALIKE, SEEN, _Predicted, _separated, _speeds
from rotorsim.diagnose.wording import _quantity
from tests.diagnose.test_diagnosis import RPM, recording
from tests.identify import shipped
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
    assert along.runs == 0  # 6 / 2 is never reached, and is less than SEEN
    assert SEEN > 6 / 2
    across = _separated("a run", _Predicted(y[::-1] / 3, scatter), _Predicted(np.zeros(2), scatter))
    assert across is not None
    assert across.runs == int(np.floor((SEEN / 2) ** 2)) + 1
    assert across.separation == pytest.approx(np.sqrt(across.runs) * 2)


def test_runs_that_tell_nothing_are_not_named():
    y = np.full(2, 0.5 / MOST_ALIKE)
    assert _separated("a run", _Predicted(y, np.zeros((2, 0))), _Predicted(-y, np.zeros((2, 0)))) is None


def test_speeds_are_round_and_between_below_and_above_those_on_record():
    found = np.array(_speeds(np.array([898.3, 1207.9, 1210.0, 3303.1]) * RPM)) / RPM
    np.testing.assert_allclose(found, [90, 220, 450, 1000, 2000, 4100])


def found_with(*speeds: float) -> Diagnosis:
    return diagnose(
        shipped("jeffcott"), recording(True, speeds, all_gains=(THESIS_GAINS,)), physics=BOWS, workers=1
    )  # fmt: skip


@pytest.mark.slow
def test_the_run_named_tells_bow_from_runout():
    """With that run recorded too, of the two only the bow is left; the gains of the bearing say nothing of either."""
    found = found_with(*CLOSE)
    assert set(found.effects[0].members) == set(BOWS)
    named = re.fullmatch(
        r"to tell \w+ from \w+: a run at (\d+) rpm \(predictions ([\d.e+]+) standard deviations apart\)",
        found.next_experiment,
    )
    assert named is not None, found.next_experiment
    assert float(named[1]) < 1500
    assert float(named[2]) > SEEN
    assert "which the data do not tell apart: " in found.statement
    assert "residual_bow at rotor.force" in found.statement
    assert "runout at rotor.displacement" in found.statement
    after = found_with(float(named[1]) * RPM, *CLOSE)
    assert set(after.effects[0].members) == {"residual_bow"}
    assert after.next_experiment == "none is needed: one explanation is left"


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
