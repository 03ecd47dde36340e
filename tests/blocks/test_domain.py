"""Clock, crack, unbalance, bearings and lumped rotors against formulas written out here."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotorsim.blocks.excitations.clock import Clock
from scipy.integrate import quad

from tests.blocks.evaluation import prepare

TABLE = [0.5, 1.0, 2.0, 4.0], [2.0, 10.0, -3.0, 5.0]
ANGLES = np.linspace(-7.0, 7.0, 57)


def crack(theta, **options):
    parameters = {k: v for k, v in options.items() if k not in ("opening", "terms")}
    choices = {k: v for k, v in options.items() if k in ("opening", "terms")}
    return traced_crack(repr((parameters, choices)), parameters, choices).evaluate({"theta": theta}).outputs


def traced_crack(key, parameters, choices):
    if key not in _TRACED:
        _TRACED[key] = prepare("crack", {"theta": ()}, parameters, choices)
    return _TRACED[key]


_TRACED = {}


def test_the_clock_turns_at_constant_speed():
    out = prepare("clock", {}, {"speed": 3.0, "phase": 0.5}).evaluate(time=2.0).outputs
    assert (out["theta"], out["speed"]) == (pytest.approx(6.5), pytest.approx(3.0))


@settings(max_examples=40, deadline=None)
@given(st.floats(0, 30), st.floats(0.1, 10), st.floats(0, 50))
def test_the_angle_of_a_ramp_is_the_integral_of_its_speed(t, acceleration, start):
    limit = start + 60.0
    block = prepare(
        "clock", {}, {"speed": start, "acceleration": acceleration, "speed_limit": limit}, {"profile": "ramp"}
    )
    out = block.evaluate(time=t).outputs
    end = 60.0 / acceleration
    expected, _ = quad(lambda s: min(start + acceleration * s, limit), 0, t, points=[min(end, t)] if t else None)
    assert out["theta"] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert out["speed"] == pytest.approx(min(start + acceleration * t, limit))


@pytest.mark.parametrize(("start", "limit", "rate"), [(60.0, 0.0, -4.0), (60.0, 20.0, -4.0), (10.0, 30.0, 5.0)])
def test_a_ramp_rises_or_coasts_down_to_its_limit_with_a_constant_acceleration(start, limit, rate):
    values = {"speed": start, "acceleration": rate, "speed_limit": limit}
    block = prepare("clock", {}, values, {"profile": "ramp"})
    end = (limit - start) / rate
    for t in (0.0, 0.4 * end, 0.99 * end):
        out = block.evaluate(time=t).outputs
        assert out["speed"] == pytest.approx(start + rate * t, rel=1e-14)
        assert out["theta"] == pytest.approx(start * t + rate * t**2 / 2, rel=1e-14)
        assert out["acceleration"] == rate
    out = block.evaluate(time=end + 2.0).outputs
    assert (out["speed"], out["acceleration"]) == (pytest.approx(limit, abs=1e-12), 0.0)
    assert out["theta"] == pytest.approx((start + limit) / 2 * end + 2.0 * limit, rel=1e-14)


def test_a_ramp_that_cannot_reach_its_limit_is_refused():
    falling = {"speed": 60.0, "acceleration": -4.0, "speed_limit": 80.0}
    rising = {"speed": 60.0, "acceleration": 4.0, "speed_limit": 20.0}
    ramp = Clock({"profile": "ramp"})
    assert ramp.check({**falling, "times": TABLE[0]}) == [
        "speed_limit is above the speed at which the falling ramp begins; 0 rad/s lets the shaft coast down to rest"
    ]
    assert ramp.check({**rising, "times": TABLE[0]}) == ["speed_limit is below the speed at which the ramp begins"]
    assert ramp.check({**falling, "speed_limit": 0.0, "times": TABLE[0]}) == []
    assert ramp.check({**rising, "speed_limit": 60.0, "times": TABLE[0]}) == []


def test_the_thesis_angle_is_speed_times_time_whose_rate_is_twice_the_ramp():
    block = prepare("clock", {}, {"speed": 0.0, "acceleration": 4.0}, {"profile": "ramp", "angle": "omega_t"})
    angle = [float(block.evaluate(time=t).outputs["theta"]) for t in (2.0 - 1e-4, 2.0 + 1e-4)]
    assert (angle[1] - angle[0]) / 2e-4 == pytest.approx(2 * 4.0 * 2.0, rel=1e-9)


@pytest.mark.parametrize("t", [0.0, 0.3, 1.0, 1.7, 2.0, 3.5, 6.0])
def test_a_table_of_speeds_is_integrated_exactly(t):
    times, speeds = TABLE
    block = prepare("clock", {}, {"times": times, "speeds": speeds}, {"profile": "table"})
    out = block.evaluate(time=t).outputs
    expected, _ = quad(lambda s: np.interp(s, times, speeds), 0, t, points=[x for x in times if x < t] or None)
    assert out["theta"] == pytest.approx(expected, abs=1e-9)
    assert out["speed"] == pytest.approx(np.interp(t, times, speeds))
    slope = {0.0: 0.0, 0.3: 0.0, 1.0: -13.0, 1.7: -13.0, 2.0: 4.0, 3.5: 4.0, 6.0: 0.0}  # of what comes next
    assert out["acceleration"] == pytest.approx(slope[t], rel=1e-14)


def test_a_clock_of_constant_speed_does_not_accelerate():
    assert prepare("clock", {}, {"speed": 3.0}).evaluate(time=2.0).outputs["acceleration"] == 0.0


def test_the_moment_of_a_skew_disc_is_what_its_angular_momentum_takes_while_the_speed_changes():
    """-dH/dt of H = (I_p - I_d) tau theta' n, n = [cos, sin] of the skew axis, by differences of a swinging angle.

    A moment in the planes of x and y is -i times the torque about the axes x and y. The phase is that of the side
    to which unbalance of the disc's near face would lie, opposite to the tilt of the axis.
    """
    inputs = {"theta": (), "speed": (), "acceleration": ()}
    values = {"polar_inertia": 0.005, "diametral_inertia": 0.002, "skew": 1e-3, "phase": 0.3}
    swing, nu, W, t, h = 0.05, 40.0, 150.0, 0.0123, 1e-6

    def momentum(at):
        return 0.003e-3 * (W + swing * nu * np.cos(nu * at)) * np.exp(1j * (W * at + swing * np.sin(nu * at) + 0.3))

    at = {
        "theta": W * t + swing * np.sin(nu * t),
        "speed": W + swing * nu * np.cos(nu * t),
        "acceleration": -swing * nu**2 * np.sin(nu * t),
    }
    torque = -(momentum(t + h) - momentum(t - h)) / (2 * h)
    found = prepare("moment_unbalance", inputs, values).evaluate(at).outputs["moment"]
    assert complex(*found) == pytest.approx(1j * torque, rel=1e-6)


def test_the_harmonics_of_the_crack_force_are_those_of_the_thesis():
    """Participation factors p_i of eq. (2.29), printed to three decimals (its 0.319 is 1/pi = 0.3183)."""
    theta = np.arange(512) * 2 * np.pi / 512
    forces = np.array([crack(a, stiffness=1.0, sag=1.0, terms=50)["force"] for a in theta])
    p = np.fft.fft(forces[:, 0] + 1j * forces[:, 1]) / 512
    printed = {-5: 0.009, -3: -0.021, -1: 0.106, 0: 0.25, 1: 0.319, 2: 0.25, 3: 0.106, 5: -0.021, 7: 0.009}
    for order, value in printed.items():
        assert p[order].real == pytest.approx(value, abs=1e-3)
        assert p[order].imag == pytest.approx(0, abs=1e-12)


def test_the_switching_series_approaches_the_exact_square_wave():
    away = [a for a in ANGLES if abs(np.cos(a)) > 0.3]
    for a in away:
        exact = float(crack(a, opening="exact")["opening"])
        assert exact == (1.0 if np.cos(a) > 0 else 0.0)
        assert float(crack(a, opening="switching", terms=50)["opening"]) == pytest.approx(exact, abs=0.03)


@pytest.mark.parametrize("a", ANGLES[::8])
def test_breathing_open_and_given_harmonics(a):
    assert crack(a, opening="breathing")["opening"] == pytest.approx(0.5 * (1 + np.cos(a)))
    assert crack(a, opening="open")["opening"] == 1.0
    found = crack(a, opening="harmonics", mean=0.4, cosines=[0.1, 0.2, 0.0], sines=[0.0, -0.3, 0.5])["opening"]
    assert found == pytest.approx(
        0.4 + 0.1 * np.cos(a) + 0.2 * np.cos(2 * a) - 0.3 * np.sin(2 * a) + 0.5 * np.sin(3 * a)
    )


@pytest.mark.parametrize("a", ANGLES[::8])
def test_the_crack_force_is_the_stiffness_lost_in_rotating_coordinates_times_the_sag(a):
    """-dK u_0 of eq. (2.20), (2.22) from the rotation matrix (2.17); a phase turns the crack on the shaft."""
    s = float(crack(a, phase=0.7)["opening"])
    T = np.array([[np.cos(a + 0.7), np.sin(a + 0.7)], [-np.sin(a + 0.7), np.cos(a + 0.7)]])
    expected = s * T.T @ np.diag([3e5, 0.0]) @ T @ [2.6e-5, 0.0]
    assert crack(a, phase=0.7)["force"] == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("a", ANGLES[::8] + 0.01)
def test_a_breathing_crack_without_vibration_is_the_exact_switching_crack(a):
    block = prepare("crack_breathing", {"theta": (), "displacement": (2,)}, {}, {"law": "hinge"})
    out = block.evaluate({"theta": a, "displacement": np.zeros(2)}).outputs
    assert out["force"] == pytest.approx(crack(a, opening="exact")["force"], rel=1e-12, abs=1e-12)


def test_the_smooth_breathing_crack_is_the_hinge_away_from_closure():
    at = {"theta": 0.4, "displacement": np.array([5e-6, -8e-6])}
    inputs = {"theta": (), "displacement": (2,)}
    smooth = prepare("crack_breathing", inputs, {"width": 1e-8}, {"law": "smooth"}).evaluate(at).outputs["force"]
    hinge = prepare("crack_breathing", inputs, {}, {"law": "hinge"}).evaluate(at).outputs["force"]
    assert smooth == pytest.approx(hinge, rel=1e-12)


def test_the_unbalance_force_is_what_its_path_takes_while_the_speed_changes():
    """-m d^2/dt^2 of e (cos(theta + phase), sin(theta + phase)), by central differences of a swinging angle."""
    inputs = {"theta": (), "speed": (), "acceleration": ()}
    block = prepare("unbalance", inputs, {"mass": 2.0, "eccentricity": 24e-6, "phase": 0.3})
    swing, nu, W, t, h = 0.05, 40.0, 150.0, 0.0123, 1e-4

    def path(at):
        angle = W * at + swing * np.sin(nu * at) + 0.3
        return 24e-6 * np.array([np.cos(angle), np.sin(angle)])

    values = {
        "theta": W * t + swing * np.sin(nu * t),
        "speed": W + swing * nu * np.cos(nu * t),
        "acceleration": -swing * nu**2 * np.sin(nu * t),
    }
    force = block.evaluate(values).outputs["force"]
    expected = -2.0 * (path(t + h) - 2 * path(t) + path(t - h)) / h**2
    np.testing.assert_allclose(force, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_the_unbalance_force_is_centrifugal_and_turns_with_the_shaft():
    block = prepare("unbalance", {"theta": (), "speed": ()}, {"mass": 2.0, "eccentricity": 24e-6, "phase": 0.3})
    force = block.evaluate({"theta": 1.1, "speed": 157.0}).outputs["force"]
    assert complex(*force) == pytest.approx(2.0 * 24e-6 * 157.0**2 * np.exp(1.4j))


def test_the_linear_bearing_pushes_out_by_displacement_and_back_by_current():
    block = prepare("amb", {"displacement": (2,), "current": (2,)})
    force = block.evaluate({"displacement": [1e-6, -2e-6], "current": [0.1, 0.2]}).outputs["force"]
    assert force == pytest.approx([105210e-6 - 4.21, -2 * 105210e-6 - 8.42])


def test_the_nonlinear_bearing_is_tangent_to_the_linear_one_and_its_gap_is_k_i_i0_over_k_s():
    inputs = {"displacement": (2,), "current": (2,)}
    block = prepare("amb_nonlinear", inputs, {"force_current_factor": 42.1, "force_displacement_factor": 105210.0})

    def force(u, i):
        return float(block.evaluate({"displacement": [u, 0.0], "current": [i, 0.0]}).outputs["force"][0])

    assert force(0, 0) == pytest.approx(0, abs=1e-12)
    assert (force(1e-9, 0) - force(-1e-9, 0)) / 2e-9 == pytest.approx(105210, rel=1e-6)
    assert (force(0, 1e-6) - force(0, -1e-6)) / 2e-6 == pytest.approx(-42.1, rel=1e-6)
    K = 42.1 * (42.1 / 105210) ** 2 / 4
    g = 42.1 / 105210
    assert force(1e-5, 0.3) == pytest.approx(K * ((0.7 / (g - 1e-5)) ** 2 - (1.3 / (g + 1e-5)) ** 2), rel=1e-12)
    assert force(0.0, 1.5) == pytest.approx(-K * (2.5 / g) ** 2, rel=1e-12)  # the other magnet is off, it cannot push


def test_a_support_is_a_spring_and_a_damper_of_its_own_in_each_axis():
    inputs = {"displacement": (2,), "velocity": (2,)}
    block = prepare("support", inputs, {"stiffness": [2.0, 3.0], "damping": [0.5, 0.7]})
    out = block.evaluate({"displacement": [1.0, 2.0], "velocity": [10.0, 20.0]}).outputs["force"]
    assert out == pytest.approx([-7.0, -20.0])


def test_the_jeffcott_rotor_obeys_newton():
    block = prepare("rotor_2dof", {"force": (2,)}, {"mass": 2.0, "stiffness": 10.0, "viscous_damping": 3.0})
    found = block.evaluate({"force": [7.0, 0.0]}, {"position": [1.0, -1.0], "velocity": [0.5, 2.0]}).derivatives
    assert found["velocity"] == pytest.approx([(7 - 1.5 - 10) / 2, (-6 + 10) / 2])


def test_gyroscopic_moments_raise_forward_whirl():
    """Eigenvalues of I_d a'' - i W I_p a' + k a = 0 in complex tilt, against the block's two planes."""
    ip, i_d, k, w = 0.0048, 0.0024, 2350.0, 300.0
    values = {
        "coupling_stiffness": 0.0,
        "coupling_damping": 0.0,
        "tilt_damping": 0.0,
        "viscous_damping": 0.0,
        "polar_inertia": ip,
        "diametral_inertia": i_d,
        "tilt_stiffness": k,
    }
    block = prepare("rotor_4dof", {"force": (2,), "moment": (2,), "speed": ()}, values)
    inputs = {"force": np.zeros(2), "moment": np.zeros(2), "speed": w}
    columns = []
    for name, axis in (("tilt", 0), ("tilt", 1), ("tilt_velocity", 0), ("tilt_velocity", 1)):
        state = {name: np.eye(2)[axis]}
        found = block.evaluate(inputs, state).derivatives
        columns.append(np.concatenate([found["tilt"], found["tilt_velocity"]]))
    values, vectors = np.linalg.eig(np.array(columns).T)
    whirl = {}
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag > 0:  # motion Re(v e^{st}); forward circular whirl, x = cos, y = sin, is v = (1, -i)
            forward = abs(vector[0] + 1j * vector[1]) > abs(vector[0] - 1j * vector[1])
            whirl["forward" if forward else "backward"] = value.imag
    root = np.sqrt((w * ip) ** 2 + 4 * i_d * k)
    assert sorted(whirl.values()) == pytest.approx([(root - w * ip) / (2 * i_d), (root + w * ip) / (2 * i_d)])
    assert max(whirl, key=whirl.__getitem__) == "forward"
