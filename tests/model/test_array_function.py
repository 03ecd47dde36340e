"""Equations at many points by NumPy are what CasADi's virtual machine gives."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from rotorsim.model.array_function import array_function
from rotorsim.model.matrix_function import MANY_POINTS, POINTS_AT_A_TIME, WORTH_PREPARING, MatrixFunction
from tests.systems.shipped import shipped

UNARY = "exp log sqrt sin cos tan asin acos atan floor ceil fabs sinh cosh tanh asinh acosh atanh log1p expm1 sign"


def test_every_operation() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    both = [x + y, x - y, x * y, x / y, x**y, ca.fmin(x, y), ca.fmax(x, y), ca.fmod(x, y), ca.atan2(x, y)]
    both += [ca.hypot(x, y), ca.copysign(x, y), x < y, x <= y, x == y, x != y, ca.logic_and(x, y), ca.logic_or(x, y)]
    both += [ca.if_else(x < y, x, -y), 1 / x, x**2, 2 * x, -x, ca.logic_not(x), x * 0 + ca.inf, y - ca.inf]
    function = ca.Function("f", [x, y], [ca.vertcat(*both, *(getattr(ca, name)(x) for name in UNARY.split()))])
    written = array_function(function)
    assert written is not None
    rng = np.random.default_rng(1)
    points = np.array(
        [np.r_[rng.normal(size=200), 0.0, 1.0, -1.0, 0.5], np.r_[rng.normal(size=200), 0.0, 0.0, 0.0, 0.5]]
    )
    with np.errstate(all="ignore"):
        found = np.empty((function.numel_out(), 204))
        written(points[:1], points[1:], out=found)
        expected = np.array(function(points[:1], points[1:]))
    assert found == pytest.approx(expected, rel=4e-16 * 8, nan_ok=True)


@pytest.mark.parametrize("name", ["jeffcott", "fe_rigid", "jeffcott_rub"])
def test_the_rates_of_a_diagram(name: str) -> None:
    """Arguments that are the same at all points are given once; both ways give the same to rounding."""
    model = shipped(name)
    trace = model.trace
    function = MatrixFunction([trace.t, trace.x, trace.z, trace.p], model.closed(trace.xdot))
    rng = np.random.default_rng(2)
    n = WORTH_PREPARING + 1
    t, x = rng.uniform(0, 1, (1, n)), 1e-5 * rng.normal(size=(model.n_x, n))
    many = function(t, x, np.zeros((0, n)), model.p0)[:, :, 0]
    some = [function(t[:, k], x[:, k], np.zeros(0), model.p0)[0, :, 0] for k in range(0, n, 9)]
    scale = np.abs(many).max(axis=0)
    assert np.abs(many[::9] - some).max(axis=0) == pytest.approx(0.0, abs=1e-12 * scale.max())


def test_more_points_than_are_taken_at_a_time() -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    function = MatrixFunction([x, p], ca.vertcat(x[0] * p, x[1] + p))
    points = np.arange(2.0 * (2 * POINTS_AT_A_TIME + 5)).reshape(2, -1)
    assert np.array_equal(function(points, np.array([3.0]))[:, :, 0], np.array([points[0] * 3.0, points[1] + 3.0]).T)


def test_few_points_in_all_are_left_to_the_virtual_machine() -> None:
    x = ca.SX.sym("x")
    function = MatrixFunction([x], x * x)
    assert WORTH_PREPARING == 800  # (5 + 1) us an operation by NumPy, 0.008 us an operation and point without: 750
    for count in range(1, 9):
        assert function(np.full((1, MANY_POINTS), 3.0)).ravel().tolist() == [9.0] * MANY_POINTS
        assert ("_by_arrays" in vars(function)) == (count * MANY_POINTS > WORTH_PREPARING)


def test_what_numpy_does_not_have_is_left_to_the_virtual_machine() -> None:
    x = ca.SX.sym("x")
    assert array_function(ca.Function("f", [x], [ca.erf(x)])) is None
    function = MatrixFunction([x], ca.erf(x))
    points = np.linspace(-1, 1, WORTH_PREPARING + 1)
    assert function(points[None])[:, 0, 0] == pytest.approx([float(ca.erf(p)) for p in points])
