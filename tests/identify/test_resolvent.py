"""The response of many runs at many orders, by inverses of small systems and in the eigenvectors of large ones."""

import numpy as np
import pytest

from rotorsim.identify.resolvent import DENSE, Resolvent


@pytest.mark.parametrize("n", [DENSE, DENSE + 20])
def test_the_response_solves_the_system(n):
    random = np.random.default_rng(n)
    A = random.standard_normal((3, n, n)) - 2 * np.sqrt(n) * np.eye(n)
    s = 1j * np.array([[10.0], [20.0], [31.0]]) * np.arange(4)
    right = random.standard_normal((3, 4, n, 2)) + 1j * random.standard_normal((3, 4, n, 2))
    slow = [np.array([], int), np.array([2]), np.array([0, 5])]
    found = Resolvent(A, s, slow)
    X = found.apply(right)
    for r in range(3):
        for k in range(4):
            matrix, b = s[r, k] * np.eye(n) - A[r], right[r, k]
            if k == 0 and len(slow[r]):  # slow states rest, and their equations are not asked for
                kept = np.setdiff1d(np.arange(n), slow[r])
                assert np.abs(X[r, 0, slow[r]]).max() == 0.0
                matrix, b, x = matrix[np.ix_(kept, kept)], b[kept], X[r, 0, kept]
            else:
                x = X[r, k]
            assert np.abs(matrix @ x - b).max() < 1e-11 * np.abs(b).max() * n
        assert found.apply_to_run(r, right[r, :, :, 0]) == pytest.approx(X[r, :, :, 0], rel=1e-9, abs=1e-12)


def test_eigenvectors_that_are_no_base_are_not_used():
    A = np.zeros((1, DENSE + 6, DENSE + 6))
    A[0] = np.diag(np.ones(DENSE + 5), 1) - np.eye(DENSE + 6)  # one block of Jordan's
    found = Resolvent(A, 1j * np.arange(3.0)[None], [np.array([], int)])
    assert found.eigen is None
