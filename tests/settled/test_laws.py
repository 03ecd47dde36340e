"""Equations by their laws: the same values and derivatives as the expressions that they are made of."""

from __future__ import annotations

import casadi as ca
import numpy as np

from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.laws import Laws, Matrix, Split, Together, by_parameters, column_of

t, p, theta, x = (ca.SX.sym(name, size) for name, size in (("t", 1), ("p", 2), ("theta", 2), ("x", 2)))
RNG = np.random.default_rng(3)
P, THETA, TIMES = RNG.uniform(0.5, 2, (3, 2)), RNG.uniform(0.5, 2, (3, 2)), RNG.uniform(0, 9, (3, 7))
POINTS = TIMES.reshape(1, -1), np.repeat(P, 7, 0).T, np.repeat(THETA, 7, 0).T


def column():
    """Return a force that several rows share, one in one row alone, and what does not change in time."""
    force = theta[0] * ca.cos(p[0] * t + theta[1])
    return ca.vertcat(3 * force + p[1], theta[0] * theta[1], p[1] * force - ca.sin(t) ** 2 / theta[0])


def test_a_column_is_its_laws_times_what_they_are_multiplied_by():
    whole = column()
    laws = Laws.of(whole, (t, p, theta))
    found, slopes = column_of(laws.L(P, THETA), *laws.at(P, THETA, TIMES))
    expected, derivatives = (
        MatrixFunction([t, p, theta], of)(*POINTS).reshape(3, 7, 3, -1) for of in (whole, ca.jacobian(whole, theta))
    )
    np.testing.assert_allclose(found, expected[..., 0], rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(slopes, derivatives, rtol=1e-13, atol=1e-14)
    some = laws.of_rows([2, 0])
    np.testing.assert_allclose(
        column_of(some.L(P, THETA), *some.at(P, THETA, TIMES))[0], found[..., [2, 0]], rtol=1e-14
    )


def test_laws_that_follow_the_states_are_told_from_those_of_time():
    law = theta[1] * x[0] ** 3
    f = column() + ca.vertcat(p[0] * x[1] + law, 2 * law, theta[0] * x[0])
    split = Split((t, p, theta), x, f)
    X = RNG.uniform(-1, 1, (3, 7, 2))
    at = POINTS[0], X.reshape(-1, 2).T, *POINTS[1:]
    w, w_theta = (of(*at).reshape(3, 7, split.w.shape[0], -1) for of in (split.w, split.w_theta))
    (A, A_theta), B = (split.steady(P, THETA)[key] for key in "AB")
    value, slopes = column_of(B, w[..., 0], w_theta)
    arguments = [t, x, p, theta]
    expected, derivatives, by_x = (
        MatrixFunction(arguments, of)(*at).reshape(3, 7, 3, -1) for of in (f, ca.jacobian(f, theta), ca.jacobian(f, x))
    )
    np.testing.assert_allclose(value + X @ A.swapaxes(1, 2), expected[..., 0], rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(slopes + by_parameters(A_theta, X), derivatives, rtol=1e-13, atol=1e-14)
    w_x = split.w_x(*at).reshape(3, 7, -1, 2)
    np.testing.assert_allclose(A[:, None] + B[0][:, None, :, split.moving] @ w_x, by_x, rtol=1e-13, atol=1e-14)
    assert len(split.moving) == 1 < split.w.shape[0]


def test_matrices_of_one_row_and_of_nothing_are_evaluated_with_the_others():
    matrices = {
        "row": ca.horzcat(p[0] * theta[0], 0, theta[1]),
        "column": ca.vertcat(theta[1], p[1]),
        "nothing": ca.SX(2, 2),
        "square": ca.diag(theta),
    }
    kept = {name: Matrix.of(matrix, p, theta) for name, matrix in matrices.items()}
    found = Together(kept)(P, THETA)
    for name, matrix in kept.items():
        for own, alone in zip(found[name], matrix(P, THETA), strict=True):
            np.testing.assert_array_equal(own, alone)
    np.testing.assert_array_equal(found["row"][0][:, 0, 0], P[:, 0] * THETA[:, 0])
