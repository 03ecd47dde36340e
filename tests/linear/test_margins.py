"""Margins of bearing loops against closed forms; sampled loops against the z-transform of a first-order plant."""

import copy
import json
import math
import re

import numpy as np
import pytest
from scipy.optimize import brentq

from rotorsim.errors import RotorsimError
from rotorsim.linear.control.margins import margins, zone_of
from rotorsim.linear.linear_model import LinearModel, common_period
from rotorsim.linear.loop import Loop, injections
from rotorsim.linear.sampled_data import SampledData
from rotorsim.linear.stability import growing_multipliers
from rotorsim.linear.state_space import StateSpace
from rotorsim.model.load import load
from tests.acceptance.machines import jeffcott


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


def test_peak_is_found_between_points_of_the_grid_and_whatever_curve_is_asked_for():
    found = margins(load("jeffcott"), frequencies=[1.0, 2000.0])
    values = np.abs(1 / (1 + loop(np.linspace(100, 140, 400001))))
    assert found.peak == pytest.approx(values.max(), rel=1e-8)
    assert (found.zone, found.sensitivity.shape) == ("B", (2, 2, 2))
    assert found.statement.endswith("controller.displacement[1]: zone B (ISO 14839-3:2006)")


def test_least_gain_of_a_rotor_that_only_the_bearing_carries():
    """FAULT of an earlier version: limits of the gain were those of the frequencies asked for."""
    softer = {"force_displacement_factor": 9e5}  # N/m, more than the shaft's 7.6e5
    axis = margins(load("jeffcott"), parameters=softer, frequencies=[500.0]).axes[0]

    def real(f, part="real"):
        s = 2j * math.pi * f
        return getattr((12200 + 2000 / s + 3 * s) * 42.1 / (2 * s**2 + 76 * s + 7.6e5 - 9e5), part)

    crossing = brentq(lambda f: real(f, "imag"), 0.01, 100.0)
    assert axis.gain_down == pytest.approx(-1 / real(crossing), rel=1e-9)
    assert axis.gain_down_frequency == pytest.approx(crossing, rel=1e-9)
    assert axis.gain_up == np.inf


def delayed(delay: float, order: int = 8) -> dict:
    document = json.loads(json.dumps(load("jeffcott").document))
    document["blocks"]["hold"] = {"type": "delay", "parameters": {"delay": delay, "order": order}}
    document["wires"] = [w for w in document["wires"] if w != ["controller.current", "amb.current"]]
    document["wires"] += [["controller.current", "hold.input"], ["hold.output", "amb.current"]]
    return document


def test_a_margin_above_the_frequencies_that_the_standard_judges():
    delay = 2e-5
    axis = margins(load(delayed(delay))).axes[0]

    def lagging(f):
        return loop(f) * np.exp(-2j * math.pi * f * delay)

    crossing = brentq(lambda f: lagging(f).imag, 1e4, 1.6e4)
    assert axis.gain_up == pytest.approx(-1 / lagging(crossing).real, rel=1e-6)
    assert axis.gain_up_frequency == pytest.approx(crossing, rel=1e-6)


def test_a_peak_above_the_frequencies_that_the_standard_judges_is_said():
    """FAULT of an earlier version: 1e9 A/m with hardly any damping was zone A, and nothing else was said."""
    found = margins(load("jeffcott"), parameters={"controller.KP": 1e9})
    assert found.zone == "A"
    assert len(found.notes) == 2
    said = re.fullmatch(
        r"'controller.displacement\[1\]': \|S\| is (.+) at (.+) Hz, above the 2000 Hz that ISO 14839-3 judges",
        found.notes[0],
    )
    natural = math.sqrt((7.6e5 - 105210 + 42.1e9) / 2)
    damping = (76 + 42.1 * 3) / (2 * 2 * natural)
    assert float(said[1]) == pytest.approx(1 / (2 * damping), rel=0.02)
    assert float(said[2]) == pytest.approx(natural / (2 * math.pi), rel=1e-3)
    assert margins(load("jeffcott")).notes == ()


def test_a_delay_beyond_its_approximation_is_said():
    assert margins(load(delayed(2e-4, 8))).notes == ()
    found = margins(load(delayed(2e-4, 1)))
    assert found.notes == ("'hold': its Pade approximation is off by more than 1 % above 393 Hz",)


@pytest.mark.slow
def test_a_crossing_beside_a_flexible_mode_is_found():
    """FAULT of an earlier version: |G_o| = 1 at 490 Hz, in a band of 1 Hz, was passed over."""
    axis = margins(load("two_amb_rotor")).axes[0]
    assert (axis.name, axis.gain_up) == ("controller_a.displacement[1]", np.inf)
    found = margins(load("two_amb_rotor"), frequencies=np.linspace(480, 500, 4001))
    G = found.open_loop()[:, 0]
    crossed = found.frequencies[1:][np.diff(np.sign(np.abs(G) - 1)) != 0]
    assert np.abs(crossed - axis.delay_frequency).min() < 0.01


