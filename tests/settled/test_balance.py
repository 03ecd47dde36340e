"""Newton's method for a settled motion: the linear system of an earlier one is kept where it will do."""

import numpy as np
import pytest

from rotorsim.settled.balance import Balance
from tests.settled.test_answers import experiment, opposed


@pytest.fixture
def made(monkeypatch):
    """Count the linear systems that Newton's method makes."""
    calls = []
    newton, tangent = Balance.newton, Balance.tangent

    def counted(self, *given, **named):
        with monkeypatch.context() as inside:
            inside.setattr(Balance, "tangent", lambda *args: calls.append(1) or tangent(*args))
            return newton(self, *given, **named)

    monkeypatch.setattr(Balance, "newton", counted)
    return calls


def test_a_motion_nearby_takes_no_linear_system_and_is_the_same(made):
    """0.02 % more eccentricity: steps with the system of the last motion, to the same residual as from scratch."""
    motion = experiment(opposed).motion
    motion.predict(np.array([30e-6]))
    begun = len(made)
    assert begun > 0
    near = motion.predict(np.array([30.006e-6]))
    assert len(made) == begun
    scratch = experiment(opposed).motion.predict(np.array([30.006e-6]))
    assert near.settled.all()
    assert np.abs(near.Y - scratch.Y).max() < 1e-8 * np.abs(scratch.Y).max()
    assert np.abs(near.sensitivity() - scratch.sensitivity()).max() < 1e-6 * np.abs(scratch.sensitivity()).max()


def test_a_motion_far_away_takes_a_linear_system_of_its_own(made):
    motion = experiment(opposed).motion
    motion.predict(np.array([30e-6]))
    begun = len(made)
    far = motion.predict(np.array([90e-6]))
    assert len(made) > begun
    scratch = experiment(opposed).motion.predict(np.array([90e-6]))
    assert np.abs(far.Y - scratch.Y).max() < 1e-8 * np.abs(scratch.Y).max()
