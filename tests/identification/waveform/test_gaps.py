"""Time stamps and inputs as instruments deliver them: what is even, which rows were lost, which gaps are bridged."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.criteria import CRITERIA
from rotorsim.identification.waveform.recorded.gaps import bridged, even_time, with_lost_rows
from tests.identification.waveform.in_time import pushes


@given(n=st.integers(20, 400), rate=st.floats(1.0, 5e3), start=st.floats(-5, 5), digits=st.integers(3, 6))
@settings(max_examples=60, deadline=None)
def test_stamps_that_are_even_but_for_their_last_digit_are_even(n, rate, start, digits):
    exact = start + np.arange(n) / rate
    found = even_time(np.round(exact, digits))
    if 10.0**-digits > 0.5 / rate:  # so coarse that stamps may coincide
        return
    assert found is not None
    np.testing.assert_allclose(np.diff(found), np.diff(found)[0], rtol=1e-6)
    assert np.abs(found - exact).max() <= 10.0**-digits


def test_jitter_is_not_even():
    rng = np.random.default_rng(1)
    time = (np.arange(500) + rng.uniform(-0.2, 0.2, 500)) / 100
    assert even_time(time) is None
    assert even_time(np.round(time, 5)) is None  # coarse, but farther apart than that


def test_lost_rows_are_put_where_they_were():
    time = np.delete(np.arange(200) * 0.01, [20, 50, 51, 52, 120])
    filled, recorded = with_lost_rows(time)
    np.testing.assert_allclose(filled, np.arange(200) * 0.01, atol=1e-12)
    assert np.flatnonzero(~recorded).tolist() == [20, 50, 51, 52, 120]


@pytest.mark.parametrize("kind", ["linear", "band_limited", "hold"])
def test_a_smooth_input_is_bridged_and_its_error_is_what_is_said(kind):
    time = np.arange(2000) / 200
    u = pushes(time, 4)
    gaps = np.arange(15, 1990, 97)
    holes = u.copy()
    holes[gaps] = np.nan
    found = bridged(time, holes, kind)
    assert found.filled == len(gaps)
    rms = float(np.sqrt(np.mean((found.values - u)[gaps] ** 2)))
    assert found.error == pytest.approx(rms, rel=0.4)  # 21 gaps stand for all
    assert np.sqrt(np.sum((found.values - u) ** 2)) <= 2 * CRITERIA.resolution * np.sqrt(np.sum((u - u.mean()) ** 2))


def test_long_gaps_stay_open():
    time = np.arange(2000) / 200
    u = pushes(time, 4)
    u[700:760] = np.nan
    u[1200] = np.nan
    found = bridged(time, u, "linear")
    assert found.filled == 1
    assert np.flatnonzero(np.isnan(found.values)).tolist() == list(range(700, 760))


def test_a_held_input_is_bridged_where_it_did_not_change():
    time = np.arange(600) / 100
    steps = np.repeat([0.0, 2.0, -1.0], 200)
    steps[100:140] = np.nan  # within the first level
    steps[395:405] = np.nan  # over the change from 2 to -1
    found = bridged(time, steps, "hold")
    assert (found.values[100:140] == 0.0).all()
    assert np.isnan(found.values[395:405]).all()
    assert found.error == 0.0


def test_nothing_is_made_up_before_the_first_and_behind_the_last_sample():
    u = np.array([np.nan, np.nan, *np.ones(50), np.nan])
    found = bridged(np.arange(53.0), u, "hold")
    np.testing.assert_array_equal(found.values, u)
    assert bridged(np.arange(4.0), np.full(4, np.nan), "linear").filled == 0