def test_an_unstable_loop_is_zone_d_without_margins():
    found = margins(load("jeffcott"), parameters={"controller.KD": -10.0})
    assert found.zone == "D"
    assert np.isnan([found.peak, found.axes[0].phase, found.singular_peak]).all()
    assert found.statement == "the closed loop is unstable: a sensitivity cannot be measured, zone D (ISO 14839-3:2006)"


def first_order(gain: float, a: float = 3.0, T: float = 0.1) -> SampledData:
    """Return y' = -a y + u, u = -gain (y + e) sampled every T; s = [y, u], outputs [y]."""
    flow = StateSpace(np.array([[-a, 1.0], [0, 0]]), np.zeros((2, 1)), np.array([[1.0, 0]]), np.zeros((1, 1)))
    jump = np.array([[1.0, 0], [-gain, 0]]), np.array([[0.0], [-gain]])
    return SampledData(flow, (0.0,), (jump,), T)


def test_a_sampled_system_has_the_response_of_the_z_transform():
    a, T, gain, hz = 3.0, 0.1, 5.0, np.array([0.3, 2.0, 4.9, 7.0, 31.0])
    s = 2j * np.pi * hz
    z, phi = np.exp(s * T), math.exp(-a * T)
    step = (1 - phi) / a
    sampled = -gain * step / (z - phi + gain * step)
    expected = -gain * (1 + sampled) * (1 - 1 / z) / (s * T) / (s + a)
    np.testing.assert_allclose(first_order(gain).response(hz)[:, 0, 0], expected, rtol=1e-12)


def test_multipliers_grow_beyond_the_gain_of_the_z_transform():
    phi = math.exp(-0.3)
    limit = (1 + phi) * 3.0 / (1 - phi)  # phi - gain (1 - phi) / a = -1
    for factor, count in ((0.999, 0), (1.001, 1)):
        system = first_order(5.0).amplified(factor * limit / 5.0, [0])
        assert len(growing_multipliers(system.monodromy)) == count
        np.testing.assert_allclose(system.monodromy, first_order(factor * limit).monodromy, rtol=1e-12)


def test_a_free_body_between_samples_does_not_grow():
    """Its double multiplier of 1 is computed as 1 +- 1e-8."""
    M = np.array([[1.0, 0.1], [0.0, 1.0]])
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    assert len(growing_multipliers(turn @ M @ turn.T)) == 0
    assert growing_multipliers(np.diag([1.0 + 1e-9, 0.5])) == pytest.approx([1.0 + 1e-9])


def test_hits_of_samplers_within_their_common_period():
    def jump(due):
        return np.eye(1) * (1 + sum(due)), np.zeros((1, 0))

    nothing = np.zeros((1, 0))
    found = SampledData.of(LinearModel(np.zeros((1, 1)), nothing, nothing.T, nothing[:0], (2e-3, 3e-3), jump))
    assert found.period == pytest.approx(6e-3)
    assert found.times == pytest.approx([0, 2e-3, 3e-3, 4e-3])
    assert [float(J[0, 0]) for J, _ in found.jumps] == [2, 1, 2, 1]
    assert common_period((1.0, math.pi)) is None


def refused(*arguments, **parameters) -> str:
    with pytest.raises(RotorsimError) as caught:
        margins(*arguments, **parameters)
    return str(caught.value)


@pytest.mark.slow
def test_ports_outside_a_loop_and_unknown_ones_are_refused_all_at_once():
    diagram = load("jeffcott")
    assert refused(diagram, "unbalance.force").splitlines()[0] == (
        "error: unbalance.force[1]: no loop passes through this port"
    )
    assert refused(diagram, ["controler.current", "controller.curent"]) == (
        "error: controler: no such block\n\nhint: did you mean 'controller'?\n"
        "error: controller.curent: no such port\n\nhint: did you mean 'current'?"
    )
    assert refused(load("rlc")) == (
        "error: rlc: no controller with a wired input 'displacement'\n\nhint: name the ports of its bearing loops: "
        "where a sensor's signal arrives, or the output of a controller"
    )
    assert refused(diagram, frequencies=[0.0]) == "error: frequencies: frequencies must be positive and finite [Hz]"


