"""Spectra against signals whose harmonics are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.errors import RotorsimError
from rotorsim.simulate.result import Result
from rotorsim.simulate.spectrum import envelope, full_spectrum, harmonics, last_turns, run_up

KNOWN = {0: 1.0, 1: 3 * np.exp(0.4j), -1: 0.5 * np.exp(-1j), 3: 0.2j}


def signal(theta: np.ndarray, time: np.ndarray, parts: dict[int, complex] = KNOWN) -> Result:
    r = sum(value * np.exp(1j * k * theta) for k, value in parts.items())
    return Result(time, {"r.d": np.column_stack([r.real, r.imag]), "clock.theta": theta}, {"r.d": "m"})


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 2), st.floats(0.31, 3.0), st.floats(-0.2, 0.2))
def test_harmonics_are_found_in_any_window_at_a_drifting_speed(start, length, drift):
    time = np.arange(5000) * 1e-3
    theta = 40 * time + drift * 40 * time**2 / 2 + 0.7
    found = harmonics(signal(theta, time), "r.d", tuple(KNOWN), window=(start, start + length))
    for order, value in KNOWN.items():
        assert found[order] == pytest.approx(value, abs=1e-8)
    assert found.residual < 1e-10


def test_the_residual_is_the_share_that_is_left_over():
    time = np.arange(4000) * 1e-3
    result = signal(2 * np.pi * 5 * time, time, {1: 3.0, 2: 4.0})
    assert harmonics(result, "r.d", (1,)).residual == pytest.approx(0.8, rel=1e-9)


@pytest.mark.parametrize("turns", [3, 7.25, 11.4])
def test_phase_compensation_makes_the_spectrum_independent_of_where_the_window_starts(turns):
    time = np.arange(20000) * 1e-4
    theta = 2 * np.pi * 10 * time
    start = round(turns * 1000) * 1e-4
    found = full_spectrum(signal(theta, time), "r.d", window=(start, start + 0.5))
    for order, value in KNOWN.items():
        k = int(np.argmin(np.abs(found.frequency - 10 * order)))
        assert found.amplitude[k] == pytest.approx(value, abs=1e-9)


def test_the_full_spectrum_keeps_the_power_of_the_signal():
    rng = np.random.default_rng(1)
    result = Result(np.arange(256) * 1e-3, {"r.d": rng.normal(size=(256, 2))}, {})
    found = full_spectrum(result, "r.d", angle=None)
    assert np.sum(np.abs(found.amplitude) ** 2) == pytest.approx(np.mean(np.abs(result.complex("r.d")) ** 2), rel=1e-12)


def test_the_last_turns_are_whole_turns():
    time = np.arange(10001) * 1e-3
    theta = 2 * np.pi * 7 * time
    start, stop = last_turns(signal(theta, time))
    assert (stop - start) * 7 == pytest.approx(14, abs=0.01)


def test_the_envelope_of_a_modulated_carrier_is_its_modulation():
    time = np.arange(20000) * 1e-4
    slow = 1 + 0.5 * np.sin(2 * np.pi * 1.5 * time)
    found = envelope(slow * np.cos(2 * np.pi * 200 * time))
    assert np.abs(found - slow)[2000:-2000].max() < 1e-3


def test_the_resonance_of_a_slow_chirp_through_one_degree_of_freedom_is_that_of_its_response_curve():
    w0, zeta, rate = 300.0, 0.05, 5.0
    time = np.arange(0, 100, 5e-4)
    speed = 50 + rate * time
    h = speed**2 / (w0**2 - speed**2 + 2j * zeta * w0 * speed)  # quasi-stationary unbalance response
    theta = 50 * time + rate * time**2 / 2
    samples = (h * np.exp(1j * theta)).real
    result = Result(time, {"r.d": np.column_stack([samples, samples]), "clock.speed": speed}, {"r.d": "m"})
    found = run_up(result, "r.d[1]")
    assert found.resonance == pytest.approx(w0 / np.sqrt(1 - 2 * zeta**2), rel=2e-3)
    assert found.peak == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=5e-3)


def test_what_cannot_be_analysed_is_refused():
    time = np.arange(100) * 1e-2
    result = signal(40 * time, time)
    for call, text in (
        (
            lambda: harmonics(result, "r.d", window=(5, 6)),
            "error: window: window 5..6 s holds 0 samples\n\nhint: the result covers 0..0.99 s",
        ),
        (
            lambda: harmonics(result, "clock.theta"),
            "error: clock.theta: not a two-axis signal\n\nhint: its last dimension must be [x, y]",
        ),
        (lambda: run_up(result, "r.d"), "error: r.d: not a scalar signal\n\nhint: name one entry: 'r.d[1]'"),
    ):
        with pytest.raises(RotorsimError) as caught:
            call()
        assert str(caught.value.problems[0]) == text
