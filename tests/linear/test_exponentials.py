"""exp(A h) shared by speeds, against rotation in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim.linear import exponentials
from rotorsim.linear.exponentials import Exponentials, exponential

UNITS = np.array([1.0, 1e8])  # of the two states
H, DAMPING = 1e-3, 200.0


def turning(speed: float, damping: float = DAMPING) -> np.ndarray:
    """Return A of x' = -d x + W y, y' = -d y - W x."""
    return np.array([[-damping, speed], [-speed, -damping]]) * UNITS[:, None] / UNITS


def turned(speed: float, damping: float = DAMPING) -> np.ndarray:
    """Return exp(A h), in units of 1."""
    c, s = np.cos(speed * H), np.sin(speed * H)
    return np.exp(-damping * H) * np.array([[c, s], [-s, c]])


def in_units_of_1(found: np.ndarray) -> np.ndarray:
    return found / UNITS[:, None] * UNITS


def test_it_is_balanced_first() -> None:
    np.testing.assert_allclose(in_units_of_1(exponential(turning(700.0), H)), turned(700.0), rtol=0, atol=4e-15)
    assert exponential(np.zeros((0, 0)), H).shape == (0, 0)


@pytest.mark.parametrize(("highest", "at"), [(100.0, 9), (3000.0, 17), (12000.0, 33)])
def test_it_is_computed_at_few_speeds(highest: float, at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Coefficients are 2 J_k(q), q = w h = 0.05, 1.5 and 6: J_7, J_15 and J_31 are below 1e-12, J_15(6) is not."""
    calls = []
    monkeypatch.setattr(exponentials, "expm", lambda M, of=exponentials.expm: calls.append(1) or of(M))
    shared = Exponentials(turning(0.0), turning(highest))
    for speed in np.linspace(0.0, highest, 101):
        found = in_units_of_1(shared.of(turning(float(speed)), H))
        np.testing.assert_allclose(found, turned(float(speed)), rtol=0, atol=3e-13)
    assert len(calls) == at


@pytest.mark.parametrize(
    ("highest", "speed", "damping"),
    [
        (600.0, 700.0, DAMPING),  # beyond the ends
        (600.0, 300.0, DAMPING * (1 + 1e-12)),  # not between them
        (1e6, 3e5, DAMPING),  # 500 rad of turning: no polynomial of 32 intervals
    ],
)
def test_what_is_not_told_by_few_is_computed_by_itself(
    highest: float, speed: float, damping: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = Exponentials(turning(0.0), turning(highest))
    shared.of(turning(highest / 2), H)
    calls = []
    monkeypatch.setattr(exponentials, "expm", lambda M, of=exponentials.expm: calls.append(1) or of(M))
    found = in_units_of_1(shared.of(turning(speed, damping), H))
    assert len(calls) == 1
    np.testing.assert_allclose(found, turned(speed, damping), rtol=0, atol=1e-11)


def test_without_gyroscopic_terms_there_is_one() -> None:
    shared = Exponentials(turning(500.0), turning(500.0))
    np.testing.assert_allclose(in_units_of_1(shared.of(turning(500.0), H)), turned(500.0), rtol=0, atol=4e-15)
    np.testing.assert_allclose(in_units_of_1(shared.of(turning(501.0), H)), turned(501.0), rtol=0, atol=4e-15)
