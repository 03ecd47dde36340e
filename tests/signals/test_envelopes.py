"""Run-ups: envelopes and resonances against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.signals.envelopes import envelope, resonance_peaks, run_up
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate

RPM = np.pi / 30


def test_the_envelope_of_a_modulated_carrier_is_its_modulation():
    time = np.arange(20000) * 1e-4
    slow = 1 + 0.5 * np.sin(2 * np.pi * 1.5 * time)
    found = envelope(slow * np.cos(2 * np.pi * 200 * time))
    assert np.abs(found - slow)[2000:-2000].max() < 1e-3


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 60), st.floats(0.1, 10), st.floats(-3, 3))
def test_the_envelope_of_whole_periods_is_their_amplitude(periods, amplitude, phase):
    samples = amplitude * np.cos(2 * np.pi * periods * np.arange(256) / 256 + phase)
    assert envelope(samples) == pytest.approx(np.full(256, amplitude), rel=1e-10)


@pytest.mark.slow
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


W0, ZETA = 300.0, 0.03


def response(w: np.ndarray | float) -> np.ndarray:
    """Return the magnification of one degree of freedom at w [rad/s]."""
    return W0**2 / (W0**2 - np.asarray(w) ** 2 + 2j * ZETA * W0 * np.asarray(w))


def crossing(forces: dict[int, float]) -> Result:
    """Return a slow run-up of one degree of freedom that harmonics k of the speed excite, quasi-stationary."""
    rate = 5.0
    time = np.arange(0, 100, 5e-4)
    speed = 20 + rate * time
    theta = 20 * time + rate * time**2 / 2
    samples = sum((force * response(k * speed) * np.exp(1j * k * theta)).real for k, force in forces.items())
    return Result(time, {"r.x": samples, "clock.speed": speed}, {"r.x": "m"})


@pytest.mark.slow
def test_sub_resonances_are_where_harmonics_of_the_speed_meet_the_natural_frequency():
    forces = {1: 1.0, 2: 0.2, 3: 0.1}
    found = resonance_peaks(crossing(forces), "r.x")
    assert [one.order for one in found] == [1, 2, 3]
    top = W0 * np.sqrt(1 - 2 * ZETA**2)
    for one in found:
        assert one.speed == pytest.approx(top / one.order, rel=2e-3)
        assert one.peak == pytest.approx(forces[one.order] * abs(response(top)), rel=1e-2)


@pytest.mark.slow
def test_orders_are_those_of_the_response_curve_and_nothing_leaks():
    found = run_up(crossing({1: 1.0, 3: 0.1}), "r.x")
    turns = slice(10, -10)
    for order, force in {1: 1.0, 3: 0.1}.items():
        expected = force * abs(response(order * found.speeds))
        # three turns are 0.2 s at W0 / 3, in which 3X moves by a sixth of its half-power band, 2 ZETA W0
        assert np.abs(found.orders[order] - expected)[turns].max() < 0.02 * expected.max()
    assert (found.orders[2] < 2e-3 * found.peaks)[turns].all()


@pytest.mark.slow
def test_what_has_no_second_harmonic_has_no_sub_resonance():
    assert [one.order for one in resonance_peaks(crossing({1: 1.0}), "r.x", orders=(1, 2, 3, 4))] == [1]


def test_a_start_transient_is_no_resonance():
    """A free vibration that decays is larger than all that follows; below resonance, the last turn is the largest."""
    time = np.arange(0, 20, 5e-4)
    speed = 20 + 5 * time
    decaying = 9 * np.exp(-2 * time) * np.cos(W0 * time)
    forced = (response(speed) * np.exp(1j * (20 * time + 2.5 * time**2))).real
    found = run_up(Result(time, {"r.x": decaying + forced, "clock.speed": speed}, {"r.x": "m"}), "r.x")
    assert found.rises
    assert found.resonance > 115
    assert found.resonances() == ()


def test_the_peak_of_a_turn_is_that_of_all_orders_together_about_the_mean_of_the_turn():
    time = np.arange(0, 50, 5e-4)
    speed = 20 + 5 * time
    theta = 20 * time + 2.5 * time**2
    drift = 3 * np.exp(-time / 10)
    samples = drift + np.cos(theta) + 0.5 * np.cos(2 * theta)
    found = run_up(Result(time, {"r.x": samples, "clock.speed": speed}, {"r.x": "m"}), "r.x")
    assert found.peaks[20:] == pytest.approx(1.5, rel=0.01)  # both are 1 and 0.5 at theta = 0
    assert found.orders[2][20:-2] == pytest.approx(0.5, rel=1e-3)


@pytest.mark.slow
def test_the_cracked_rotor_is_met_by_its_second_and_third_harmonic_and_one_without_a_crack_is_not():
    record = {"record": ["rotor.displacement", "clock.speed"], "record_every": 5}
    cracked, sound = (simulate(load("jeffcott_runup", without=cut), **record) for cut in ([], ["crack"]))
    found = {one.order: one.speed / RPM for one in resonance_peaks(cracked, "rotor.displacement[1]")}
    damped = 7298  # sqrt((k - k_s + k_i K_P) / m), a sweep is a little late
    assert found[1] == pytest.approx(damped, rel=0.01)
    assert found[2] == pytest.approx(damped / 2, rel=0.01)
    assert found[3] == pytest.approx(damped / 3, rel=0.01)
    assert [one.order for one in resonance_peaks(sound, "rotor.displacement[1]")] == [1]


def test_what_is_no_run_up_is_refused():
    time = np.arange(100) * 1e-2
    lost = np.where(time < 0.5, 1.0, np.nan)
    signals = {"r.d": np.ones((100, 2)), "clock.speed": time, "a.lost": lost, "a.constant": np.ones(100)}
    result = Result(time, signals, {}, message="advice")
    slow = Result(time, {"r.x": time, "clock.speed": 20 + time}, {})
    coarse = Result(time, {"r.x": time, "clock.speed": 70 + time}, {})
    short = Result(time[:9], {"r.x": time[:9], "clock.speed": time[:9]}, {})
    for call, text in (
        (lambda: run_up(result, "r.d"), "r.d: has 2 entries\n\nhint: name one of them: 'r.d[1]' .. 'r.d[2]'"),
        (lambda: run_up(result, "a.lost"), "a.lost: not finite from t = 0.5 s on\n\nhint: advice"),
        (
            lambda: run_up(result, "r.d[1]", speed="a.constant"),
            "a.constant: the speed does not rise\n\nhint: set clock.profile to ramp",
        ),
        (lambda: run_up(short, "r.x"), "r.x: only 9 samples\n\nhint: a longer run-up"),
        (lambda: run_up(slow, "r.x"), "clock.speed: only 3 turns\n\nhint: a longer run-up"),
        (
            lambda: run_up(coarse, "r.x"),
            "r.x: only 9 samples in a turn\n\nhint: record more often (record_every), or fewer orders",
        ),
    ):
        with pytest.raises(RotorsimError) as caught:
            call()
        assert str(caught.value) == f"error: {text}"
