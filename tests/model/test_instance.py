"""The time loop: C against CasADi's virtual machine, hits, noise, order, loops."""

import numpy as np
import pytest

from rotorsim.model.compiled import compile_diagram
from rotorsim.model.instance import make_instance, normal_draws
from rotorsim.model.load import load
from rotorsim.model.trace.diagram import trace_diagram
from rotorsim.simulation.run import simulate
from tests.model.documents import document, oscillator, sampled


def exact_oscillator(t: np.ndarray) -> np.ndarray:
    """Return the closed form of x'' + 2 x' + 100 x = cos(5 t + 1), x(0) = 0.25, x'(0) = 0."""
    h = 1 / (100 - 25 + 10j)
    particular = h * np.exp(1j * (5 * t + 1))
    x0, v0 = 0.25 - (h * np.exp(1j)).real, -(5j * h * np.exp(1j)).real
    wd = np.sqrt(99.0)
    return particular.real + np.exp(-t) * (x0 * np.cos(wd * t) + (v0 + x0) / wd * np.sin(wd * t))


def test_rk4_has_order_four_against_the_closed_form():
    diagram = load(oscillator())
    errors = []
    for step in (0.02, 0.01, 0.005):
        result = simulate(diagram, step=step, stop=2.0)
        errors.append(np.abs(result["position.output"] - exact_oscillator(result.time)).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("method", ["dop853", "radau", "lsoda"])
def test_adaptive_methods_agree_with_the_closed_form(method):
    result = simulate(load(oscillator()), method=method, step=0.01, stop=2.0)
    assert np.abs(result["position.output"] - exact_oscillator(result.time)).max() < 2e-7


@pytest.mark.slow
def test_the_virtual_machine_gives_what_c_gives():
    for made, record in ((oscillator(), 2), (sampled(3.7e-3), 3)):
        diagram = load(made)
        fast = simulate(diagram, stop=0.5)
        slow = simulate(diagram, stop=0.5, use_compiler=False)
        assert "virtual machine" in slow.provenance["path"]
        assert len(fast.signals) == record
        for name, values in fast.signals.items():
            assert np.allclose(values, slow[name], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("period", [5e-3, 3.3e-3, 2.5e-4, np.pi * 1e-3])
def test_sample_hits_are_met_exactly_whatever_the_step(period):
    result = simulate(load(sampled(period)), stop=0.2)
    last_hit = np.floor(result.time / period + 1e-9) * period
    assert np.abs(result["hold.output"] - last_hit).max() < 1e-12


def test_noise_is_held_seeded_normal_and_white():
    made = sampled(1e-3, 1e-3)
    noise = simulate(load(made), stop=20.0)["noise.output"][:-1]
    assert simulate(load(made), stop=20.0)["noise.output"][:-1] == pytest.approx(noise, abs=0)
    made["blocks"]["noise"]["parameters"]["seed"] = 8
    other = simulate(load(made), stop=20.0)["noise.output"][:-1]
    n = len(noise)
    bound = 4 / np.sqrt(n)  # four standard errors
    assert abs(noise.mean()) < 0.5 * bound
    assert abs(noise.std() / 0.5 - 1) < bound
    assert abs(np.mean((noise / 0.5) ** 4) - 3) < 4 * np.sqrt(96 / n)
    for shifted in (np.roll(noise, 1), np.roll(noise, 7), other):
        assert abs(np.corrcoef(noise, shifted)[0, 1]) < bound


def test_draws_of_c_and_python_are_the_same_generator():
    result = simulate(load(sampled(1e-3, 1e-3)), stop=0.01)
    drawn = [0.5 * normal_draws(7, k, 1)[0] for k in range(len(result.time))]
    assert result["noise.output"] == pytest.approx(drawn, rel=1e-12)


def test_a_cascade_at_one_hit_sees_new_values_downstream_and_a_delay_sees_old_ones():
    made = document(
        {
            "ramp": ("ramp", {"slope": 1.0}),
            "second": ("sample_hold", {"sample_time": 0.01}),
            "first": ("sample_hold", {"sample_time": 0.01}),
            "late": ("unit_delay", {"sample_time": 0.01}),
            "state": ("integrator", {}),
        },
        [
            ["ramp.output", "first.input"],
            ["first.output", "second.input"],
            ["first.output", "late.input"],
            ["late.output", "state.input"],
        ],
        ["first.output", "second.output", "late.output"],
    )
    result = simulate(load(made), stop=0.1)
    held = np.floor(result.time / 0.01 + 1e-9) * 0.01
    assert np.abs(result["second.output"] - held).max() < 1e-12
    assert np.abs(result["late.output"] - np.maximum(held - 0.01, 0)).max() < 1e-12


def loop(kind, values, gain):
    """Return y = u + gain f(y), an algebraic loop."""
    return document(
        {
            "u": ("sine", {"frequency": 3.0}),
            "y": ("sum", {}),
            "f": (kind, values),
            "feedback": ("gain", {"gain": gain}),
            "state": ("integrator", {}),
        },
        [
            ["u.output", "y.input1"],
            ["feedback.output", "y.input2"],
            ["y.output", "f.input"],
            ["f.output", "feedback.input"],
            ["y.output", "state.input"],
        ],
        ["u.output", "y.output"],
        algebraic_loops="solve",
    )


def test_a_linear_algebraic_loop_is_solved_exactly():
    result = simulate(load(loop("gain", {"gain": 2.0}, -3.0)))
    assert np.abs(result["y.output"] - result["u.output"] / 7.0).max() < 1e-15


def test_a_nonlinear_algebraic_loop_is_solved_by_newton():
    result = simulate(load(loop("math_function", {"function": "tanh"}, -3.0)))
    y, u = result["y.output"], result["u.output"]
    assert np.abs(y + 3 * np.tanh(y) - u).max() < 1e-12


def test_inject_adds_to_a_port_and_replace_opens_the_loop():
    diagram = load(oscillator())
    for keyword, expected in (("inject", [-100.0, -2.0]), ("replace", [0.0, -2.0])):
        trace = trace_diagram(diagram, **{keyword: ("spring.output",)})
        model = compile_diagram(diagram, **{keyword: ("spring.output",)})
        row = np.array(model.jacobian(0.0, np.zeros(2), np.zeros(0), model.p0))[0]
        order = list(trace.states).index("velocity.value")
        assert trace.v.numel() == 1
        found = row if order == 0 else np.array(model.jacobian(0.0, np.zeros(2), np.zeros(0), model.p0))[1]
        by_name = {name: found[s.part][0] for name, s in trace.states.items()}
        assert [by_name["position.value"], by_name["velocity.value"]] == expected


def test_batched_right_hand_sides_equal_single_ones():
    model = compile_diagram(load(oscillator()))
    rng = np.random.default_rng(0)
    t, x = rng.normal(size=5), rng.normal(size=(5, 2))
    p = np.repeat(model.p0[None], 5, 0)
    p[3] *= 1.5
    single = [np.array(model.rhs(t[k], x[k], np.zeros(0), p[k])).ravel() for k in range(5)]
    assert np.allclose(model.rhs_batch(t, x, np.zeros(0), p), single, rtol=1e-13)


def test_one_instance_does_not_disturb_another():
    model = compile_diagram(load(oscillator()))
    names = model.record_names()
    one, two = (make_instance(model, names, model.p0) for _ in range(2))
    rows = np.empty((100, 2))
    one.start(0.0)
    one.run(0, 50, 0.0, 1e-3, 1, rows)
    assert two.x == pytest.approx(model.x0(), abs=0)
