"""Angles that turn evenly: rotated vectors in the place of sines and cosines, over runs of any length."""

from __future__ import annotations

import math
from decimal import Decimal, getcontext
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from rotorsim.diagram.diagram import Diagram
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.emit.emit import emit_c
from rotorsim.model.instance import LARGEST_NUMBER, CompiledInstance, make_instance
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate

getcontext().prec = 60
PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")
H, STEPS, EVERY = 1e-4, 10_000_000, 9973
RAMP = {"profile": "ramp", "speed": 100.0, "acceleration": 0.5, "speed_limit": 250.0007}
SAW = {"profile": "table", "times": [0.001 * k for k in range(9)], "speeds": [100.0, 400.0] * 4 + [100.0]}


def turned(clock: dict[str, Any], **solver: Any) -> Diagram:
    """Return a diagram of an unbalance of 1 kg m, which a recorded force of W^2 (cos theta, sin theta) is of."""
    unbalance = {"type": "unbalance", "parameters": {"mass": 1.0, "eccentricity": 1.0, "phase": 0.0}}
    return load(
        {
            "name": "turned",
            "blocks": {"clock": {"type": "clock", "parameters": clock}, "unbalance": unbalance},
            "wires": [["clock.theta", "unbalance.theta"], ["clock.speed", "unbalance.speed"]],
            "solver": {"step": H, "stop": 0.5, **solver},
            "record": ["unbalance.force"],
        }
    )


def exact(clock: dict[str, Any], step: int) -> tuple[float, float, float]:
    """Return W^2, cos theta and sin theta at a step, the angle from 60 digits."""
    t, first = Decimal(step) * Decimal(H), Decimal(clock["speed"])
    rate = Decimal(clock.get("acceleration", 0.0))
    rising = min(t, (Decimal(clock["speed_limit"]) - first) / rate) if rate else t
    angle = first * t + rate * rising * (t - rising / 2)
    rest = float(angle - 2 * PI * (angle / (2 * PI)).to_integral_value())
    return float((first + rate * rising) ** 2), math.cos(rest), math.sin(rest)


@pytest.mark.slow
@pytest.mark.parametrize("clock", [{"speed": 314.15926535}, RAMP])
def test_the_force_is_exact_over_ten_million_steps(clock: dict[str, Any]) -> None:
    """Within 1e-12 of its amplitude, where cos(W t) has the rounding of W t, half of 2^-34 at 3.1e5 rad."""
    found = simulate(turned(clock, stop=STEPS * H, record_every=EVERY))
    worst = 0.0
    for k, force in enumerate(found["unbalance.force"]):
        size, c, s = exact(clock, k * EVERY)
        worst = max(worst, abs(force[0] / size - c), abs(force[1] / size - s))
    assert worst < 1e-12


@pytest.mark.parametrize("acceleration", [0.5, 5.0, 200.0, -40.0])
def test_a_ramp_is_as_exact_however_steep(acceleration: float) -> None:
    """FAULT: rounding of the step, and of a cosine beside 1, added up to 1e-12 of the force and more in a block."""
    clock = {
        "profile": "ramp",
        "speed": 100.0,
        "acceleration": acceleration,
        "speed_limit": 500.0 if acceleration > 0 else 10.0,
    }
    steps, every = 19_000, 7
    found = simulate(turned(clock, stop=steps * H, record_every=every))["unbalance.force"]
    worst = 0.0
    for k in range(steps // every):
        size, c, s = exact(clock, k * every)
        worst = max(worst, abs(found[k, 0] / size - c), abs(found[k, 1] / size - s))
    assert worst < 1e-13


def test_an_angle_that_does_not_turn_evenly_is_computed_as_it_is() -> None:
    """The speed rises and falls within a block of steps: the numbers of the virtual machine, which rotates nothing."""
    plain, found = (simulate(turned(SAW, stop=0.02), use_compiler=one)["unbalance.force"] for one in (False, True))
    np.testing.assert_allclose(found, plain, rtol=0, atol=1e-12 * np.abs(plain).max())


@pytest.mark.parametrize("begin", [0.0005, 0.0008, 0.0259, 0.0263])
def test_what_rises_and_returns_between_two_blocks_is_not_lost(begin: float) -> None:
    """The angle is the same straight line before and behind a swing of 2 ms."""
    times = [begin + by for by in (0.0, 0.0005, 0.0015, 0.002)]
    swing = {"profile": "table", "times": times, "speeds": [100.0, 1000.0, -800.0, 100.0]}
    plain, found = (simulate(turned(swing, stop=0.1), use_compiler=one)["unbalance.force"] for one in (False, True))
    np.testing.assert_allclose(found, plain, rtol=0, atol=1e-12 * np.abs(plain).max())


def test_steps_of_another_start_each_are_those_of_one_run() -> None:
    """As a master takes them: from instant to instant, without vectors."""
    whole, apart = instance(), instance()
    rows = np.empty((300, whole.n_y))
    whole.run(0, 300, 0.0, H, 1, rows)
    for k in range(300):
        apart.run(0, 1, k * H, H, 1, rows[:1])
        apart.run(0, 0, 123.0, H, 1, rows[:0])
    np.testing.assert_allclose(apart.x, whole.x, rtol=1e-12, atol=1e-15 * np.abs(whole.x).max())


def instance() -> CompiledInstance:
    model = compile_diagram(load("jeffcott"))
    made = make_instance(model, ["rotor.displacement"], model.p0)
    assert isinstance(made, CompiledInstance)
    made.start(0.0)
    return made


def test_a_run_in_pieces_is_the_same_to_the_last_bit() -> None:
    """Also from a saved state, and where values at its present instant, or at others, are asked for between."""
    whole, parts = instance(), instance()
    rows, other = np.empty((1000, whole.n_y)), np.empty((1000, whole.n_y))
    whole.run(0, 1000, 0.0, H, 1, rows)
    at = [0, 1, 255, 256, 300, 301, 777, 1000]
    for begun, end in pairwise(at):
        saved = parts.save()
        parts.run(begun, end + 5, 0.0, H, 1, np.empty((1000, whole.n_y)))
        parts.restore(saved)
        assert parts.record(begun * H, parts.x).tolist() == rows[begun].tolist()
        parts.derivative(0.1234, np.array(parts.x))
        parts.run(begun, end, 0.0, H, 1, other[begun:])
    np.testing.assert_array_equal(other, rows)
    np.testing.assert_array_equal(parts.x, whole.x)


def test_after_another_start_nothing_is_left_of_a_run() -> None:
    one, fresh = instance(), instance()
    rows = np.empty((500, one.n_y))
    one.run(0, 500, 0.0, H, 1, rows)
    one.start(0.0)
    np.testing.assert_array_equal(one.record(500 * H, np.array(fresh.x)), fresh.record(500 * H, np.array(fresh.x)))


def test_what_decides() -> None:
    """A block of 256 steps rotates 512 times; a step that grows by 1e-17 rad in it is the same."""
    source = emit_c(compile_diagram(load("jeffcott")).kernel(()))
    assert "#define RS_BLOCK 256 " in source
    assert "#define RS_STILL 1e-17 " in source
    assert "#define RS_FEW 8 " in source
    assert "#define RS_LARGEST 1e290 " in source
    assert LARGEST_NUMBER == 1e290
