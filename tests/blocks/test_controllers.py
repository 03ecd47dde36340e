"""Controllers: their transfer functions, their sampled laws, and that all can be swapped for one another."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.signal

from tests.blocks.evaluation import Prepared, prepare, response_at, run_hits, state_space_of

rng = np.random.default_rng(3)
FREQUENCIES = [1.0, 157.0, 764.0, 5000.0]
TWO = {"displacement": (2,)}
MATRICES = {
    "A": rng.normal(size=(4, 4)),
    "B": rng.normal(size=(4, 2)),
    "C": rng.normal(size=(2, 4)),
    "D": rng.normal(size=(2, 2)),
}
CONTROLLERS: dict[str, dict[str, Any]] = {
    "pid": {},
    "pd": {},
    "lead_lag": {},
    "notch_pid": {},
    "cross_coupled_pid": {},
    "discrete_pid": {},
    "state_space": MATRICES,
    "state_feedback": MATRICES,
}


def response(prepared: Prepared, frequency: float) -> np.ndarray:
    """Return the 2 x 2 response of the current to the displacement, through the velocity too where it is wired."""
    total = response_at(state_space_of(prepared, "displacement", "current"), frequency)
    if "velocity" in prepared.trace.inputs:
        total = total + 1j * frequency * response_at(state_space_of(prepared, "velocity", "current"), frequency)
    return total


def pid_law(s: complex, KP: float, KI: float, KD: float, filter_time: float | None) -> complex:
    return KP + KI / s + KD * (s if filter_time is None else s / (1 + filter_time * s))


@pytest.mark.parametrize("type_name", CONTROLLERS)
@pytest.mark.parametrize("wired", [(), ("velocity",), ("reference",), ("velocity", "reference")])
def test_every_controller_takes_the_same_wires(type_name: str, wired: tuple[str, ...]) -> None:
    prepared = prepare(type_name, TWO | dict.fromkeys(wired, (2,)), CONTROLLERS[type_name])
    block = prepared.block
    units = {name: port.unit for name, port in block.inputs.items()}
    assert units == {"displacement": "m", "velocity": "m/s", "reference": "m"}
    assert [name for name, port in block.inputs.items() if not port.optional] == ["displacement"]
    assert {name: (port.unit, block.declared_shape(port)) for name, port in block.outputs.items()} == {
        "current": ("A", (2,))
    }
    assert block.category == "controller"


@pytest.mark.parametrize("type_name", CONTROLLERS)
def test_the_reference_is_subtracted_from_the_displacement(type_name: str) -> None:
    prepared = prepare(type_name, TWO | {"velocity": (2,), "reference": (2,)}, CONTROLLERS[type_name])
    place = np.array([3e-5, -1e-5])
    moved = {"displacement": place, "velocity": [0.0, 0.0], "reference": place}
    if type_name == "discrete_pid":
        currents = [o["current"] for o in run_hits(prepared, [moved] * 3)]
    else:
        currents = [prepared.evaluate(moved).outputs["current"]]
        for rate in prepared.evaluate(moved).derivatives.values():
            np.testing.assert_array_equal(rate, np.zeros_like(rate))
    np.testing.assert_array_equal(currents, np.zeros((len(currents), 2)))


@pytest.mark.parametrize("type_name", ["pid", "pd", "lead_lag", "notch_pid", "cross_coupled_pid"])
def test_positive_displacement_gives_positive_current(type_name: str) -> None:
    current = prepare(type_name, TWO | {"velocity": (2,)}).evaluate({"displacement": [1e-5, 2e-5]}).outputs["current"]
    assert np.all(current > 0)


@pytest.mark.parametrize("frequency", FREQUENCIES)
@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("type_name", ["pid", "pd"])
def test_pid_is_thesis_equation_2_24(type_name: str, velocity: bool, frequency: float) -> None:
    values = {"KP": 12200.0, "KI": 2000.0, "KD": 3.0, "derivative_time_constant": 2e-4}
    if type_name == "pd":
        del values["KI"]
    prepared = prepare(type_name, TWO | ({"velocity": (2,)} if velocity else {}), values)
    s = 1j * frequency
    expected = pid_law(s, 12200.0, values.get("KI", 0.0), 3.0, None if velocity else 2e-4)
    np.testing.assert_allclose(response(prepared, frequency), expected * np.eye(2), rtol=1e-10, atol=1e-9)


def test_pid_defaults_are_those_of_thesis_table_2_1() -> None:
    values = prepare("pid", TWO).parameters
    assert [float(values[name]) for name in ("KP", "KI", "KD")] == [12200.0, 2000.0, 3.0]


def test_pid_filter_starts_at_the_displacement_it_is_told() -> None:
    prepared = prepare("pid", TWO, {"initial_displacement": [1e-5, 2e-5]})
    rates = prepared.evaluate({"displacement": [1e-5, 2e-5]}).derivatives
    np.testing.assert_array_equal(rates["filtered"], [0.0, 0.0])


def test_a_jump_of_the_reference_gives_no_derivative_kick() -> None:
    prepared = prepare("pid", TWO | {"reference": (2,)}, {"KP": 100.0})
    current = prepared.evaluate({"displacement": [0.0, 0.0], "reference": [1e-3, 0.0]}).outputs["current"]
    np.testing.assert_allclose(current, [-0.1, 0.0])


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_lead_lag_is_its_transfer_function(frequency: float) -> None:
    values = {"gain": 9000.0, "lead_time_constant": 2e-3, "lag_time_constant": 1e-4}
    prepared = prepare("lead_lag", TWO, values)
    s = 1j * frequency
    expected = 9000.0 * (1 + 2e-3 * s) / (1 + 1e-4 * s) * np.eye(2)
    np.testing.assert_allclose(response(prepared, frequency), expected, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("frequency", [*FREQUENCIES, 600.0])
@pytest.mark.parametrize("velocity", [True, False])
def test_notch_pid_is_pid_times_notch(frequency: float, velocity: bool) -> None:
    values = {"notch_frequency": 600.0, "notch_width": 0.3, "notch_depth": 0.05}
    prepared = prepare("notch_pid", TWO | ({"velocity": (2,)} if velocity else {}), values)
    s = 1j * frequency
    notch = scipy.signal.freqs([1, 0.05 * 0.3 * 600, 600**2], [1, 0.3 * 600, 600**2], [frequency])[1][0]
    expected = notch * pid_law(s, 12200.0, 2000.0, 3.0, None if velocity else 1e-4)
    np.testing.assert_allclose(response(prepared, frequency), expected * np.eye(2), rtol=1e-9, atol=1e-8)


def test_notch_width_is_the_bandwidth_at_3_db_of_a_full_notch() -> None:
    values = {"notch_frequency": 600.0, "notch_width": 0.3, "notch_depth": 0.0, "KI": 0.0, "KD": 0.0, "KP": 1.0}
    prepared = prepare("notch_pid", TWO | {"velocity": (2,)}, values)
    # |N| = 1/sqrt(2) where |w0^2 - w^2| = width w0 w, whose roots differ by width w0
    edges = 600.0 * (np.array([-1, 1]) * 0.15 + np.sqrt(1 + 0.15**2))
    assert edges[1] - edges[0] == pytest.approx(0.3 * 600.0)
    gains = [abs(response(prepared, float(edge))[0, 0]) for edge in edges]
    np.testing.assert_allclose(gains, np.sqrt(0.5), rtol=1e-12)


@pytest.mark.parametrize("frequency", [-764.0, -30.0, 30.0, 764.0])
def test_cross_coupled_pid_acts_on_complex_whirl(frequency: float) -> None:
    values = {"KPC": 800.0, "KDC": 0.7}
    prepared = prepare("cross_coupled_pid", TWO | {"velocity": (2,)}, values)
    matrix = response(prepared, frequency)
    # r = x + j y = exp(j w t): [x, y] is the real part of [1, -j] exp(j w t)
    current = matrix @ np.array([1, -1j])
    s = 1j * frequency
    expected = (12200.0 - 800j) + 2000.0 / s + (3.0 - 0.7j) * s
    np.testing.assert_allclose(current, expected * np.array([1, -1j]), rtol=1e-10)


def test_cross_gain_moves_damping_from_forward_to_backward_whirl() -> None:
    """m r'' + c r' + k r = -k_i i with i = (KP - j KPC) r: the sign that the docstring states."""
    m, c, k, k_i = 2.0, 76.0, 6.5e5, 42.1
    damping = []
    for cross in (0.0, 500.0):
        matrix = response(
            prepare("cross_coupled_pid", TWO | {"velocity": (2,)}, {"KPC": cross, "KI": 0.0, "KD": 0.0}), 1.0
        )
        gain = (matrix @ np.array([1, -1j]))[0]
        poles = np.roots([m, c, k + k_i * gain])
        damping.append({"forward": -poles[poles.imag > 0][0].real, "backward": -poles[poles.imag < 0][0].real})
    assert damping[1]["forward"] < damping[0]["forward"] < damping[1]["backward"]


