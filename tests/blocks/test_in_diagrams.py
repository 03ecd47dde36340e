"""Sampled, delayed and random blocks inside running diagrams, against recursions written out in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.signal

from rotorsim.model.load import load
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate

STEP = 1e-3


def run(blocks: dict[str, Any], wires: list[list[str]], record: list[str], stop: float = 0.2, **solver: Any) -> Result:
    settings = {"method": "rk4", "step": STEP, "stop": stop} | solver
    document = {"schema_version": 1, "name": "test", "blocks": blocks, "wires": wires, "solver": settings}
    result = simulate(load(document | {"record": record}))
    assert result.status == "finished"
    return result


WAVE = {"type": "sine", "parameters": {"frequency": "7 Hz", "amplitude": [1.0, -2.0], "phase": "20 deg"}}


@pytest.mark.parametrize("samples", [0, 1, 4])
def test_sampled_signals_change_at_hits_only(samples: int) -> None:
    sampled = {"type": "unit_delay", "parameters": {"samples": samples}} if samples else {"type": "sample_hold"}
    sampled["parameters"] = {**sampled.get("parameters", {}), "sample_time": "10 ms", "initial": 9.0}
    result = run({"wave": WAVE, "line": sampled}, [["wave.output", "line.input"]], ["wave.output", "line.output"])
    wave, found = result.signals["wave.output"], result.signals["line.output"]
    hits = np.arange(len(wave)) // 10 * 10 - 10 * samples
    expected = np.where(hits[:, None] >= 0, wave[hits], 9.0)
    np.testing.assert_array_equal(found, expected)


def test_a_unit_delay_breaks_a_loop() -> None:
    """y[k] = u[k] + 0.8 y[k - 1] at every hit."""
    blocks = {
        "wave": {"type": "sine", "parameters": {"frequency": "7 Hz"}},
        "hold": {"type": "sample_hold", "parameters": {"sample_time": "2 ms"}},
        "sum": {"type": "sum"},
        "memory": {"type": "unit_delay", "parameters": {"sample_time": "2 ms"}},
        "gain": {"type": "gain", "parameters": {"gain": 0.8}},
    }
    wires = [
        ["wave.output", "hold.input"],
        ["hold.output", "sum.input1"],
        ["gain.output", "sum.input2"],
        ["sum.output", "memory.input"],
        ["memory.output", "gain.input"],
    ]
    result = run(blocks, wires, ["wave.output", "sum.output"])
    wave, found = (result.signals[name][::2] for name in ("wave.output", "sum.output"))
    np.testing.assert_allclose(found, scipy.signal.lfilter([1], [1, -0.8], wave), rtol=1e-12, atol=1e-14)


def test_discrete_pid_holds_a_mass_like_its_recursion() -> None:
    """A free mass under a held force moves in parabolas, which RK4 follows exactly."""
    T, m, k_i = 5e-3, 2.0, 42.1
    gains = {"KP": 60.0, "KI": 200.0, "KD": 3.0}
    blocks = {
        "force": {"type": "gain", "parameters": {"gain": -k_i / m}},
        "velocity": {"type": "integrator"},
        "displacement": {"type": "integrator", "parameters": {"initial": [1e-3, -2e-3]}},
        "controller": {
            "type": "discrete_pid",
            "parameters": {**gains, "sample_time": T, "derivative_time_constant": T},
        },
    }
    blocks["controller"]["parameters"]["initial_displacement"] = [1e-3, -2e-3]
    wires = [
        ["displacement.output", "controller.displacement"],
        ["controller.current", "force.input"],
        ["force.output", "velocity.input"],
        ["velocity.output", "displacement.input"],
    ]
    result = run(blocks, wires, ["displacement.output", "controller.current"], stop=1.0)
    u, v = np.array([1e-3, -2e-3]), np.zeros(2)
    previous, integral, rate, waiting = u, np.zeros(2), np.zeros(2), np.zeros(2)
    expected = []
    for _ in range(201):
        integral = integral + T * u
        rate, previous = (T * rate + u - previous) / (2 * T), u
        current, waiting = waiting, gains["KP"] * u + gains["KI"] * integral + gains["KD"] * rate
        expected.append([u, current])
        a = -k_i / m * current
        u, v = u + T * v + T**2 / 2 * a, v + T * a
    table = np.array(expected)
    every = round(T / STEP)
    assert np.abs(table[-1, 0]).max() < 1e-3  # the loop is stable: the recursion does not blow errors up
    np.testing.assert_allclose(result.signals["displacement.output"][::every], table[:, 0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(result.signals["controller.current"][::every], table[:, 1], rtol=0, atol=1e-10)


def test_the_pade_delay_converges_with_the_order_of_rk4() -> None:
    delay, frequency = 0.03, 2 * np.pi * 7
    errors = []
    for step in (2e-3, 1e-3):
        blocks = {
            "wave": {"type": "sine", "parameters": {"frequency": frequency}},
            "delay": {"type": "delay", "parameters": {"delay": delay, "order": 8}},
        }
        result = run(blocks, [["wave.output", "delay.input"]], ["delay.output"], stop=1.0, step=step)
        settled = result.time > 0.5
        expected = np.sin(frequency * (result.time - delay))
        errors.append(np.abs(result.signals["delay.output"] - expected)[settled].max())
    assert errors[0] / errors[1] > 2**3.5


def test_transfer_function_answers_a_step_like_scipy() -> None:
    numerator, denominator = [3.0, 40.0], [1.0, 4.0, 130.0, 200.0]
    values = {"order": 3, "numerator": numerator, "denominator": denominator}
    blocks = {"one": {"type": "constant"}, "filter": {"type": "transfer_function", "parameters": values}}
    result = run(blocks, [["one.output", "filter.input"]], ["filter.output"], stop=2.0)
    _, expected = scipy.signal.step((numerator, denominator), T=result.time)
    # global error of RK4: step^4 times the fifth power of the fastest pole (11.4 rad/s), over 2 s
    np.testing.assert_allclose(result.signals["filter.output"], expected, rtol=0, atol=2.0 * STEP**4 * 11.5**5)


def test_noise_is_white_normal_and_fixed_by_its_seed() -> None:
    def noise(seed: int) -> np.ndarray:
        values = {"mean": [5.0, 0.0], "standard_deviation": 2.0, "sample_time": STEP, "seed": seed}
        return run({"noise": {"type": "noise", "parameters": values}}, [], ["noise.output"], stop=20.0).signals[
            "noise.output"
        ]

    first, again, other = noise(1), noise(1), noise(2)
    np.testing.assert_array_equal(first, again)
    n = len(first)
    draws = (first - [5.0, 0.0]) / 2.0
    limit = 4 / np.sqrt(n)  # four standard errors
    assert np.all(np.abs(draws.mean(axis=0)) < limit)
    assert np.all(np.abs(draws.var(axis=0) - 1) < limit * np.sqrt(2))
    assert abs(np.mean(draws[:, 0] * draws[:, 1])) < limit
    assert np.all(np.abs(np.mean(draws[1:] * draws[:-1], axis=0)) < limit)
    assert abs(np.mean(draws * (other - [5.0, 0.0]) / 2.0)) < limit


def test_a_bus_joins_shapes_and_a_scope_records() -> None:
    blocks = {
        "wave": WAVE,
        "angle": {"type": "ramp", "parameters": {"slope": 10.0}},
        "reference": {"type": "reference", "parameters": {"harmonics": [1, -2, 3]}},
        "bus": {"type": "bus", "parameters": {"names": ["reference", "wave"]}},
        "scope": {"type": "scope", "parameters": {"names": ["all"]}},
    }
    wires = [
        ["angle.output", "reference.theta"],
        ["reference.signal", "bus.reference"],
        ["wave.output", "bus.wave"],
        ["bus.output", "scope.all"],
    ]
    result = run(blocks, wires, ["wave.output"])
    turned = np.exp(1j * np.array([1, -2, 3]) * 10.0 * result.time[:, None])
    pairs = np.stack([turned.real, turned.imag], axis=-1).reshape(len(turned), 6)
    expected = np.hstack([pairs, result.signals["wave.output"]])
    np.testing.assert_allclose(result.signals["bus.output"], expected, rtol=0, atol=1e-13)


def test_a_selector_outside_its_input_is_refused_by_name() -> None:
    from rotorsim.errors import RotorsimError

    blocks = {"wave": WAVE, "pick": {"type": "selector", "parameters": {"indices": [3]}}}
    with pytest.raises(RotorsimError) as caught:
        run(blocks, [["wave.output", "pick.input"]], ["pick.output"])
    assert "pick" in str(caught.value)
    assert "index 3 of indices is outside the input, which has 2 entries" in str(caught.value)
