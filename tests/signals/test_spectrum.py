"""Spectra against signals whose harmonics are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.signals.spectrum import (
    DEFAULT_ORDERS,
    Harmonics,
    angle_of,
    full_spectrum,
    harmonics,
    last_turns,
    reconstruction_error,
)
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate

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


def with_reference(time: np.ndarray, theta: np.ndarray, parts: dict[int, complex] = KNOWN) -> Result:
    """Return a signal of known harmonics and the multi-harmonic reference of thesis eq. (2.48)."""
    result = signal(theta, time, parts)
    s = np.exp(1j * np.outer(theta, (-3, -1, 0, 1, 3)))
    return Result(time, {**result.signals, "reference.signal": np.stack([s.real, s.imag], axis=-1)}, {"r.d": "m"})


@pytest.mark.parametrize("start", [0.3, 0.3001, 0.7777])
def test_the_reference_signal_compensates_as_the_angle_does(start):
    time = np.arange(20000) * 1e-4
    result = with_reference(time, 2 * np.pi * 10 * time)
    found = full_spectrum(result, "r.d", window=(start, start + 0.5), reference="reference.signal")
    assert found.running == pytest.approx(10, rel=1e-12)
    for order, value in KNOWN.items():
        assert found.harmonics(tuple(KNOWN))[order] == pytest.approx(value, abs=1e-9)


def test_lines_that_the_reference_does_not_have_are_turned_in_proportion():
    time = np.arange(20000) * 1e-4
    theta = 2 * np.pi * 10 * time
    s = np.exp(1j * theta)
    result = signal(theta, time)
    result = Result(time, {**result.signals, "probe.s": np.column_stack([s.real, s.imag])}, {})
    found = full_spectrum(result, "r.d", window=(0.3011, 0.8011), reference="probe.s").harmonics(tuple(KNOWN))
    assert found.values == pytest.approx(np.array(list(KNOWN.values())), abs=1e-9)


@pytest.mark.parametrize("order", [1, 3, -3])
def test_the_reference_signal_takes_out_the_phase_that_leakage_adds(order):
    # 5.2 turns: what leaks turns the same harmonic of signal and reference by the same angle (thesis section 2.5)
    time = np.arange(20000) * 1e-4
    result = with_reference(time, 2 * np.pi * 10.4 * time + 1.0, {order: 2.0 * np.exp(0.4j)})
    found = full_spectrum(result, "r.d", window=(0.1, 0.6), reference="reference.signal")
    k = int(np.argmax(np.abs(found.amplitude)))
    assert np.angle(found.amplitude[k]) == pytest.approx(0.4, abs=1e-12)


def test_the_phase_shifts_of_the_reference_signal_are_those_of_thesis_table_2_3():
    result = simulate(load("jeffcott"), record=["rotor.displacement", "clock.theta", "reference.signal"])
    window = (4.0001, 5.0001)  # 10 000 of the 50 000 points, the first at 4.0001 s
    found = full_spectrum(result, "rotor.displacement", window=window, reference="reference.signal")
    lines = [int(np.argmin(np.abs(found.frequency - 25 * k))) for k in DEFAULT_ORDERS]
    printed = [0, 0.9, 1.8, 2.7, 4.5, 6.3, -0.9, -2.7, -4.5]
    assert np.degrees(found.phase_shift[lines]) == pytest.approx(printed, abs=1e-9)
    fitted = harmonics(result, "rotor.displacement", window=window)
    assert found.harmonics().values == pytest.approx(fitted.values, rel=1e-9)
    assert found.harmonics().residual == pytest.approx(fitted.residual, rel=1e-9)
    by_angle = full_spectrum(result, "rotor.displacement", window=window)
    assert by_angle.harmonics().values == pytest.approx(fitted.values, rel=1e-9)


def test_a_shaft_that_turns_backward_has_its_forward_whirl_at_positive_orders():
    time = np.arange(10000) * 1e-4
    result = signal(-2 * np.pi * 10 * time, time)
    window = last_turns(result)
    found = full_spectrum(result, "r.d", window=window).harmonics(tuple(KNOWN))
    fitted = harmonics(result, "r.d", tuple(KNOWN), window=window)
    for order, value in KNOWN.items():
        assert found[order] == pytest.approx(value, abs=1e-9)
        assert fitted[order] == pytest.approx(value, abs=1e-9)


def test_half_orders_are_told_from_whole_ones():
    time = np.arange(8000) * 1e-3
    found = harmonics(signal(40 * time, time, {1: 2.0, 0.5: 1j}), "r.d", (0, 0.5, 1))
    assert found.orders == (0, 0.5, 1)
    assert found[0.5] == pytest.approx(1j, abs=1e-12)
    assert found[0] == pytest.approx(0, abs=1e-12)


def test_the_reconstruction_error_is_that_of_what_was_left_out():
    time = np.arange(4000) * 1e-3
    result = signal(2 * np.pi * 5 * time, time, {1: 3.0, -1: 1.0, 4: 0.02j})
    error = reconstruction_error(result, harmonics(result, "r.d", (1, -1)))
    assert error == pytest.approx([0.02 / np.hypot(4, 0.02), 0.02 / np.hypot(2, 0.02)], rel=1e-9)
    full = harmonics(result, "r.d", (1, -1, 4))
    assert reconstruction_error(result, full) == pytest.approx([0, 0], abs=1e-12)
    assert full.at(result["clock.theta"]) == pytest.approx(result.complex("r.d"), abs=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(4, 400), st.integers(0, 1000))
def test_parseval_and_inverse(n, seed):
    rng = np.random.default_rng(seed)
    result = Result(np.arange(n) * 1e-3, {"r.d": rng.normal(size=(n, 2))}, {})
    found = full_spectrum(result, "r.d", angle=None)
    r = result.complex("r.d")
    assert np.sum(np.abs(found.amplitude) ** 2) == pytest.approx(np.mean(np.abs(r) ** 2), rel=1e-12)
    again = np.exp(2j * np.pi * np.outer(result.time, found.frequency)) @ found.amplitude
    assert again == pytest.approx(r, abs=1e-9)
    assert (np.diff(found.frequency) > 0).all()


def test_the_table_is_that_of_the_thesis():
    found = Harmonics("rotor.displacement", "m", (0, 1, -1), np.array([1e-6, 2e-6j, -5e-7]), 0.0)
    assert found.table() == (
        "rotor.displacement\n"
        " order      amplitude [um, 0-peak]   phase [deg]\n"
        "     0                           1          0.00\n"
        "     1                           2         90.00\n"
        "    -1                         0.5        180.00"
    )


def test_the_shaft_angle_is_found_under_another_name():
    time = np.arange(4.0)
    assert angle_of(Result(time, {"drive.theta": time}, {})) == "drive.theta"
    assert angle_of(Result(time, {"a.theta": time, "b.theta": time}, {})) is None
    assert angle_of(Result(time, {"a.theta": time, "clock.theta": time}, {})) == "clock.theta"


def test_what_cannot_be_analysed_is_refused():
    time = np.arange(100) * 1e-2
    result = signal(40 * time, time)
    lost = np.full((100, 2), 1.0)
    lost[50:] = np.nan
    nodes = {"f.d": np.ones((100, 3, 2)), "f.lost": lost, "still.theta": np.ones(100)}
    result = Result(time, {**result.signals, **nodes}, {}, message="advice")
    ragged = Result(time**2, result.signals, {})
    short = Result(time[:2], {"r.d": np.zeros((2, 2)), "clock.theta": np.zeros(2)}, {})
    for call, text in (
        (
            lambda: harmonics(result, "r.d", window=(5, 6)),
            "window 5..6 s holds 0 samples\n\nhint: the run covers 0..0.99 s",
        ),
        (lambda: harmonics(short, "r.d"), "only 2 samples\n\nhint: the run covers 0..0.01 s"),
        (lambda: last_turns(short), "window: only 2 samples\n\nhint: a longer run"),
        (
            lambda: harmonics(result, "clock.theta"),
            "clock.theta: not a two-axis signal\n\nhint: its last dimension must be [x, y]",
        ),
        (lambda: harmonics(result, "f.d"), "f.d: has several nodes\n\nhint: name one of its 3 rows: 'f.d[1]'"),
        (lambda: full_spectrum(result, "f.lost"), "f.lost: not finite from t = 0.5 s on\n\nhint: advice"),
        (
            lambda: harmonics(result, "r.d", (1, 1)),
            "r.d: 2 harmonics cannot be separated in 6.3 turns (100 samples)"
            "\n\nhint: a longer window, or fewer and different orders",
        ),
        (
            lambda: harmonics(result, "r.d", angle="still.theta"),
            "r.d: 9 harmonics cannot be separated in 0 turns (100 samples)"
            "\n\nhint: a longer window, or fewer and different orders",
        ),
        (
            lambda: full_spectrum(ragged, "r.d"),
            "time: the samples are not equally spaced\n\nhint: harmonics() fits signals that are sampled at any times",
        ),
        (
            lambda: full_spectrum(result, "r.d").harmonics(),
            "r.d: order 7 lies between two lines of the spectrum"
            "\n\nhint: take a window of whole turns (last_turns), or harmonics(), which needs none",
        ),
        (
            lambda: full_spectrum(result, "r.d", angle=None).harmonics(),
            "r.d: the running frequency is not known\n\nhint: give full_spectrum an angle or a reference",
        ),
        (
            lambda: full_spectrum(result, "r.d", reference="f.d[1]"),
            "f.d[1]: has no forward harmonic\n\nhint: it needs harmonic 1, and a window of at least one turn",
        ),
        (lambda: harmonics(result, "r.d", (1,))[2], "r.d: no harmonic of order 2\n\nhint: there are 1"),
    ):
        with pytest.raises(RotorsimError) as caught:
            call()
        assert str(caught.value) == f"error: {text}"


def test_orders_above_half_the_sampling_frequency_are_refused():
    time = np.arange(64) / 64
    found = full_spectrum(signal(2 * np.pi * 4 * time, time), "r.d")
    with pytest.raises(RotorsimError) as caught:
        found.harmonics((1, 9))
    assert str(caught.value) == (
        "error: r.d: order 9 is above half the sampling frequency (order 7.75)\n\nhint: record more often"
    )
