"""Peaks of one mode, half-power speeds and separation margins, against closed forms and the formulas of API 684."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorsim.signals.orders.resonance import peak_in, peak_of, separation_margin


def _response(speed, w, z, order):
    r = order * speed / w
    return (r**2 if order == 1 else 1.0) / np.sqrt((1 - r**2) ** 2 + (2 * z * r) ** 2)


@given(z=st.floats(0.002, 0.3), order=st.integers(1, 3), w=st.floats(10.0, 2000.0))
def test_half_power_speeds_are_where_the_response_is_down_by_the_root_of_two(z, order, w):
    peak = peak_of(w, z, order)
    top, low, high = (_response(speed, w, z, order) for speed in (peak.speed, peak.lower, peak.upper))
    near = _response(peak.speed * np.array([1 - 1e-4, 1 + 1e-4]), w, z, order)
    assert (near < top).all()
    assert low == pytest.approx(top / np.sqrt(2), rel=1e-9)
    assert high == pytest.approx(top / np.sqrt(2), rel=1e-9)
    assert peak.lower < peak.speed < peak.upper


def test_light_damping_gives_half_the_inverse_damping_ratio():
    assert peak_of(100.0, 0.005).amplification == pytest.approx(100.0, rel=2e-4)


@pytest.mark.parametrize(("z", "order"), [(0.4, 1), (0.4, 2)])
def test_what_is_damped_well_has_only_one_half_power_speed_and_no_amplification_factor(z, order):
    assert np.isnan(peak_of(100.0, z, order).amplification)


def test_what_is_damped_beyond_a_peak_has_none():
    assert np.isnan(peak_of(100.0, 0.8).speed)


def test_a_curve_is_read_along_straight_lines_between_its_rows():
    peak = peak_in(np.array([1.0, 2.0, 3.0, 4.0, 5.0]), np.array([0.0, 1.0, 2.0, 1.0, 0.0]), 2)
    assert peak.speed == 3.0
    assert peak.lower == pytest.approx(1 + np.sqrt(2))
    assert peak.upper == pytest.approx(5 - np.sqrt(2))
    assert np.isnan(peak_in(np.array([1.0, 2.0, 3.0]), np.array([1.9, 1.95, 2.0]), 2).amplification)


@pytest.mark.parametrize(
    ("critical", "amplification", "actual", "required"),
    [  # API 684, SP6.8.2.10, by hand: 17 (1 - 1 / (AF - 1.5)), 10 more above, at most 16 and 26 %
        (2400.0, 8.0, 20.0, 17 * (1 - 1 / 6.5)),
        (2400.0, 50.0, 20.0, 16.0),
        (4500.0, 4.0, 25.0, 10 + 17 * (1 - 1 / 2.5)),
        (4500.0, 40.0, 25.0, 26.0),
        (2400.0, 2.5, 20.0, 0.0),
        (2400.0, 2.4, 20.0, 0.0),
        (4500.0, float("nan"), 25.0, 0.0),
        (3300.0, 8.0, 0.0, 17 * (1 - 1 / 6.5)),
        (3300.0, 2.0, 0.0, 0.0),
    ],
)
def test_separation_margins_are_those_of_the_standard(critical, amplification, actual, required):
    margin = separation_margin(critical, amplification, 3000.0, 3600.0)
    assert margin.actual == pytest.approx(actual)
    assert margin.required == pytest.approx(required)
    assert margin.met == (actual >= required)
