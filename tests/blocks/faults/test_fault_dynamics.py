"""Faults with memory: frequency responses against exact formulas, and conservation of energy."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import pytest

from rotorsim.diagram.resolve.registry import find
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.blocks.evaluation import Prepared, prepare, response_at, state_space_of

BAND = 2 * pi * np.geomspace(1.0, 1000.0, 301)  # rad/s


def response(prepared: Prepared, port: str, output: str, w: np.ndarray) -> np.ndarray:
    """Response of the first entry to the first entry at angular frequencies."""
    system = state_space_of(prepared, port, output)
    return np.array([response_at(system, float(f))[0, 0] for f in w])


def force_on_motion(prepared: Prepared, w: np.ndarray) -> np.ndarray:
    """Force of a block on the displacement e^{i w t} that it sees together with its velocity."""
    total = np.zeros(len(w), complex)
    for port, factor in (("displacement", np.ones_like(w)), ("velocity", 1j * w)):
        if port in prepared.trace.inputs:
            total = total + factor * response(prepared, port, "force", w)
    return total


def run(blocks: dict[str, Any], wires: list[list[str]], record: list[str], step: float, stop: float) -> Any:
    solver = {"method": "rk4", "step": step, "stop": stop}
    document = {"schema_version": 1, "name": "test", "blocks": blocks, "wires": wires, "solver": solver}
    result = simulate(load({**document, "record": record}))
    assert result.status == "finished"
    return result


# --- lags of the current ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_control_delay_turns_the_phase_and_keeps_the_size(order: int) -> None:
    T = 2e-4
    found = response(
        prepare("control_delay", {"current": (2,)}, {"delay": T}, {"order": order}), "current", "delayed", BAND
    )
    np.testing.assert_allclose(np.abs(found), 1.0, rtol=1e-12)
    n = {1: 1 / 12, 2: 1 / 720, 3: 1 / 100800, 4: 1 / 25401600}[order]  # (n!)^2 / ((2n)! (2n + 1)!)
    assert (np.abs(found - np.exp(-1j * BAND * T)) <= 1.05 * n * (BAND * T) ** (2 * order + 1) + 1e-12).all()


def test_amplifier_bandwidth_is_a_first_order_lag() -> None:
    found = response(
        prepare("amplifier_bandwidth", {"current": (2,)}, {"bandwidth": 5e3}), "current", "amplified", BAND
    )
    np.testing.assert_allclose(found, 1 / (1 + 1j * BAND / 5e3), rtol=1e-12)


@pytest.mark.parametrize("shape", [(), (2,)])
@pytest.mark.parametrize("tau", [1e-8, 1e-6, 1e-5, 1e-4, 1e-3, 0.1])
def test_eddy_currents_lag_with_the_square_root_of_frequency(tau: float, shape: tuple[int, ...]) -> None:
    block = prepare("eddy_current_lag", {"current": shape}, {"time_constant": tau}, {"law": "sqrt"})
    found = response(block, "current", "effective_current", BAND)
    exact = 1 / (1 + np.sqrt(1j * BAND * tau))
    assert np.abs(found / exact - 1).max() < 0.0045
    assert (np.abs(found - exact) < 0.0045 * np.abs(1 - exact)).all()  # also of the lag itself
    assert response(block, "current", "effective_current", np.zeros(1)) == pytest.approx(1.0, rel=1e-12)
    poles = np.linalg.eigvals(state_space_of(block, "current", "effective_current")[0])
    assert poles.real.max() < 0
    assert np.abs(poles).max() < 2.6e4  # RK4 with a step of 0.1 ms is stable


def test_eddy_currents_of_first_order_lag_in_part_of_the_force() -> None:
    values = {"time_constant": 3e-4, "share": 0.2}
    block = prepare("eddy_current_lag", {"current": (2,)}, values, {"law": "first_order"})
    found = response(block, "current", "effective_current", BAND)
    np.testing.assert_allclose(found, 0.8 + 0.2 / (1 + 1j * BAND * 3e-4), rtol=1e-12)


# --- damping that does not depend on frequency ------------------------------------------------------------------------

HYSTERESIS: dict[str, Any] = {"loss_factor": 0.02, "stiffness": 5e5}


@pytest.mark.parametrize("shape", [(), (2,)])
def test_the_loss_of_the_band_law_is_constant_and_the_same_backward(shape: tuple[int, ...]) -> None:
    reference = 2 * pi * 40
    inputs = {"displacement": shape, "velocity": shape}
    block = prepare("hysteretic_damping", inputs, {**HYSTERESIS, "reference_frequency": reference}, {"law": "band"})
    for sign in (1, -1):
        ratio = force_on_motion(block, sign * BAND) / (-1j * sign * 0.02 * 5e5)
        assert np.abs(ratio.real - 1).max() < 0.002
    assert force_on_motion(block, np.array([reference])).real == pytest.approx(0.0, abs=1e-9)
    # causality: stiffness rises with the logarithm of frequency where the loss is constant
    stiffness = -force_on_motion(block, 2 * pi * np.array([20.0, 20.0 * np.e])).real / (0.02 * 5e5)
    assert stiffness[1] - stiffness[0] == pytest.approx(2 / pi, rel=0.02)


@pytest.mark.parametrize("speed", [40.0, -300.0])
def test_the_law_of_harmonics_is_exact_at_every_order_forward_and_backward(speed: float) -> None:
    inputs = {"displacement": (2,), "velocity": (2,), "speed": ()}
    block = prepare("hysteretic_damping", inputs, HYSTERESIS, {"law": "harmonics", "orders": 9})

    def at(displacement: np.ndarray, states: dict[str, np.ndarray]) -> Any:
        return block.evaluate({"displacement": displacement, "velocity": np.zeros(2), "speed": speed}, states)

    zero = {name: np.zeros_like(value) for name, value in block.initial.items()}
    sizes = [zero[name].size for name in zero]

    def split(column: np.ndarray) -> dict[str, np.ndarray]:
        parts = np.split(column, np.cumsum(sizes)[:-1])
        return {name: part.reshape(zero[name].shape) for name, part in zip(zero, parts, strict=True)}

    def rates(result: Any) -> np.ndarray:
        return np.concatenate([result.derivatives[name].ravel() for name in zero])

    A = np.array([rates(at(np.zeros(2), split(unit))) for unit in np.eye(sum(sizes))]).T
    B = np.array([rates(at(unit, zero)) for unit in np.eye(2)]).T
    C = np.array([at(np.zeros(2), split(unit)).outputs["force"] for unit in np.eye(sum(sizes))]).T
    for k in [*range(-9, 0), *range(1, 10)]:
        forward = np.array([1.0, -1j])  # Re(z e^{i k W t}) of x + i y = e^{i k W t}
        found = C @ np.linalg.solve(1j * k * speed * np.eye(len(A)) - A, B @ forward)
        np.testing.assert_allclose(found, -1j * 0.02 * np.sign(k * speed) * 5e5 * forward, rtol=1e-9)
    mean = C @ np.linalg.solve(-A, B)
    np.testing.assert_allclose(mean, 0.0, atol=1e-6)
    # what it holds of an earlier motion is halved in each turn
    assert np.linalg.eigvals(A).real.max() * 2 * pi / abs(speed) < -np.log(2)


def test_harmonics_without_a_shaft_are_refused() -> None:
    cls = find("hysteretic_damping")
    assert cls is not None
    block = cls({"law": "harmonics"}, frozenset({"displacement", "velocity"}))
    assert block.check({}) == ['law "harmonics" needs the input speed (without a shaft: law "band")']


# --- masses and springs -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(), (2,)])
def test_a_foundation_is_what_a_rigid_bearing_lacks(shape: tuple[int, ...]) -> None:
    k, m, w_f, d = 4e5, 15.0, 2 * pi * 50, 0.04
    values = {"bearing_stiffness": k, "mass": m, "frequency": w_f, "damping_ratio": d}
    found = force_on_motion(prepare("foundation_mode", {"displacement": shape}, values), BAND)
    ground = m * (w_f**2 - BAND**2 + 2j * d * w_f * BAND)
    series = 1 / (1 / k + 1 / ground)  # spring of the bearing on the foundation
    np.testing.assert_allclose(found, k - series, rtol=1e-9)


@pytest.mark.parametrize("shape", [(), (2,)])
def test_a_mass_error_is_a_mass_below_the_frequency_of_its_observer(shape: tuple[int, ...]) -> None:
    w = 1e5
    block = prepare("mass_error", {"velocity": shape}, {"mass": 0.3})
    ratio = force_on_motion(block, BAND) / (0.3 * BAND**2)
    s = 1j * BAND / w
    np.testing.assert_allclose(ratio, (1 + np.sqrt(2) * s) / (1 + np.sqrt(2) * s + s**2), rtol=1e-9)
    at = force_on_motion(block, 2 * pi * np.array([500.0, 1000.0])) / (0.3 * (2 * pi * np.array([500.0, 1000.0])) ** 2)
    assert np.abs(at - 1) == pytest.approx([0.001, 0.004], rel=0.05)  # as its page says
    assert (np.abs(np.angle(at)) < [1e-4, 4e-4]).all()


@pytest.mark.parametrize("part", [-0.3, 0.1, 0.5])
def test_rk4_holds_a_mass_error_with_the_step_that_its_page_says(part: float) -> None:
    """Eigenvalues of a free mass with the block, times 2 / w, inside the region of stability of RK4."""
    w = 1e5
    A, B, C, D = state_space_of(prepare("mass_error", {"velocity": ()}, {"mass": part}), "velocity", "force")
    loop = np.block([[D, C], [B, A]])  # v' = force of a mass of 1
    z = np.linalg.eigvals(loop) * 2 / w
    assert (np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) <= 1 + 1e-9).all()


def test_a_thermal_bow_grows_with_its_time_constant() -> None:
    values = {"amplitude": 2e-6, "phase": 0.4, "growth": 3e-6, "growth_phase": -1.0, "time_constant": 5.0}
    block = prepare("thermal_bow", {"theta": ()}, {**values, "stiffness": 1e5})
    A = block.evaluate({"theta": 0.0}, {"grown": 1.0}).derivatives["grown"]
    assert A == 0
    for t in (0.0, 3.0, 100.0):
        grown = 1 - np.exp(-t / 5.0)
        at = block.evaluate({"theta": 2.0}, {"grown": grown})
        assert at.derivatives["grown"] == pytest.approx(np.exp(-t / 5.0) / 5.0, rel=1e-9, abs=1e-12)
        bow = 2e-6 * np.exp(0.4j) + 3e-6 * np.exp(-1j) * grown
        assert complex(*at.outputs["force"]) == pytest.approx(1e5 * bow * np.exp(2j), rel=1e-12)


def test_base_excitation_is_the_inertia_force_on_a_shaking_base() -> None:
    values = {"mass": 3.0, "acceleration": 0.2, "frequency": 100.0, "phase": 0.3, "direction": 0.5}
    for t in (0.0, 0.013):
        force = prepare("base_excitation", {}, values, {}, {"force": (2,)}).evaluate(time=t).outputs["force"]
        assert complex(*force) == pytest.approx(-3.0 * 0.2 * np.cos(100 * t + 0.3) * np.exp(0.5j), rel=1e-12)


def test_the_rate_of_a_fluctuating_angle_is_its_derivative() -> None:
    values = {"amplitude": 0.02, "frequency": 30.0, "phase": 0.7}
    block = prepare("speed_fluctuation", {"theta": (), "speed": ()}, values)

    def at(t: float) -> Any:
        return block.evaluate({"theta": 150.0 * t, "speed": 150.0}, time=t).outputs

    assert at(0.2)["angle"] == pytest.approx(30.0 + 0.02 * np.sin(30 * 0.2 + 0.7), rel=1e-12)
    slope = (at(0.2 + 1e-6)["angle"] - at(0.2 - 1e-6)["angle"]) / 2e-6
    assert at(0.2)["rate"] == pytest.approx(slope, rel=1e-8)


def test_a_shaft_that_swings_on_a_ramp_has_the_acceleration_of_both() -> None:
    values = {"amplitude": 0.02, "frequency": 30.0, "phase": 0.7}
    block = prepare("speed_fluctuation", {"theta": (), "speed": (), "acceleration": ()}, values)

    def at(t: float) -> Any:
        ramp = {"theta": 150.0 * t - 3.5 * t**2, "speed": 150.0 - 7.0 * t, "acceleration": -7.0}
        return block.evaluate(ramp, time=t).outputs

    slope = (at(0.2 + 1e-6)["rate"] - at(0.2 - 1e-6)["rate"]) / 2e-6
    assert at(0.2)["angular_acceleration"] == pytest.approx(slope, rel=1e-7)


# --- limits of the rate -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("slew", "limited"), [(100.0, True), (1e4, False)])
def test_the_slew_limit_makes_a_triangle_of_a_fast_sine_and_leaves_a_slow_one(slew: float, limited: bool) -> None:
    step, lag = 1e-5, 5e-5
    limits = {"law": "slew", "slew": slew, "lag": lag}
    blocks = {
        "wave": {"type": "sine", "parameters": {"frequency": "50 Hz"}},
        "amplifier": {"type": "current_clipping", "parameters": limits},
    }
    result = run(blocks, [["wave.output", "amplifier.current"]], ["wave.output", "amplifier.limited"], step, 0.5)
    wave, found = result["wave.output"], result["amplifier.limited"]
    if not limited:
        np.testing.assert_allclose(found, wave, atol=1e-12)
        return
    # i = v + e with |v'| <= slew and |e| <= lag slew
    assert np.abs(np.diff(found)).max() <= slew * (step + 2 * lag)
    last = found[-2001:]  # one period: 314 A/s wanted, 100 A/s allowed, which makes a triangle
    assert np.ptp(last) == pytest.approx(slew / (2 * 50), rel=2 * lag * 4 * 50)
    assert np.mean(np.abs(np.diff(last)) > 0.999 * slew * step) > 1 - 4 * lag * 4 * 50


# --- torsion ----------------------------------------------------------------------------------------------------------


def test_bending_and_torsion_exchange_energy_and_lose_none() -> None:
    """A disc that does not turn, without damping: Lagrange's energies of bending, twist, unbalance and crack."""
    m, k, J, w_t, me, kc, g = 2.0, 7.6e5, 0.0048, 2 * pi * 90, 5e-3, 3e3, 9.80665
    theta, beta, gamma, sag = 0.6, 0.9, -0.4, 2.6e-5
    torsion = {
        "unbalance": me,
        "phase": beta,
        "inertia": J,
        "frequency": w_t,
        "damping_ratio": 0.0,
        "crack_coupling": kc,
        "crack_phase": gamma,
        "sag": sag,
        "bandwidth": 2e5,
    }
    rotor = {"mass": m, "stiffness": k, "viscous_damping": 0.0, "initial_displacement": [3e-4, -1e-4]}
    blocks = {
        "clock": {"type": "clock", "parameters": {"speed": 0.0, "phase": theta}},
        "rotor": {"type": "rotor_2dof", "parameters": rotor},
        "torsion": {"type": "torsion_coupling", "parameters": torsion},
    }
    wires = [[f"rotor.{port}", f"torsion.{port}"] for port in ("displacement", "velocity")]
    wires += [[f"clock.{port}", f"torsion.{port}"] for port in ("theta", "speed")] + [["torsion.force", "rotor.force"]]
    signals = ["rotor.displacement", "rotor.velocity", "torsion.twist"]
    step = 5e-6
    result = run(blocks, wires, signals, step, 0.05)
    q, v = (result[name] @ [1, 1j] for name in signals[:2])
    phi = result["torsion.twist"]
    rate = (phi[2:] - phi[:-2]) / (2 * step)
    q, v, phi = q[1:-1], v[1:-1], phi[1:-1]
    b = theta + phi + beta
    normal, opening = np.exp(1j * (theta + gamma)), 0.5 * (1 + np.cos(theta + gamma))
    twist = 0.5 * J * rate**2 + 0.5 * J * w_t**2 * phi**2
    kinetic = 0.5 * m * np.abs(v) ** 2 + me * rate * (v.conj() * 1j * np.exp(1j * b)).real
    potential = 0.5 * k * np.abs(q) ** 2 - me * g * np.cos(b) + opening * kc * phi * (normal.conj() * (q + sag)).real
    total = kinetic + potential + twist
    assert np.ptp(twist) > 1e-3 * np.ptp(potential)  # the coupling is felt
    assert np.ptp(total) < 0.01 * np.ptp(twist)