def test_cross_coupled_pid_without_cross_gains_is_pid() -> None:
    for frequency in FREQUENCIES:
        a, b = (response(prepare(name, TWO), frequency) for name in ("pid", "cross_coupled_pid"))
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("type_name", ["state_space", "state_feedback"])
def test_state_space_controllers_are_their_matrices(type_name: str) -> None:
    found = state_space_of(prepare(type_name, TWO, MATRICES), "displacement", "current")
    for value, expected in zip(found, MATRICES.values(), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-14)


def test_state_feedback_docstring_gives_the_observer_based_controller() -> None:
    """Separation: closed-loop poles are those of Ap - Bp K and of Ap - L Cp (plant x' = Ap x + Bp i, u = Cp x)."""
    m, k, c = 2.0, 6.5e5, 76.0
    Ap = np.block([[np.zeros((2, 2)), np.eye(2)], [-k / m * np.eye(2), -c / m * np.eye(2)]])
    Bp, Cp = np.vstack([np.zeros((2, 2)), -42.1 / m * np.eye(2)]), np.eye(2, 4)
    K = Bp.T @ scipy.linalg.solve_continuous_are(Ap, Bp, np.diag([1e10, 1e10, 1e6, 1e6]), np.eye(2))
    L = scipy.linalg.solve_continuous_are(Ap.T, Cp.T, np.diag([1.0, 1.0, 1e8, 1e8]), np.eye(2)) @ Cp.T
    values = {"A": Ap - Bp @ K - L @ Cp, "B": L, "C": -K}
    A, B, C, D = state_space_of(prepare("state_feedback", TWO, values), "displacement", "current")
    closed = np.block([[Ap + Bp @ D @ Cp, Bp @ C], [B @ Cp, A]])
    # the characteristic polynomials are compared: double poles are ill-conditioned, coefficients are not
    scale = 800.0  # rad/s, near the poles
    expected = np.polymul(np.poly((Ap - Bp @ K) / scale), np.poly((Ap - L @ Cp) / scale))
    np.testing.assert_allclose(np.poly(closed / scale), expected, rtol=1e-9)
    assert np.linalg.eigvals(closed).real.max() < np.linalg.eigvals(Ap).real.max()


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("velocity", [True, False])
def test_discrete_pid_is_its_difference_equation(delay: int, velocity: bool) -> None:
    T, T_f, KP, KI, KD = 1e-3, 4e-3, 100.0, 700.0, 0.3
    values = {"sample_time": T, "derivative_time_constant": T_f, "KP": KP, "KI": KI, "KD": KD}
    prepared = prepare("discrete_pid", TWO | ({"velocity": (2,)} if velocity else {}), values, {"delay_samples": delay})
    u, v = rng.normal(size=(2, 30, 2))
    steps = [{"displacement": a} | ({"velocity": b} if velocity else {}) for a, b in zip(u, v, strict=True)]
    found = np.array([o["current"] for o in run_hits(prepared, steps)])
    integral = scipy.signal.lfilter([T], [1, -1], u, axis=0)
    rate = v if velocity else scipy.signal.lfilter([1, -1], [T_f + T, -T_f], u, axis=0)
    computed = KP * u + KI * integral + KD * rate
    expected = np.concatenate([np.zeros((delay, 2)), computed])[: len(u)]
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)


