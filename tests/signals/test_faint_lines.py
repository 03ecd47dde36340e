"""Lines too faint for one run are found in all runs together; what is no line is not."""

from dataclasses import replace

import numpy as np
import pytest

from rotorsim.signals.asynchronous import find_asynchronous, frequency_of_lines
from rotorsim.signals.harmonics import harmonics_of
from tests.signals.test_asynchronous import NOISE, NU, RATIO, SPEEDS, made

FAINT = 0.0007 * np.array([1.0, 1.0j])  # with noise of 0.01: each of 2000 samples has 1/200 of its variance


@pytest.mark.slow
@pytest.mark.parametrize(
    ("orders", "nu", "follows", "draws"),
    [
        pytest.param((0,), NU, False, 12, marks=pytest.mark.slow),
        ((0,), RATIO, True, 3),
        pytest.param((0,), RATIO, True, 12, marks=pytest.mark.slow),
        pytest.param((-1, 1), NU, False, 12, marks=pytest.mark.slow),
    ],
)
def test_a_line_too_faint_for_one_run_is_found_in_all(orders, nu, follows, draws):
    off, hidden = [], 0
    for seed in range(draws):
        data, _ = made(dict.fromkeys(orders, FAINT), seed=seed, nu=nu, follows=follows)
        runs = harmonics_of(data)
        hidden += frequency_of_lines(runs) is None
        second = find_asynchronous(data, runs)
        assert second is not None
        assert (second.follows, second.orders) == (follows, orders)
        off.append((second.value - nu) / second.std)
    assert hidden >= draws - 2
    assert np.abs(off).max() < 4
    assert draws < 12 or 0.5 < np.sqrt(np.mean(np.square(off))) < 1.6


def test_it_is_found_with_shafts_that_turn_back():
    data, _ = made({0: FAINT}, seed=3, speeds=-SPEEDS)
    second = find_asynchronous(data, harmonics_of(data))
    assert second is not None
    assert abs(second.value - NU) < 4 * second.std


@pytest.mark.slow
def test_skirts_of_harmonics_that_grow_are_no_lines():
    for seed in range(5):
        data, _ = made({}, seed=seed)
        runs = []
        for run in data.runs:
            grows = 0.3 * (run.time - run.time.mean()) ** 2 * np.cos(run.speed * run.time)
            runs.append(replace(run, values={name: values + grows for name, values in run.values.items()}))
        grown = harmonics_of(replace(data, runs=tuple(runs)))
        assert all(item.fit.residual.min() > 1.1 * NOISE for item in grown)
        assert find_asynchronous(replace(data, runs=tuple(runs)), grown) is None
