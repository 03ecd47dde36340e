"""Margins of bearing loops against closed forms; sampled loops against the z-transform of a first-order plant."""

import math

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.linear.frequency import sensitivity
from rotorsim.linear.held import HeldSystem, common_period
from rotorsim.linear.margins import margins
from rotorsim.linear.state_space import StateSpace
from rotorsim.model.load import load
from rotorsim.report.figures.linear import margins_figure


def loop(hz, kp=12200.0, ki=2000.0, kd=3.0):
    """Return G_o = PID(s) k_i / (m s^2 + c s + k - k_s)."""
    s = 2j * math.pi * hz
    return (kp + ki / s + kd * s) * 42.1 / (2 * s**2 + 76 * s + 7.6e5 - 105210)


@pytest.mark.parametrize("at", ["controller.displacement", "controller.current"])
def test_open_loop_sensitivity_and_closed_loop_of_a_rotor_with_one_disc(at):
    """The loops of both axes are alike and apart, so that sensor and current show the same."""
    hz = np.geomspace(1, 1000, 50)
    found = margins(load("jeffcott"), at, frequencies=hz)
    np.testing.assert_allclose(found.sensitivity[:, 0, 0], 1 / (1 + loop(hz)), rtol=1e-9)
    np.testing.assert_allclose(found.open_loop()[:, 1], loop(hz), rtol=1e-8)
    np.testing.assert_allclose(found.closed_loop()[:, 0, 0], loop(hz) / (1 + loop(hz)), rtol=1e-8)
    np.testing.assert_allclose(found.open_loop_matrix()[:, 0, 0], loop(hz), rtol=1e-8)


def test_phase_and_delay_margin_are_those_of_the_closed_form():
    axis = margins(load("jeffcott")).axes[0]
    fine = np.linspace(100, 140, 400001)
    k = np.argmin(np.abs(np.abs(loop(fine)) - 1))
    phase = 180 + np.degrees(np.angle(loop(fine[k])))
    assert axis.phase == pytest.approx(phase, abs=1e-3)
    assert axis.delay == pytest.approx(phase / 360 / fine[k], rel=1e-4)
    assert (axis.gain_up, axis.gain_down) == (np.inf, 0.0)  # the plant carries itself: 7.6e5 > 105210 N/m
    assert axis.name == "controller.displacement[1]"


def test_peak_and_zone_are_those_at_the_controllers_output():
    diagram = load("two_amb_rotor")
    for k in "ab":
        found, known = margins(diagram, f"controller_{k}.current"), sensitivity(diagram, f"controller_{k}")
        assert found.peak == pytest.approx(known.peak, rel=1e-9)
        assert found.zone == known.zone
    assert [axis.name[:14] for axis in margins(diagram).axes] == ["controller_a.d"] * 2 + ["controller_b.d"] * 2


def test_an_unstable_loop_is_zone_d_without_margins():
    found = margins(load("jeffcott"), parameters={"controller.KD": -10.0})
    assert found.zone == "D"
    assert np.isnan(found.axes[0].phase)
    assert found.statement == "the closed loop is unstable: a sensitivity cannot be measured, zone D (ISO 14839-3:2006)"


def held(gain: float, a: float = 3.0, T: float = 0.1) -> HeldSystem:
    """Return y' = -a y + u, u = -gain (y + e) sampled every T; s = [y, u], outputs [y]."""
    flow = StateSpace(np.array([[-a, 1.0], [0, 0]]), np.zeros((2, 1)), np.array([[1.0, 0]]), np.zeros((1, 1)))
    jump = np.array([[1.0, 0], [-gain, 0]]), np.array([[0.0], [-gain]])
    return HeldSystem(flow, (0.0,), (jump,), T)


def test_a_sampled_loop_has_the_response_of_the_z_transform():
    a, T, gain, hz = 3.0, 0.1, 5.0, np.array([0.3, 2.0, 4.9, 7.0, 31.0])
    s = 2j * np.pi * hz
    z, phi = np.exp(s * T), math.exp(-a * T)
    step = (1 - phi) / a
    sampled = -gain * step / (z - phi + gain * step)
    expected = -gain * (1 + sampled) * (1 - 1 / z) / (s * T) / (s + a)
    np.testing.assert_allclose(held(gain).response(hz)[:, 0, 0], expected, rtol=1e-12)


def test_a_sampled_loop_is_unstable_beyond_the_gain_of_the_z_transform():
    phi = math.exp(-0.3)
    limit = (1 + phi) * 3.0 / (1 - phi)  # phi - gain (1 - phi) / a = -1
    assert np.abs(held(limit).multipliers()).max() == pytest.approx(1, abs=1e-12)
    amplified = held(5.0).with_gain(limit / 5.0, [0])
    assert np.abs(amplified.multipliers()).max() == pytest.approx(1, abs=1e-12)


def test_hits_of_samplers_with_a_common_period():
    period, hits = common_period((2e-3, 3e-3))
    assert period == pytest.approx(6e-3)
    assert [due for _, due in hits] == [(0, 1), (0,), (1,), (0,)]
    assert [round(t, 9) for t, _ in hits] == [0, 2e-3, 3e-3, 4e-3]
    assert common_period((1.0, math.pi)) is None


def test_ports_outside_a_loop_and_unknown_ones_are_refused():
    with pytest.raises(RotorsimError, match="no loop passes through this port"):
        margins(load("jeffcott"), "unbalance.force")
    with pytest.raises(RotorsimError, match="no such block"):
        margins(load("jeffcott"), "controler.current")


def test_the_figure_has_zones_and_the_open_loop(tmp_path):
    made = margins_figure(margins(load("jeffcott")), "jeffcott")
    made.savefig(tmp_path / "m.png")
    assert [text.get_text() for text in made.axes[0].texts] == ["A", "B", "C", "D"]
    assert made.axes[2].get_ylabel() == "phase of G_o [deg]"
