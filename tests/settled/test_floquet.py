"""Growth of disturbances of a periodic motion."""

from types import SimpleNamespace

import numpy as np
import pytest

from rotorsim.settled.floquet import growth_rate


def test_the_growth_of_a_periodic_system_is_not_that_of_its_eigenvalues():
    """x' = A(t) x grows as e^(t / 2) though the eigenvalues of A(t) have the real part -1/4 at all times.

    Markus & Yamabe, Osaka Math. J. 12 (1960) 305-317.
    """

    def jacobian(t: np.ndarray, *_: object) -> np.ndarray:
        c, s = np.cos(t[0]), np.sin(t[0])
        A = np.array([[-1 + 1.5 * c * c, 1 - 1.5 * s * c], [-1 - 1.5 * s * c, -1 + 1.5 * s * s]]).transpose(2, 0, 1)
        assert np.linalg.eigvals(A).real == pytest.approx(-0.25)
        return A

    for start in (0.0, 0.3):
        rate = growth_rate(SimpleNamespace(J=jacobian), 1.0, np.zeros(0), np.zeros((3, 2)), np.zeros(0), start)
        assert rate == pytest.approx(0.5, abs=1e-5)
