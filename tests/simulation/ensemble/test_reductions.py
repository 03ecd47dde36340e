"""What is kept of runs is what their histories say: computed here from those, by other formulas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.simulation.ensemble.many import simulate_many
from rotorsim.simulation.ensemble.reductions import KINDS, chosen_reductions
from rotorsim.simulation.ensemble.result import Ensemble
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate

STOP, WINDOW = 0.6, (0.3, 0.55)
ALL = ["peak", "peak_to_peak", "mean", "rms", "radius", "last", "harmonics=4", "poincare", "envelope=13", "history"]
SIGNAL = "rotor.displacement"


@pytest.fixture(scope="module")
def kept() -> tuple[Ensemble, list[Result]]:
    diagram, speeds = load("jeffcott"), [180.0, 251.3, 317.0]
    found = simulate_many(diagram, {"speed": speeds}, stop=STOP, window=WINDOW, reduce=ALL, workers=1)
    return found, [simulate(diagram, parameters={"speed": speed}, stop=STOP) for speed in speeds]


def window_of(result: Result) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples of the window, both of its ends among them, and the shaft angle."""
    there = (result.time >= WINDOW[0] - 1e-9) & (result.time <= WINDOW[1] + 1e-9)
    return result[SIGNAL][there], result["clock.theta"][there]


def test_sizes(kept: tuple[Ensemble, list[Result]]) -> None:
    found, results = kept
    for k, result in enumerate(results):
        y, _ = window_of(result)
        assert len(y) == 2501
        expected = {
            "peak": np.abs(y).max(axis=0),
            "peak_to_peak": np.ptp(y, axis=0),
            "mean": y.mean(axis=0),
            "rms": np.sqrt((y**2).mean(axis=0)),
            "radius": np.hypot(*y.T).max(),
            "last": result[SIGNAL][-1],
        }
        for kind, values in expected.items():
            assert found[kind, SIGNAL][k] == pytest.approx(values, rel=1e-12), kind
        assert np.array_equal(found["history", SIGNAL][k], y)
    assert found.window == pytest.approx(np.array([WINDOW] * 3))


def test_harmonics_are_those_of_least_squares(kept: tuple[Ensemble, list[Result]]) -> None:
    """The window holds no whole number of turns: orders are not orthogonal there."""
    found, results = kept
    for k, result in enumerate(results):
        y, theta = window_of(result)
        columns = [np.ones_like(theta)]
        for order in range(1, 5):
            columns += [np.cos(order * theta), np.sin(order * theta)]
        c = np.linalg.lstsq(np.array(columns).T, y, rcond=None)[0]
        expected = np.array([c[0], *(c[2 * n - 1] - 1j * c[2 * n] for n in range(1, 5))]).T
        assert np.abs(found["harmonics", SIGNAL][k] - expected).max() < 1e-12 * np.abs(expected).max()


def test_poincare_points_are_those_of_whole_turns(kept: tuple[Ensemble, list[Result]]) -> None:
    """Beside a spline: between rows d apart a cubic through four is off by 3/128 d^4 times the fourth derivative."""
    found, results = kept
    for k, result in enumerate(results):
        y, theta = window_of(result)
        turns = np.arange(np.ceil(theta[0] / (2 * np.pi)), np.floor(theta[-1] / (2 * np.pi)) + 1)
        expected = CubicSpline(theta, y)(2 * np.pi * turns)
        points = found["poincare", SIGNAL][k]
        there = points[np.isfinite(points).all(axis=1)]
        orders = np.arange(1, 16)
        columns = np.exp(1j * theta[:, None] * orders)
        columns = np.hstack([np.ones((len(y), 1)), columns.real, columns.imag])
        sizes = np.abs(np.linalg.lstsq(columns, y)[0][1:]).max(axis=1)
        bound = 3 / 128 * (theta[1] - theta[0]) ** 4 * (np.tile(orders, 2) ** 4 * sizes).sum()
        assert bound < 1e-5 * np.abs(y).max()
        assert np.abs(there - expected).max() < bound
        assert np.isnan(points[len(there) :]).all()


