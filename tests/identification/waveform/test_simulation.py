"""The simulation of sampled runs: exact derivatives, order of the method, inputs between samples, subsystems."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rotorsim.errors import RotorsimError
from rotorsim.identification.waveform.driven.equations import DrivenEquations, ForceMap, driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation, _source
from rotorsim.identification.waveform.recorded.data import RATE_PREFIX, SampledRun, between_samples, channels_of
from rotorsim.identification.waveform.subsystems import subsystems_of
from rotorsim.model.emit import toolchain
from rotorsim.model.load import load
from tests.diagnosis.evidence.waveform.machines import OSCILLATOR, POSITIONER, carriage_recording

DT = 0.02
DUFFING = {
    **OSCILLATOR,
    "blocks": {**OSCILLATOR["blocks"], "spring": {"type": "cubic_stiffness", "parameters": {"stiffness": 2e4}}},
    "wires": [
        *OSCILLATOR["wires"],
        ["oscillator.displacement", "spring.displacement"],
        ["spring.force", "oscillator.force"],
    ],
    "identify": {**OSCILLATOR["identify"], "spring.stiffness": {}},
}
START = np.array([0.02, -0.3])


def force(t):
    return 40 * np.sin(31 * t) + 20 * np.sin(11 * t + 1)


def inputs(samples: int, sub: int) -> np.ndarray:
    parts = np.arange(2 * sub + 1) / (2 * sub)
    return force((np.arange(samples)[:, None] + parts) * DT)[:, :, None]


@pytest.fixture(scope="module")
def equations() -> DrivenEquations:
    diagram = load(DUFFING)
    return driven_equations(diagram, ["oscillator.displacement", "oscillator.velocity"], ["drive.output"], diagram.free)


def parameters(equations: DrivenEquations, theta: np.ndarray) -> np.ndarray:
    return equations.parameters(equations.model.p0, theta)


def theta_of(equations: DrivenEquations) -> np.ndarray:
    return np.array([item.value for item in equations.free])


@pytest.mark.parametrize("compiled", [True, False])
def test_without_derivatives_the_outputs_are_the_same_and_the_code_is_less(equations, compiled):
    p, v = parameters(equations, theta_of(equations)), inputs(50, 1)
    plain = Simulation(equations, use_compiler=compiled, sensitive=False)
    y, dy = plain.simulate(p, START, v, DT)
    np.testing.assert_array_equal(y, Simulation(equations, use_compiler=compiled).simulate(p, START, v, DT)[0])
    assert dy.shape == (50, 2, 0)
    assert ["jac[0] = " in _source(equations, count)[0] for count in (0, 6)] == [False, True]


def test_the_instructions_of_this_processor_change_no_digit(equations, monkeypatch):
    p, v = parameters(equations, theta_of(equations)), inputs(500, 1)
    y, dy = Simulation(equations).simulate(p, START, v, DT)
    monkeypatch.setattr(toolchain, "_instructions", lambda compiler: "")
    portable, by_them = Simulation(equations).simulate(p, START, v, DT)
    np.testing.assert_array_equal(y, portable)
    np.testing.assert_array_equal(dy, by_them)


def test_the_error_falls_with_the_fourth_power_of_the_step(equations):
    simulation, theta = Simulation(equations), theta_of(equations)
    mass, damping, stiffness, cubic = theta

    def rates(t, x):
        return x[1], (force(t) - damping * x[1] - stiffness * x[0] - cubic * x[0] ** 3) / mass

    times = np.arange(150) * DT
    exact = solve_ivp(rates, (0, times[-1]), START, t_eval=times, rtol=1e-11, atol=1e-13, method="DOP853").y.T
    errors = []
    for sub in (2, 4, 8):
        y, _ = simulation.simulate(parameters(equations, theta), START, inputs(150, sub), DT, sensitivities=False)
        errors.append(np.abs(y - exact).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.5)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4, abs=0.5)


@pytest.mark.parametrize("use_compiler", [True, False])
def test_uneven_instants_are_met_with_the_same_order(equations, use_compiler):
    simulation, theta = Simulation(equations, use_compiler=use_compiler), theta_of(equations)
    mass, damping, stiffness, cubic = theta

    def rates(t, x):
        return x[1], (force(t) - damping * x[1] - stiffness * x[0] - cubic * x[0] ** 3) / mass

    steps = np.random.default_rng(0).uniform(0.2, 1.8, 99) * DT
    times = 0.3 + np.append(0.0, np.cumsum(steps))
    exact = solve_ivp(rates, (0.3, times[-1]), START, t_eval=times, rtol=1e-11, atol=1e-13, method="DOP853").y.T
    errors = []
    for sub in (4, 8):
        at = times[:, None] + np.append(steps, 0.0)[:, None] * np.arange(2 * sub + 1) / (2 * sub)
        p, v = parameters(equations, theta), force(at)[:, :, None]
        y, _ = simulation.simulate(p, START, v, steps, t0=0.3, sensitivities=False)
        errors.append(np.abs(y - exact).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.5)


def test_derivatives_are_those_of_the_steps(equations):
    simulation, theta = Simulation(equations), theta_of(equations)
    v = inputs(200, 2)
    _, derivatives = simulation.simulate(parameters(equations, theta), START, v, DT)
    for j in range(len(theta) + 2):
        step = 1e-6 * (theta[j] if j < len(theta) else 1.0)
        ends = []
        for sign in (1, -1):
            moved, start = theta.copy(), START.copy()
            (moved if j < len(theta) else start)[j if j < len(theta) else j - len(theta)] += sign * step
            ends.append(simulation.simulate(parameters(equations, moved), start, v, DT, sensitivities=False)[0])
        expected = (ends[0] - ends[1]) / (2 * step)
        assert np.abs(derivatives[:, :, j] - expected).max() < 1e-6 * np.abs(expected).max()


def test_the_virtual_machine_gives_the_same_without_a_compiler(equations):
    theta, v = theta_of(equations), inputs(300, 3)
    plain = Simulation(equations, use_compiler=False)
    compiled = Simulation(equations)
    for sensitivities in (True, False):
        a = plain.simulate(parameters(equations, theta), START, v, DT, sensitivities=sensitivities)
        b = compiled.simulate(parameters(equations, theta), START, v, DT, sensitivities=sensitivities)
        assert np.abs(a[0] - b[0]).max() <= 1e-12 * np.abs(b[0]).max()
        assert a[1].shape == b[1].shape == (300, 2, 6 if sensitivities else 0)
        if sensitivities:
            size = np.abs(b[1]).max(axis=(0, 1))
            assert (np.abs(a[1] - b[1]).max(axis=(0, 1)) <= 1e-11 * size).all()


@pytest.mark.parametrize("use_compiler", [True, False])
def test_samples_after_a_divergence_are_not_numbers(equations, use_compiler):
    theta = theta_of(equations)
    theta[3] = -2e4  # softening: it runs away
    simulation = Simulation(equations, use_compiler=use_compiler)
    y, derivatives = simulation.simulate(parameters(equations, theta), np.array([0.5, 0.0]), inputs(400, 4), DT)
    gone = np.isnan(y).any(axis=1)
    assert gone[-1]
    assert not gone[0]
    assert (gone == np.isnan(derivatives).any(axis=(1, 2))).all()
    assert (np.diff(gone.astype(int)) >= 0).all()


def test_a_flexible_force_has_exact_derivatives():
    diagram = load(OSCILLATOR)
    law = ForceMap("oscillator.force", "oscillator.displacement", "oscillator.velocity", (0.5, 15.0))
    equations = driven_equations(diagram, ["oscillator.displacement"], ["drive.output"], diagram.free, force=law)
    assert equations.m == 3 + law.count
    simulation, v = Simulation(equations), inputs(120, 2)
    theta = np.concatenate([theta_of(equations), np.linspace(-1, 1, law.count)])
    _, derivatives = simulation.simulate(parameters(equations, theta), START, v, DT)
    for j in (3, 5, 12, equations.m - 1):
        ends = []
        for sign in (1, -1):
            moved = theta.copy()
            moved[j] += sign * 1e-2
            ends.append(simulation.simulate(parameters(equations, moved), START, v, DT, sensitivities=False)[0])
        expected = (ends[0] - ends[1]) / 2e-2
        assert np.abs(derivatives[:, :, j] - expected).max() < 1e-6 * np.abs(expected).max()


def test_band_limited_values_lie_on_the_curve_that_was_sampled():
    n = np.arange(401)
    found = between_samples(np.cos(0.3 * np.pi * n), "band_limited", 4)
    at = n[:, None] + np.arange(5) / 4
    assert found.shape == (401, 5)
    assert np.abs(found - np.cos(0.3 * np.pi * at))[5:-5].max() < 0.02
    whole = np.cos(np.pi * 20 * n / 400)  # meets its mirror image smoothly: exact
    found = between_samples(whole, "band_limited", 4)
    assert found[:, 0] == pytest.approx(whole, abs=1e-12)


def test_a_held_value_and_a_straight_line():
    values = np.array([1.0, 3.0, 2.0])
    assert between_samples(values, "hold", 2).tolist() == [[1, 1, 1], [3, 3, 3], [2, 2, 2]]
    assert between_samples(values, "linear", 2).tolist() == [[1, 2, 3], [3, 2.5, 2], [2, 2, 2]]


def test_the_rate_of_a_measured_signal():
    t = np.arange(200) * DT
    run = SampledRun("run", {"a": np.sin(3 * t)}, {}, t, {})
    found = run.inputs((RATE_PREFIX + "a",), 1)[:-1, :, 0]
    at = (np.arange(199)[:, None] + np.arange(3) / 2) * DT
    assert np.abs(found - 3 * np.cos(3 * at)).max() < 1e-4


def test_a_controller_with_measured_inputs_is_a_subsystem_of_its_own():
    diagram = load(POSITIONER)
    systems = subsystems_of(diagram, channels_of(diagram, carriage_recording(1.0)))
    assert [system.name for system in systems] == ["", "controller"]
    cell = systems[1].equations
    assert cell.outputs == ("controller.voltage",)
    assert set(cell.inputs) == {"reference.output", "carriage.displacement", RATE_PREFIX + "carriage.displacement"}
    assert cell.state_names == ("controller.observed",)


def test_an_acceleration_is_the_rate_of_the_velocity():
    diagram = load(OSCILLATOR)
    names = ["oscillator.acceleration", "oscillator.velocity"]
    equations = driven_equations(diagram, names, ["drive.output"], diagram.free)
    theta = np.array([2.0, 3.0, 900.0])
    y, _ = Simulation(equations).simulate(parameters(equations, theta), START, inputs(3, 1), DT, sensitivities=False)
    assert y[0] == pytest.approx([(force(0.0) - 3.0 * START[1] - 900.0 * START[0]) / 2.0, START[1]], rel=1e-12)


def test_sampled_blocks_are_refused():
    document = {**OSCILLATOR, "blocks": {**OSCILLATOR["blocks"], "hold": {"type": "unit_delay"}}}
    document["wires"] = [["drive.output", "hold.input"], ["hold.output", "oscillator.force"]]
    diagram = load(document)
    with pytest.raises(RotorsimError) as caught:
        driven_equations(diagram, ["oscillator.displacement"], ["drive.output"], diagram.free)
    assert "hold: a comparison in time needs continuous blocks; this one has a sample time" in str(caught.value)