def one_axis():
    """Return the rotor with its controller wired in x alone, a magnet that gets nothing in y."""
    document = copy.deepcopy(dict(load("jeffcott").document))
    document["wires"] = [wire for wire in document["wires"] if wire != ["controller.current", "amb.current"]]
    document["blocks"] |= {"zero": {"type": "constant"}, "mux": {"type": "mux", "parameters": {}}}
    document["blocks"]["zero"]["parameters"] = {"value": 0.0}
    document["wires"] += [["controller.current[1]", "mux.input1"], ["zero.output", "mux.input2"]]
    document["wires"] += [["mux.output", "amb.current"]]
    return load(document)


@pytest.mark.slow
def test_an_axis_without_a_loop_is_left_out_and_said_to_be():
    """FAULT: a controller with one axis in its loop was refused, the sound axis with the other."""
    found = margins(one_axis())
    assert [axis.name for axis in found.axes] == ["controller.displacement[1]"]
    assert found.notes[0] == "'controller.displacement[2]': no loop passes there, it is left out"
    whole = margins(load("jeffcott"))
    assert found.peak == pytest.approx(whole.axes[0].peak, rel=1e-6)


def test_sampled_blocks_beside_a_nonlinear_bearing_are_refused():
    document = json.loads(json.dumps(load("jeffcott").document))
    document["blocks"]["controller"] = {"type": "discrete_pid"}
    document["blocks"]["amb"] = {"type": "amb_nonlinear"}
    assert refused(load(document)) == (
        "error: rotor: with sampled blocks a diagram must be linear, with constant coefficients\n\n"
        "hint: take the linear block ('amb' for 'amb_nonlinear'), or `rotorsim swap` a continuous controller in"
    )


def test_a_rate_that_passes_by_the_test_signal_is_said():
    document = json.loads(json.dumps(load("jeffcott").document))
    document["blocks"]["sensor"] = {"type": "gain", "parameters": {"gain": 1.0}}
    document["wires"] = [w for w in document["wires"] if w != ["rotor.displacement", "controller.displacement"]]
    document["wires"] += [["rotor.displacement", "sensor.input"], ["sensor.output", "controller.displacement"]]
    found = margins(load(document), "sensor.output")
    assert found.notes == (
        "'sensor.output' is disturbed, and 'controller.velocity' is not: name 'controller.displacement' where one "
        "sensor gives both",
    )
    assert margins(load(document)).peak == pytest.approx(margins(load("jeffcott")).peak, rel=1e-9)


@pytest.mark.parametrize(
    ("peak", "zone"), [(1.0, "A"), (2.999, "A"), (3.0, "B"), (3.999, "B"), (4.0, "C"), (4.99, "C"), (5.0, "D")]
)
def test_zones(peak, zone):
    assert zone_of(peak) == zone


@pytest.mark.slow
def test_a_sampled_loop_around_an_undamped_plant() -> None:
    """Between hits the plant rings at a pole on the imaginary axis, where S is zero and a resolvent has no value.

    Discrete PD on m q'' + k q = f: held, with c = KP q + KD q', S(e^{iwT}) by the z-transform of the plant at the hits
    gives the peak; test signals also alias, by the ratio of the frequencies, which are 400 to 1.
    """
    pid = {"type": "discrete_pid", "parameters": {"KP": 12500.0, "KI": 0.0, "KD": 3.75, "sample_time": "0.02 ms"}}
    drawn = load(jeffcott(4e5, 150.0, pid))
    opened = Loop(drawn, injections(drawn, ["controller.displacement"]))
    found = margins(drawn)
    undamped = np.sqrt(9e5 / 2.0) / (2 * np.pi)
    near = np.abs(opened.sensitivity(undamped * (1 + np.array([-1e-4, 0.0, 1e-13, 1e-4])))[:, 0, 0])
    assert near[1] < 1e-7
    assert near[2] < 1e-7
    assert near[[0, 3]] == pytest.approx([3.53e-4, 3.53e-4], rel=1e-2)
    hz = np.linspace(130.0, 139.0, 2001)
    assert found.peak == pytest.approx(np.abs(opened.sensitivity(hz)[:, 0, 0]).max(), rel=1e-4)
    assert found.peak == pytest.approx(_by_z(hz).max(), rel=5e-3)


def _by_z(hz: np.ndarray) -> np.ndarray:
    """Return |S| of the held loop from the plant at the hits, one hit late: without images."""
    T, m, k, ki = 2e-5, 2.0, 9e5, 40.0
    w = np.sqrt(k / m)
    A = np.array([[np.cos(w * T), np.sin(w * T) / w], [-w * np.sin(w * T), np.cos(w * T)]])
    B = np.array([(1 - np.cos(w * T)) / k, np.sin(w * T) * w / k]) * ki
    z = np.exp(2j * np.pi * hz * T)
    states = np.array([np.linalg.solve(value * np.eye(2) - A, B) for value in z])
    law = np.array([12500.0, 3.75])
    return np.abs(1 / (1 + (states @ law) / z))
