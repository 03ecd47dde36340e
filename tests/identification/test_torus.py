"""Combinations of the shaft with an asynchronous frequency."""

import numpy as np
import pytest
from scipy.special import jv

from rotorsim.settled.torus import Torus


@pytest.mark.parametrize("speed", [130.0, -130.0])
@pytest.mark.parametrize("nu", [29.7, 556.8])
def test_harmonics_and_combinations_of_an_angle_that_swings_are_bessel_functions(speed, nu):
    """cos k(W t + m sin nu t) has J_n(k m) / 2 at k W + n nu; what is left out begins with J_4."""
    K, orders, k, m = 6, np.arange(-4, 5), 3, 0.1
    torus = Torus(np.array([speed]), K, np.array([nu]), orders, forced=True)
    time = torus.times[0]
    found = torus.projection[0] @ np.cos(k * (speed * time + m * np.sin(nu * time)))
    wanted = np.zeros(K + 1 + len(orders))
    wanted[k] = jv(0, k * m) / 2
    wanted[K + 1 + np.flatnonzero(orders == k)[0]] = jv(1, k * m) / 2
    wanted[K + 1 + np.flatnonzero(orders == -k)[0]] = -jv(1, k * m) / 2
    np.testing.assert_allclose(found, wanted, atol=jv(4, k * m))
