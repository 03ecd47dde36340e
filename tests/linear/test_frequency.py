"""Frequency response and sensitivity against closed forms."""

import math

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.linear.frequency import frequency_response, sensitivity, zone_of
from tests.reference.handmade import jeffcott


def loop(hz, kp=12200.0, ki=2000.0, kd=3.0):
    """Return the gain once round the loop, L = -PID(s) k_i / (m s^2 + c s + k - k_s)."""
    s = 2j * math.pi * hz
    return -(kp + ki / s + kd * s) * 42.1 / (2 * s**2 + 76 * s + 7.6e5 - 105210)


def test_closed_loop_response_has_labels_and_units():
    hz = np.array([3.0, 60.0, 122.0])
    found = frequency_response(jeffcott(external="inject"), "controller.current", "rotor.displacement", frequencies=hz)
    s = 2j * math.pi * hz
    plant = -42.1 / (2 * s**2 + 76 * s + 7.6e5 - 105210)
    np.testing.assert_allclose(found.value[:, 1, 1], plant / (1 - loop(hz)), rtol=1e-11)
    assert found.units == (("m/A", "m/A"), ("m/A", "m/A"))
    assert found.outputs == ("rotor.displacement[1]", "rotor.displacement[2]")
    assert found.stable


def test_sensitivity_is_one_over_one_minus_loop_gain():
    hz = np.geomspace(1, 1000, 50)
    found = sensitivity(jeffcott(external="inject"), frequencies=hz)
    np.testing.assert_allclose(found.axes[:, 0], np.abs(1 / (1 - loop(hz))), rtol=1e-10)
    np.testing.assert_allclose(found.singular, found.axes[:, 0], rtol=1e-10)


def test_peak_sensitivity_is_found_between_grid_points():
    found = sensitivity(jeffcott(external="inject"))
    fine = np.linspace(100, 140, 400001)
    values = np.abs(1 / (1 - loop(fine)))
    assert found.peak == pytest.approx(values.max(), rel=1e-8)
    assert found.peak_frequency == pytest.approx(fine[np.argmax(values)], abs=1e-3)
    assert found.zone == zone_of(values.max())
    assert found.statement.endswith("(ISO 14839-3:2006)")


def test_unstable_loop_is_zone_d_and_says_so():
    found = sensitivity(jeffcott(external="inject"), parameters={"controller.KD": -10.0})
    assert not found.stable
    assert found.zone == "D"
    assert found.statement == (
        "the closed loop is unstable: a sensitivity cannot be measured, zone D (ISO 14839-3:2006)"
    )


@pytest.mark.parametrize(
    ("peak", "zone"), [(1.0, "A"), (2.999, "A"), (3.0, "B"), (3.999, "B"), (4.0, "C"), (4.99, "C"), (5.0, "D")]
)
def test_zones(peak, zone):
    assert zone_of(peak) == zone


def test_unknown_controller_has_a_near_miss():
    with pytest.raises(RotorsimError) as caught:
        sensitivity(jeffcott(external="inject"), "controler")
    assert str(caught.value) == "error: controler: no such block\n\nhint: did you mean 'controller'?"


def test_frequencies_must_be_finite():
    with pytest.raises(RotorsimError, match=r"frequencies must be finite \[Hz\]"):
        frequency_response(
            jeffcott(external="inject"), "controller.current", "rotor.displacement", frequencies=[float("inf")]
        )
