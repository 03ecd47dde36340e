"""Blocks whose output depends on the past: play and hysteresis, against closed forms and the play operator."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.blocks.evaluation import Prepared, prepare


def followed(prepared: Prepared, inputs, state: str, times: np.ndarray, longest: float = np.inf) -> np.ndarray:
    """Return the state of a block at some instants by LSODA; inputs: {port: function of time}."""

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        given = {port: np.asarray(law(t)) for port, law in inputs.items()}
        return np.atleast_1d(prepared.evaluate(given, states={state: x[0]}).derivatives[state])

    x0, span = np.atleast_1d(prepared.initial[state]), (times[0], times[-1])
    return solve_ivp(rate, span, x0, "LSODA", times, rtol=1e-8, atol=1e-9, max_step=longest).y[0]


# --- play -------------------------------------------------------------------------------------------------------------


def test_play_waits_for_the_flank_and_then_lags() -> None:
    """On a ramp r t the flank is met at t0 = width / (2 r); then value = r (s - T (1 - exp(-s / T))), s = t - t0."""
    r, width, T = 2.0, 0.6, 0.05
    prepared = prepare("play", {"input": ()}, {"width": width, "time_constant": T})
    times = np.linspace(0, 0.6, 301)
    value = followed(prepared, {"input": lambda t: r * t}, "value", times, 0.01)
    s = np.maximum(times - width / (2 * r), 0.0)
    np.testing.assert_allclose(value, r * (s - T * (1 - np.exp(-s / T))), atol=1e-6)


def play_operator(u: np.ndarray, width: float) -> np.ndarray:
    """Return the play operator of samples: w_i = min(max(w_(i-1), u_i - width / 2), u_i + width / 2)."""
    w, out = 0.0, []
    for value in u:
        w = min(max(w, value - width / 2), value + width / 2)
        out.append(w)
    return np.array(out)


@pytest.mark.slow
@given(width=st.floats(0.05, 1.5), seed=st.integers(0, 1000))
@settings(max_examples=5, deadline=None)
def test_play_is_the_play_operator_but_for_its_lag(width: float, seed: int) -> None:
    rng, T = np.random.default_rng(seed), 4e-3
    f, phase = rng.uniform(0.2, 1.0, 3), rng.uniform(0, 7, 3)

    def u(t):
        return (np.sin(2 * np.pi * np.multiply.outer(t, f) + phase) - np.sin(phase)).sum(axis=-1)

    prepared = prepare("play", {"input": ()}, {"width": width, "time_constant": T})
    times = np.linspace(0, 2.0, 1001)
    value = followed(prepared, {"input": u}, "value", times, 0.01)
    fastest = 2 * np.pi * f.sum()
    apart = np.abs(value - play_operator(u(times), width)).max()
    assert apart <= T * fastest + fastest * 2e-3  # the lag, and a sample of the operator


def test_play_in_a_diagram_keeps_what_it_has() -> None:
    document = {
        "schema_version": 1,
        "name": "gear",
        "blocks": {
            "drive": {"type": "sine", "parameters": {"amplitude": 1.0, "frequency": 1.0}},
            "play": {"type": "play", "parameters": {"width": 0.5, "time_constant": "1 ms"}},
        },
        "wires": [["drive.output", "play.input"]],
        "solver": {"step": "0.5 ms", "stop": "20 s"},
        "record": ["drive.output", "play.output"],
    }
    found = simulate(load(document))
    u, w = found["drive.output"], found["play.output"]
    acceleration = np.abs(np.diff(u, 2)).max() / 5e-4**2
    assert np.abs(w - play_operator(u, 0.5)).max() < 1.1 * 1e-3**2 * acceleration  # the square of the time constant
    assert w.max() == pytest.approx(0.75, abs=1e-5)


def test_hysteresis_is_a_share_of_play() -> None:
    for share in (0.3, -0.6):
        values = {"width": 0.5, "share": share}
        for u, value in ((1.0, 0.2), (0.4, 0.2), (-0.3, 0.2)):
            held, out = (
                prepare("play", {"input": ()}, values, {"law": law}).evaluate(
                    {"input": u}, {"value": np.asarray(value)}
                )
                for law in ("play", "hysteresis")
            )
            assert held.outputs["output"] == pytest.approx(min(max(value, u - 0.25), u + 0.25))
            assert out.outputs["output"] == pytest.approx(u + share * (held.outputs["output"] - u))


# --- integrator with limits -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_limited_integrator_stops_and_leaves_its_limit_at_once() -> None:
    """Input 2 up to t = 1, then -1: 2 t up to the limit 0.8, and 0.8 - (t - 1 - d) after it; d <= 2 time constants."""
    T = 2e-3
    values = {"lower": -0.3, "upper": 0.8, "time_constant": T}
    prepared = prepare("limited_integrator", {"input": ()}, values)
    times = np.linspace(0, 3, 601)
    value = followed(prepared, {"input": lambda t: 2.0 if t < 1 else -1.0}, "value", times, 0.5e-3)
    out = np.array(
        [prepared.evaluate({"input": 0.0}, states={"value": np.asarray(v)}).outputs["output"] for v in value]
    )
    expected = np.clip(np.where(times < 1, np.minimum(2 * times, 0.8), 0.8 - (times - 1)), -0.3, 0.8)
    assert np.abs(out - expected).max() <= 2 * T
    assert out.max() == 0.8
    assert out.min() == -0.3


# --- hysteresis -------------------------------------------------------------------------------------------------------


def loop(values: dict[str, float], amplitude: float = 3.0, samples: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Return input and z along 0 -> amplitude -> -amplitude -> amplitude at unit rate."""
    prepared = prepare("hysteresis", {"input": (), "rate": ()}, values)
    u, z = np.zeros(1), np.zeros(1)
    for length, rate in ((amplitude, 1.0), (2 * amplitude, -1.0), (2 * amplitude, 1.0)):
        prepared.initial["z"] = z[-1]
        times = np.linspace(0, length, round(samples * length / amplitude) + 1)
        path = followed(prepared, {"input": lambda t: 0.0, "rate": lambda t, rate=rate: rate}, "z", times, 0.1)
        u, z = np.append(u, u[-1] + rate * times[1:]), np.append(z, path[1:])
    return u, z