def test_a_turn_of_four_rows_is_refused_and_one_of_eight_is_good_to_a_thousandth() -> None:
    """The points of a shaft that turns on a circle lie where it was at rest: x = 1, y = 0."""
    wheel = {
        "name": "wheel",
        "blocks": {
            "clock": {"type": "clock", "parameters": {"speed": 2 * np.pi}},
            "unbalance": {"type": "unbalance", "parameters": {"mass": 1.0, "eccentricity": 1.0, "phase": 0.0}},
        },
        "wires": [["clock.theta", "unbalance.theta"], ["clock.speed", "unbalance.speed"]],
        "solver": {"step": 0.01, "stop": 10.0},
        "record": ["unbalance.force"],
    }
    options: dict[str, Any] = {"reduce": ["poincare"], "window": (0.0, 10.0)}
    found = simulate_many(load(wheel), {"clock.speed": [2 * np.pi * 0.97]}, record_every=12, **options)
    points = found["poincare", "unbalance.force"][0]
    points = points[np.isfinite(points).all(axis=1)] / (2 * np.pi * 0.97) ** 2
    assert len(points) == 9
    assert 1e-5 < np.abs(points - [1.0, 0.0]).max() < 0.01
    with pytest.raises(RotorsimError) as error:
        simulate_many(load(wheel), {}, record_every=25, **options)
    assert str(error.value) == (
        "error: poincare: a turn of the shaft has 4 recorded rows; at least 8 are needed\n\n"
        "hint: a smaller record_every or step"
    )


def test_envelope(kept: tuple[Ensemble, list[Result]]) -> None:
    found, results = kept
    for k, result in enumerate(results):
        y = result[SIGNAL]
        ends = [round(len(y) * part / 13) for part in range(14)]
        for part, values in enumerate(found["envelope", SIGNAL][k]):
            rows = y[ends[part] : ends[part + 1]]
            assert np.array_equal(values.T, [rows.min(axis=0), rows.max(axis=0)])


def test_a_shaft_that_turns_backward() -> None:
    diagram = load("jeffcott")
    forward, backward = (
        simulate_many(diagram, {"speed": [sign * 200.0]}, stop=0.4, reduce=["poincare", "harmonics=1"])
        for sign in (1, -1)
    )
    counts = [int(np.isfinite(one["poincare", SIGNAL][0, :, 0]).sum()) for one in (forward, backward)]
    assert counts == [6, 6]
    assert np.isfinite(backward["harmonics", SIGNAL]).all()


def test_a_shaft_at_rest_has_no_harmonics() -> None:
    found = simulate_many(load("jeffcott"), {"speed": [0.0, 200.0]}, stop=0.2, reduce=["harmonics=1", "peak"])
    assert np.isnan(found["harmonics", SIGNAL][0]).all()
    assert np.isfinite(found["harmonics", SIGNAL][1]).all()
    assert np.isfinite(found["peak", SIGNAL]).all()


def test_reductions_by_name() -> None:
    assert chosen_reductions(["peak", "harmonics=5", "envelope"]) == {"peak": 0, "harmonics": 5, "envelope": 200}
    with pytest.raises(RotorsimError) as error:
        chosen_reductions(["peek", "rms=3", "harmonics=x", "envelope=0"])
    assert [(problem.subject, problem.what, problem.hint) for problem in error.value.problems] == [
        ("reduce", "no reduction 'peek'", "did you mean 'peak'?"),
        ("reduce", "'rms=3': rms takes no number", "rms"),
        ("reduce", "'harmonics=x': not a whole number from 1 to 10000", "harmonics=3"),
        ("reduce", "'envelope=0': not a whole number from 1 to 10000", "envelope=200"),
    ]


def test_every_kind_is_described_and_kept(kept: tuple[Ensemble, list[Result]]) -> None:
    assert list(kept[0].values) == list(KINDS)