def test_discrete_pid_delays_by_one_sample_unless_told_otherwise() -> None:
    prepared = prepare("discrete_pid", TWO)
    assert prepared.initial["line"].shape == (2, 2)
    assert prepared.trace.hit_feedthrough == {"current": ()}
    immediate = prepare("discrete_pid", TWO, options={"delay_samples": 0})
    assert immediate.trace.hit_feedthrough == {"current": ("displacement",)}
    assert immediate.trace.feedthrough == {"current": ()}


def test_discrete_pid_starts_without_a_kick_at_its_initial_displacement() -> None:
    place = [2e-5, -1e-5]
    values = {"KP": 0.0, "KI": 0.0, "initial_displacement": place}
    prepared = prepare("discrete_pid", TWO, values, {"delay_samples": 0})
    found = [o["current"] for o in run_hits(prepared, [{"displacement": place}] * 3)]
    np.testing.assert_array_equal(found, np.zeros((3, 2)))


def test_discrete_pid_clamps_and_does_not_wind_up() -> None:
    T, KP, KI, limit = 1e-2, 1.0, 10.0, 2.0
    values = {"sample_time": T, "KP": KP, "KI": KI, "KD": 0.0, "current_limit": limit}
    prepared = prepare("discrete_pid", TWO, values, {"delay_samples": 0, "anti_windup": "clamp"})
    u = np.concatenate([np.full(100, 1.5), np.full(5, 3.0), np.full(20, -0.2)])
    found = np.array([o["current"] for o in run_hits(prepared, [{"displacement": [a, -a]} for a in u])])
    assert np.abs(found).max() == limit
    np.testing.assert_array_equal(found[:, 1], -found[:, 0])
    expected, integral = [], 0.0
    for error in u:  # the law of the docstring, one axis, in plain Python
        wanted = KP * error + KI * (integral + T * error)
        if not (abs(wanted) > limit and wanted * error > 0):
            integral += T * error
        expected.append(min(max(KP * error + KI * integral, -limit), limit))
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-12)
    assert found[105, 0] < limit  # leaves the limit at once when the error turns
