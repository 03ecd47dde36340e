"""Bearings of eight coefficients over the speed, and what stands between them and the foundation."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotorsim.blocks.common import spline
from scipy.interpolate import CubicSpline

from tests.blocks.evaluation import Prepared, prepare

ROUNDING = 1e-12
K, C = np.array([[2e7, 3e6], [-4e6, 1e7]]), np.array([[2e3, -30.0], [-40.0, 1e3]])
EIGHT = {
    f"{kind}{a}{b}": M[i, j] for kind, M in (("k", K), ("c", C)) for i, a in enumerate("xy") for j, b in enumerate("xy")
}
INPUTS: dict[str, tuple[int, ...]] = {"displacement": (2,), "velocity": (2,), "speed": ()}
SUPPORT: dict[str, tuple[int, ...]] = {"support_displacement": (2,), "support_velocity": (2,)}
SPEEDS = [100.0, 180.0, 300.0, 350.0, 600.0]
KXX = [1e7, 3e7, -2e7, 5e6, 4e7]


def bearing(parameters: dict[str, Any], inputs: dict[str, tuple[int, ...]] = INPUTS, **options: Any) -> Prepared:
    return prepare("bearing_coefficients", inputs, parameters, options)


def kxx_at(block: Prepared, speed: float) -> float:
    at = {"displacement": [1.0, 0.0], "velocity": [0.0, 0.0], "speed": speed}
    return -float(block.evaluate(at).outputs["force"][0])


def test_the_force_is_that_of_the_two_matrices() -> None:
    q, v = np.array([1e-5, -2e-5]), np.array([3e-3, 1e-3])
    out = bearing(EIGHT).evaluate({"displacement": q, "velocity": v, "speed": 123.0}).outputs
    assert out["force"] == pytest.approx(-K @ q - C @ v, rel=ROUNDING)
    assert out["reaction"] == pytest.approx(K @ q + C @ v, rel=ROUNDING)


def test_a_support_that_moves_along_is_not_pushed() -> None:
    q, v, base = np.array([1e-5, -2e-5]), np.array([3e-3, 1e-3]), np.array([4e-6, 5e-6])
    block = bearing(EIGHT, {**INPUTS, **SUPPORT})
    at = {"displacement": q, "velocity": v, "speed": 0.0, "support_velocity": v}
    assert block.evaluate({**at, "support_displacement": q}).outputs["force"] == pytest.approx([0.0, 0.0])
    out = block.evaluate({**at, "support_displacement": base}).outputs
    assert out["force"] == pytest.approx(-K @ (q - base), rel=ROUNDING)
    assert out["force"] == pytest.approx(-out["reaction"])


@pytest.mark.parametrize("speed", [100.0, 137.0, 180.0, 299.0, 351.0, 600.0])
def test_tables_are_interpolated_by_the_not_a_knot_spline_or_by_chords(speed: float) -> None:
    table = {"speeds": SPEEDS, "kxx": KXX}
    scale = ROUNDING * max(map(abs, KXX))
    assert kxx_at(bearing(table), speed) == pytest.approx(CubicSpline(SPEEDS, KXX)(speed), abs=scale)
    linear = kxx_at(bearing(table, interpolation="linear"), speed)
    assert linear == pytest.approx(np.interp(speed, SPEEDS, KXX), abs=scale)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_short_tables_are_a_line_a_parabola_and_a_cubic(count: int) -> None:
    x, y = SPEEDS[:count], KXX[:count]
    exact = np.polynomial.Polynomial.fit(x, y, count - 1)
    assert kxx_at(bearing({"speeds": x, "kxx": y}), 150.0) == pytest.approx(exact(150.0), rel=1e-10)


@pytest.mark.parametrize(("speed", "held"), [(0.0, KXX[0]), (-50.0, KXX[0]), (600.0, KXX[-1]), (1e4, KXX[-1])])
def test_end_values_are_held_outside_the_table(speed: float, held: float) -> None:
    assert kxx_at(bearing({"speeds": SPEEDS, "kxx": KXX}), speed) == pytest.approx(held, rel=1e-10)


def test_adaptive_solvers_stop_where_the_table_begins_and_ends() -> None:
    block = bearing({"speeds": SPEEDS, "kxx": KXX})
    at = {"displacement": [0.0, 0.0], "velocity": [0.0, 0.0], "speed": 150.0}
    assert block.evaluate(at).events["speed"] == pytest.approx([50.0, -450.0])


def test_speeds_that_do_not_increase_are_refused() -> None:
    block = bearing({"speeds": SPEEDS, "kxx": KXX}).block
    assert block.check({"speeds": np.array([1.0, 3.0, 3.0])}) == ["speeds must increase, but 3 rad/s follows 3 rad/s"]
    assert block.check({"speeds": np.array([5.0])}) == []


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.5, 2.0), min_size=3, max_size=12), st.data())
def test_a_cubic_is_found_again_whatever_the_points(steps: list[float], data: st.DataObject) -> None:
    x = np.cumsum(steps)
    cubic = np.polynomial.Polynomial(data.draw(st.lists(st.floats(-1, 1), min_size=4, max_size=4)))
    if len(x) == 3:
        cubic = cubic.cutdeg(2)
    y, at = cubic(x), data.draw(st.floats(x[0], x[-1]))
    found = spline.value(y[0], spline.cubics(list(x), list(y)), [min(max(at - a, 0.0), b - a) for a, b in pairwise(x)])
    assert found == pytest.approx(cubic(at), abs=1e-9 * max(1.0, np.abs(y).max()))


def test_a_support_mass_obeys_newton_in_each_axis() -> None:
    block = prepare("support_mass", {"force": (2,)}, {"mass": [2.0, 5.0]})
    found = block.evaluate({"force": [3.0, -4.0]}, {"position": [1.0, 2.0], "velocity": [0.5, -0.5]})
    assert found.derivatives["velocity"] == pytest.approx([1.5, -0.8])
    assert found.derivatives["position"] == pytest.approx([0.5, -0.5])
    assert found.outputs["displacement"] == pytest.approx([1.0, 2.0])