def test_hysteresis_loads_along_an_exponential_and_unloads_straight() -> None:
    """Exponent 1, shape 1/2: z = 1 - exp(-q/d) from zero; unloading dz/dq = 1/d until z = 0, then the exponential."""
    knee, a = 0.8, 3.0
    u, z = loop({"knee": knee, "exponent": 1.0, "shape": 0.5}, a)
    n = 300
    np.testing.assert_allclose(z[: n + 1], 1 - np.exp(-u[: n + 1] / knee), atol=3e-6)  # |z| is good to 1e-6 of knee
    back, top = u[n : 2 * n], z[n]
    straight = top + (back - a) / knee
    expected = np.where(straight > 0, straight, -(1 - np.exp(straight)))
    np.testing.assert_allclose(z[n : 2 * n], expected, atol=1e-5)


def test_hysteresis_without_loss_goes_back_where_it_came_from() -> None:
    """Shape 0, exponent 2: dz/dq = (1 - z^2)/d whatever the direction: z = tanh(q/d)."""
    u, z = loop({"knee": 0.7, "exponent": 2.0, "shape": 0.0}, amplitude=1.5)
    grown = 1e-8 * np.exp(2 * 1.5 / 0.7)  # on the way back, what the integrator got wrong at the limit
    np.testing.assert_allclose(z, np.tanh(u / 0.7), atol=20 * grown)


@pytest.mark.parametrize("rate", [1.0, -7.0])
def test_loops_do_not_depend_on_how_fast_the_input_moves(rate: float) -> None:
    prepared = prepare("hysteresis", {"input": (), "rate": ()}, {"exponent": 1.7, "shape": 0.8})
    for z in (-0.9, -0.2, 0.0, 0.4):
        slow, fast = (
            prepared.evaluate({"input": 0.0, "rate": k * rate}, states={"z": np.asarray(z)}).derivatives["z"]
            for k in (1.0, 10.0)
        )
        assert fast == pytest.approx(10 * slow, rel=1e-12)


@pytest.mark.slow
@given(shape=st.floats(0.01, 1), exponent=st.floats(1, 6), knee=st.floats(0.2, 2))
@settings(max_examples=8, deadline=None)
def test_the_hysteretic_part_stays_between_its_limits_and_loses_energy(shape, exponent, knee) -> None:
    u, z = loop({"shape": shape, "exponent": exponent, "knee": knee})
    assert np.abs(z).max() <= 1 + 2e-6
    n = 300
    closed, part = u[n:], z[n:]  # from +3 to -3 and back
    lost = float(((part[1:] + part[:-1]) / 2) @ np.diff(closed))
    assert lost >= -1e-3 * 3.0


def test_the_output_has_both_slopes() -> None:
    values = {"slope": 5.0, "ratio": 0.2, "knee": 0.5}
    prepared = prepare("hysteresis", {"input": (), "rate": ()}, values)
    out = prepared.evaluate({"input": 2.0, "rate": 0.0}, states={"z": np.asarray(1.0)}).outputs["output"]
    assert out == pytest.approx(5.0 * (0.2 * 2.0 + 0.8 * 0.5))
