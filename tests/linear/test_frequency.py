"""Frequency response against closed forms."""

import math

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.linear.frequency import frequency_response
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


def test_frequencies_must_be_finite():
    with pytest.raises(RotorsimError, match=r"frequencies must be finite \[Hz\]"):
        frequency_response(
            jeffcott(external="inject"), "controller.current", "rotor.displacement", frequencies=[float("inf")]
        )
