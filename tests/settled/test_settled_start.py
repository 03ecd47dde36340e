"""A run from the settled motion has no transient."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim import RotorsimError, load, periodic, settled_start, simulate
from tests.acceptance.machines import jeffcott


@pytest.mark.parametrize("name", ["jeffcott", "offset_disc", "fe_flexible"])
def test_the_first_turn_is_the_settled_one(name: str) -> None:
    diagram = load(name)
    found = periodic(diagram, signals=["rotor.displacement"])
    pair = found.two_axis[-1]
    turn = 2 * np.pi / found.speeds[0]
    run = simulate(diagram, initial=settled_start(diagram), stop=2 * turn, record=[pair])
    motion = run[pair] @ np.array([1, 1j])
    orders = np.exp(1j * np.outer(run.time, found.orders * found.speeds[0]))
    settled = orders @ found.harmonics[pair][0]
    assert np.abs(motion - settled).max() < 2e-6 * np.abs(settled).max()


def test_a_disc_in_closed_form() -> None:
    """x = Re X, v = Re i W X, X = u W^2 / (k - m W^2 + i d W)."""
    W = 300.0
    X = 2e-5 * W**2 / (1.4e6 - 2 * W**2 + 150j * W)
    assert settled_start(load(jeffcott(4e5, 150.0)))[:4] == pytest.approx(
        [X.real, (-1j * X).real, (1j * W * X).real, (W * X).real], rel=1e-9
    )


def test_parameters_are_heard() -> None:
    one = settled_start(load("jeffcott"), parameters={"speed": 200.0})
    assert one == pytest.approx(settled_start(load("jeffcott", set={"speed": 200.0})), rel=1e-12)


@pytest.mark.parametrize(
    ("machine", "text"),
    [
        (
            jeffcott(4e5, -10.0),
            "error: disc: its settled motion is not stable: no run stays there\n\n"
            "hint: `rotorsim modes` shows what grows",
        ),
        (
            jeffcott(4e5, 1.0, {"type": "discrete_pid"}),
            "error: controller: a settled start needs continuous blocks; this one has a sample time\n\n"
            "hint: `rotorsim swap` a continuous controller in, or use `rotorsim run`",
        ),
        (
            {**jeffcott(4e5, 1.0), "parameters": {"speed": "0 rad/s"}},
            "error: speed: its speed is zero: there is no turn to be periodic in\n\n"
            "hint: give a speed, and a clock that does not accelerate",
        ),
    ],
)
def test_where_there_is_none(machine, text: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        settled_start(load(machine))
    assert str(caught.value) == text
