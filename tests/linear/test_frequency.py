"""Frequency response against closed forms."""

import json
import math

import numpy as np
import pytest
from scipy.linalg import lu_factor, lu_solve

from rotorsim.errors import RotorsimError
from rotorsim.linear.control.frequency import frequency_response
from rotorsim.linear.control.margins import margins
from rotorsim.linear.linearisation import linearise
from rotorsim.linear.state_space import MANY, frequencies_near
from rotorsim.model.load import load
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


def test_peaks_are_those_of_the_closed_form_whatever_frequencies_are_asked_for():
    found = frequency_response(load("jeffcott"), "unbalance.force", "rotor.displacement", frequencies=[1.0, 2000.0])
    [peak, _] = found.peaks
    m, c, k = 2.0, 76.0 + 42.1 * 3.0, 7.6e5 - 105210 + 42.1 * 12200
    hz = np.linspace(115, 125, 1_000_001)
    s = 2j * math.pi * hz
    size = np.abs(1 / (m * s**2 + c * s + k + 42.1 * 2000.0 / s))
    assert (peak.output, peak.input) == ("rotor.displacement[1]", "unbalance.force[1]")
    assert peak.frequency == pytest.approx(hz[np.argmax(size)], abs=2e-5)
    assert abs(peak.value) == pytest.approx(size.max(), rel=1e-9)
    assert frequency_response(load("jeffcott"), "unbalance.force", "rotor.displacement", span=(200, 300)).peaks == ()


def test_a_narrow_peak_of_a_flexible_mode_is_not_passed_over():
    found = frequency_response(load("fe_flexible"), "amb.force", "rotor.displacement[3]", span=(1.0, 2000.0))
    poles = linearise(load("fe_flexible")).poles()
    narrow = poles[(poles.imag > 0) & (-poles.real < 0.01 * poles.imag) & (poles.imag < 4000 * math.pi)]
    places = np.array([peak.frequency for peak in found.peaks])
    assert len(narrow)
    assert all(np.abs(places / (pole.imag / 2 / math.pi) - 1).min() < 0.02 for pole in narrow)


@pytest.mark.slow
def test_sampled_blocks_are_treated_exactly():
    """The response of the controller's output to what is added to it is S - 1."""
    document = json.loads(json.dumps(load("jeffcott").document))
    document["blocks"]["controller"] = {"type": "discrete_pid"}
    hz = np.array([5.0, 120.0, 900.0])
    found = frequency_response(load(document), "controller.current", "controller.current", frequencies=hz)
    truth = margins(load(document), "controller.current", frequencies=hz)
    np.testing.assert_allclose(np.eye(2) + found.value, truth.sensitivity, rtol=1e-12, atol=1e-15)
    assert found.stable


@pytest.mark.slow
def test_many_frequencies_of_a_beam_are_exact_to_1e10_from_the_slowest_to_the_fastest_pole():
    system = linearise(load("drawn_rotor"), inputs=("controller_a.current",), outputs=("rotor.displacement",))
    hz = np.geomspace(0.01, 2e6, MANY)
    s, n = 2j * math.pi * hz, len(system.A)
    found = system.response(hz)
    for k in range(0, MANY, 3):  # Gaussian elimination, refined in extended precision
        M = (s[k] * np.eye(n) - system.A).astype(np.clongdouble)
        factors = lu_factor(M.astype(complex))
        X = lu_solve(factors, system.B).astype(np.clongdouble)
        for _ in range(10):
            X += lu_solve(factors, (system.B - M @ X).astype(complex))
        exact = (system.C @ X + system.D).astype(complex)
        assert np.abs(found[k] - exact).max() < 1e-10 * np.abs(exact).max()


def test_poles_that_are_one_but_for_a_hundredth_of_their_width_are_not_looked_at_twice():
    pole = complex(-3.0, 400.0)
    alone = frequencies_near(np.array([pole, pole.conjugate()]), 1.0, 1000.0)
    again = frequencies_near(np.array([pole, pole + 0.02, pole.conjugate(), pole + 0.02j]), 1.0, 1000.0)
    np.testing.assert_array_equal(alone, again)
    assert len(frequencies_near(np.array([pole, pole + 0.04j]), 1.0, 1000.0)) == len(alone) + 13
