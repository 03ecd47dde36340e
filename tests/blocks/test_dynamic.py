"""Blocks with states against scipy.signal and closed formulas."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import factorial
from typing import Any

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.blocks.evaluation import prepare, response_at, run_hits, state_space_of

rng = np.random.default_rng(2)
FREQUENCIES = [0.0, 0.3, 1.0, 7.0, 40.0]


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_integrator_integrates_every_entry(shape: tuple[int, ...]) -> None:
    value, start = rng.normal(size=shape), rng.normal(size=shape)
    prepared = prepare("integrator", {"input": shape}, {"initial": start})
    result = prepared.evaluate({"input": value})
    np.testing.assert_array_equal(prepared.initial["value"], start)
    np.testing.assert_array_equal(result.outputs["output"], start)
    np.testing.assert_array_equal(result.derivatives["value"], value)
    assert prepared.trace.feedthrough == {"output": ()}


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_derivative_is_a_filtered_derivative(frequency: float) -> None:
    system = state_space_of(prepare("derivative", {"input": ()}, {"time_constant": 0.02}), "input", "output")
    s = 1j * frequency
    np.testing.assert_allclose(response_at(system, frequency)[0, 0], s / (1 + 0.02 * s), rtol=1e-12, atol=1e-13)


def test_derivative_documents_its_error() -> None:
    ratio = 1 / (1 + 1j * 0.01)
    assert -np.angle(ratio) < 0.01
    assert abs(1 / (1 + 1j * 0.14)) > 0.99


coefficients = st.floats(-5, 5).filter(lambda v: abs(v) > 0.1)


@given(order=st.integers(1, 6), data=st.data())
@settings(max_examples=20, deadline=None)
def test_transfer_function_agrees_with_scipy(order: int, data: Any) -> None:
    denominator = data.draw(st.lists(coefficients, min_size=order + 1, max_size=order + 1))
    numerator = data.draw(st.lists(coefficients, min_size=1, max_size=order + 1))
    prepared = prepare(
        "transfer_function", {"input": ()}, {"numerator": numerator, "denominator": denominator}, {"order": order}
    )
    system = state_space_of(prepared, "input", "output")
    for frequency in FREQUENCIES[1:]:
        s = 1j * frequency
        below = np.polyval(denominator, s)
        if abs(below) < 1e-3:
            continue  # next to a pole both are ill-conditioned
        expected = scipy.signal.freqs(numerator, denominator, [frequency])[1][0]
        # C (s - A)^-1 B cancels to the size of its largest term
        scale = max(abs(numerator[0]), *(abs(v) * abs(s) ** k for k, v in enumerate(reversed(numerator)))) / abs(below)
        assert abs(response_at(system, frequency)[0, 0] - expected) <= 1e-9 * (scale + abs(expected) + 1)


def test_transfer_function_is_in_controllable_canonical_form() -> None:
    values = {"numerator": [3.0, 4.0], "denominator": [2.0, 5.0, 6.0, 8.0]}
    A, B, C, D = state_space_of(prepare("transfer_function", {"input": ()}, values, {"order": 3}), "input", "output")
    np.testing.assert_allclose(A, [[0, 1, 0], [0, 0, 1], [-4, -3, -2.5]])
    np.testing.assert_allclose(B, [[0], [0], [0.5]])
    np.testing.assert_allclose(C, [[4, 3, 0]])
    np.testing.assert_allclose(D, [[0]])


def test_transfer_function_without_feedthrough_breaks_loops() -> None:
    proper = prepare("transfer_function", {"input": ()})
    assert proper.trace.feedthrough == {"output": ()}
    biproper = prepare("transfer_function", {"input": ()}, {"numerator": [1.0, 0.0]})
    assert biproper.trace.feedthrough == {"output": ("input",)}


def test_transfer_function_refuses_what_is_not_proper() -> None:
    block = prepare("transfer_function", {"input": ()}).block
    values = {"numerator": np.ones(3), "denominator": np.array([0.0, 1.0])}
    assert block.check(values) == [
        "the numerator has 3 coefficients, but at most order + 1 = 2 are possible (a proper transfer function)",
        "the first coefficient of the denominator must not be 0 (lower the order instead)",
    ]


def test_state_space_is_itself() -> None:
    matrices = {"A": rng.normal(size=(3, 3)), "B": rng.normal(size=(3, 2)), "C": rng.normal(size=(4, 3))}
    matrices["D"] = rng.normal(size=(4, 2))
    found = state_space_of(prepare("linear_system", {"input": (2,)}, matrices), "input", "output")
    for value, expected in zip(found, matrices.values(), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-14)


def test_state_space_has_no_feedthrough_matrix_by_default() -> None:
    matrices = {"A": np.diag([-1.0, -2.0]), "B": [[1.0], [1.0]], "C": [[1.0, 0.0]], "initial": [3.0, 4.0]}
    prepared = prepare("linear_system", {"input": (1,)}, matrices)
    np.testing.assert_array_equal(prepared.evaluate({"input": [9.0]}).outputs["output"], [3.0])


def pade(order: int, s: complex) -> complex:
    """The diagonal Pade approximation of exp(-s) by its explicit coefficients."""
    n = order
    q = [
        factorial(2 * n - k) * factorial(n) / (factorial(2 * n) * factorial(k) * factorial(n - k)) for k in range(n + 1)
    ]
    return sum(c * (-s) ** k for k, c in enumerate(q)) / sum(c * s**k for k, c in enumerate(q))


@pytest.mark.parametrize("order", range(1, 9))
def test_delay_is_the_pade_approximation(order: int) -> None:
    time = 0.4
    system = state_space_of(prepare("delay", {"input": ()}, {"delay": time}, {"order": order}), "input", "output")
    assert system[0].shape == (order, order)
    for frequency in FREQUENCIES:
        found = response_at(system, frequency)[0, 0]
        assert abs(found - pade(order, 1j * frequency * time)) < 1e-9
        assert abs(abs(found) - 1) < 1e-12


@pytest.mark.parametrize(
    ("order", "limit"), list(zip(range(1, 9), [0.49, 1.52, 2.81, 4.24, 5.75, 7.33, 8.96, 10.62], strict=True))
)
def test_delay_keeps_the_accuracy_of_its_table(order: int, limit: float) -> None:
    system = state_space_of(prepare("delay", {"input": ()}, {"delay": 1.0}, {"order": order}), "input", "output")

    def error(frequency: float) -> float:
        return abs(response_at(system, frequency)[0, 0] - np.exp(-1j * frequency))

    assert max(error(w) for w in np.linspace(0.0, limit, 200)) <= 0.01
    assert error(limit + 0.02) > 0.01


@pytest.mark.parametrize(
    ("order", "limit"), list(zip(range(1, 9), [1.39, 0.81, 0.53, 0.38, 0.30, 0.25, 0.21, 0.19], strict=True))
)
def test_delay_documents_the_step_that_rk4_needs(order: int, limit: float) -> None:
    A, *_ = state_space_of(prepare("delay", {"input": ()}, {"delay": 1.0}, {"order": order}), "input", "output")

    def amplification(step: float) -> float:
        z = step * np.linalg.eigvals(A)
        return float(np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24).max())

    assert amplification(limit) <= 1
    assert amplification(limit + 0.01) > 1


@pytest.mark.parametrize("order", range(1, 9))
def test_delay_documents_its_leading_error(order: int) -> None:
    n = order
    q = [
        Fraction(factorial(2 * n - k) * factorial(n), factorial(2 * n) * factorial(k) * factorial(n - k))
        for k in range(n + 1)
    ]
    # coefficients of P(-s) - exp(-s) P(s); as P(0) = 1 the first that does not vanish is that of the error
    error = [
        (-1) ** m * (q[m] if m <= n else 0)
        - sum(q[k] * Fraction((-1) ** (m - k), factorial(m - k)) for k in range(min(m, n) + 1))
        for m in range(2 * n + 2)
    ]
    assert error[:-1] == [0] * (2 * n + 1)
    assert abs(error[-1]) == Fraction(factorial(n) ** 2, factorial(2 * n) * factorial(2 * n + 1))


@pytest.mark.parametrize("order", range(1, 9))
def test_delay_at_rest_passes_its_initial_value(order: int) -> None:
    prepared = prepare("delay", {"input": (2,)}, {"initial": [3.0, -1.0]}, {"order": order})
    result = prepared.evaluate({"input": [3.0, -1.0]})
    np.testing.assert_allclose(result.outputs["output"], [3.0, -1.0], rtol=1e-15)
    for rate in result.derivatives.values():
        np.testing.assert_array_equal(rate, [0.0, 0.0])


@pytest.mark.parametrize("samples", range(1, 9))
def test_unit_delay_gives_old_samples(samples: int) -> None:
    prepared = prepare("unit_delay", {"input": (2,)}, {"initial": -7.0}, {"samples": samples})
    values = rng.normal(size=(12, 2))
    found = np.array([o["output"] for o in run_hits(prepared, [{"input": v} for v in values])])
    expected = np.concatenate([np.full((samples, 2), -7.0), values])[: len(values)]
    np.testing.assert_array_equal(found, expected)
    assert prepared.trace.feedthrough == {"output": ()}
    assert prepared.trace.hit_feedthrough == {"output": ()}


def test_sample_hold_gives_the_newest_sample() -> None:
    prepared = prepare("sample_hold", {"input": ()}, {"initial": 5.0})
    assert prepared.evaluate({"input": 1.0}).outputs["output"] == 5.0
    found = [float(o["output"]) for o in run_hits(prepared, [{"input": v} for v in (1.0, 2.0, 3.0)])]
    assert found == [1.0, 2.0, 3.0]
    assert prepared.trace.feedthrough == {"output": ()}
    assert prepared.trace.hit_feedthrough == {"output": ("input",)}


def test_noise_scales_its_draws() -> None:
    prepared = prepare("noise", parameters={"mean": [1.0, 2.0], "standard_deviation": 3.0})
    np.testing.assert_array_equal(prepared.evaluate().outputs["output"], [1.0, 2.0])
    found = run_hits(prepared, [{"draw": [0.0, -1.0]}, {"draw": [0.5, 2.0]}])
    np.testing.assert_array_equal([o["output"] for o in found], [[1.0, -1.0], [2.5, 8.0]])
    assert prepared.block.randoms["draw"].seed == "seed"


@pytest.mark.parametrize("type_name", ["unit_delay", "sample_hold", "noise", "discrete_pid"])
def test_discrete_blocks_name_their_sample_time(type_name: str) -> None:
    inputs = {"displacement": (2,)} if type_name == "discrete_pid" else {} if type_name == "noise" else {"input": ()}
    assert prepare(type_name, inputs).block.sample_time == "sample_time"


@pytest.mark.parametrize(("input_value", "rate"), [(0.05, 10.0), (5.0, 20.0), (-5.0, -30.0)])
def test_rate_limiter_limits_the_rate(input_value: float, rate: float) -> None:
    values = {"rising": 20.0, "falling": -30.0, "time_constant": 0.01}
    prepared = prepare("rate_limiter", {"input": ()}, values)
    assert prepared.evaluate({"input": input_value}).derivatives["value"] == pytest.approx(rate, rel=1e-15)


def limited(input_at: Callable[[float], float], step: float, time_constant: float, rate: float) -> np.ndarray:
    """Return the output of a rate limiter for a second, by RK4, from value and past at the first input."""
    prepared = prepare(
        "rate_limiter", {"input": ()}, {"rising": rate, "falling": -rate, "time_constant": time_constant}
    )

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        found = prepared.evaluate({"input": input_at(t)}, dict(zip(("value", "past"), x, strict=True))).derivatives
        return np.array([found["value"], found["past"]])

    x, out = np.full(2, input_at(0.0)), []
    for t in np.arange(round(1 / step)) * step:
        out.append(x[0])
        k1 = rates(t, x)
        k2 = rates(t + step / 2, x + step / 2 * k1)
        k3 = rates(t + step / 2, x + step / 2 * k2)
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + rates(t + step, x + step * k3))
    return np.array(out)


def test_rate_limiter_below_its_limits_is_wrong_by_the_square_of_its_time_constant() -> None:
    """FAULT: a lag of half a sample in front of a servo was taken out of the servo's own, by 19 standard deviations."""
    time, found = np.arange(100) / 100, limited(lambda t: np.sin(2 * t), 0.01, 0.005, 10.0)
    assert np.abs(found - np.sin(2 * time))[15:].max() < 2 * 0.005**2 * 2**2  # of a lag 0.005 * 2: fifty times that


def test_rate_limiter_follows_a_jump_at_its_limit_from_the_first_instant() -> None:
    time, found = np.arange(100) / 100, limited(lambda t: 5.0 * (t > 0), 0.01, 0.005, 10.0)
    ramp = (time > 0.02) & (time < 0.45)
    np.testing.assert_allclose(np.diff(found[ramp]), 0.1, rtol=1e-12)
    assert np.abs(found[ramp] - 10.0 * time[ramp]).max() < 0.05  # half a sample, of which RK4 sees the jump
    assert found.max() < 5.0 + 1e-9


def test_rate_limiter_that_cannot_move_is_refused() -> None:
    block = prepare("rate_limiter", {"input": ()}).block
    values = {"rising": np.array(0.0), "falling": np.array(0.0)}
    assert block.check(values) == ["rising and falling are both 0: the output could never move"]