def test_torsion_is_driven_by_the_weight_of_the_unbalance() -> None:
    """J phi'' = -m e g sin b of a disc that is held: a pendulum whose weight acts along x."""
    values = {"unbalance": 1e-3, "phase": 0.2, "inertia": 0.005, "crack_coupling": 0.0}
    inputs = {"displacement": (2,), "velocity": (2,), "theta": (), "speed": ()}
    at = {"displacement": np.zeros(2), "velocity": np.zeros(2), "theta": 0.5, "speed": 100.0}
    found = prepare("torsion_coupling", inputs, values).evaluate(at)
    assert found.derivatives["rate"] == pytest.approx(-1e-3 * 9.80665 * np.sin(0.7) / 0.005, rel=1e-12)
    expected = -1e-3 * 1j * float(found.derivatives["rate"]) * np.exp(0.7j)
    assert complex(*found.outputs["force"]) == pytest.approx(expected, rel=1e-9)


def test_torsion_turns_the_unbalance_and_the_crack_with_the_twist() -> None:
    rng = np.random.default_rng(12)
    values = {"unbalance": 1e-3, "phase": 0.2, "inertia": 0.005, "crack_coupling": 2e3, "crack_phase": -0.7}
    values |= {"frequency": 500.0, "damping_ratio": 0.03, "sag": 2e-5, "bandwidth": 2e4}
    inputs = {"displacement": (2,), "velocity": (2,), "theta": (), "speed": ()}
    block = prepare("torsion_coupling", inputs, values)
    q, v, v_seen, trend = (complex(*rng.normal(size=2)) * size for size in (1e-4, 0.02, 0.02, 5.0))
    theta, W, phi, rate = 0.5, 100.0, 0.3, 40.0
    pair = {name: [z.real, z.imag] for name, z in (("q", q), ("v", v), ("seen", v_seen), ("trend", trend))}
    at = {"displacement": pair["q"], "velocity": pair["v"], "theta": theta, "speed": W}
    states = {"angle": phi, "rate": rate, "estimate": pair["seen"], "trend": pair["trend"]}
    found = block.evaluate(at, states)
    acceleration = trend + np.sqrt(2) * 2e4 * (v - v_seen)
    b, n, s = theta + phi + 0.2, np.exp(1j * (theta - 0.7)), (1 + np.cos(theta - 0.7)) / 2
    torque = -1e-3 * (np.exp(-1j * b) * (acceleration - 9.80665)).imag - s * 2e3 * (np.conj(n) * (q + 2e-5)).real
    twisting = torque / 0.005 - 2 * 0.03 * 500.0 * rate - 500.0**2 * phi
    assert float(found.derivatives["rate"]) == pytest.approx(twisting, rel=1e-12)
    force = 1e-3 * (((W + rate) ** 2 - 1j * twisting) * np.exp(1j * b) - W**2 * np.exp(1j * (theta + 0.2)))
    assert complex(*found.outputs["force"]) == pytest.approx(force - s * 2e3 * phi * n, rel=1e-12)
