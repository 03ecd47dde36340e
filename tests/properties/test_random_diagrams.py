"""Random diagrams: the generated C, the virtual machine and the blocks' own formulas must agree.

The formulas are written out here in plain Python; nothing of the compiler is used for them.
"""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.model.compiled import compile_diagram
from rotorsim.model.instance import make_instance
from rotorsim.model.load import load

STEP, STEPS = 1e-2, 12
CONSTANTS = [0.0, 1.0, -1.0, 0.5, 2.0, -3.0, 0.1]


def dead_zone(u: float, width: float) -> float:
    return math.copysign(max(abs(u) - width / 2, 0.0), u)


KINDS: dict[str, tuple[int, Any, Any]] = {
    # type: number of inputs, parameters from (a, n), formula of (inputs, a, n)
    "gain": (1, lambda a, n: {"gain": a}, lambda u, a, n: a * u[0]),
    "sum": (2, lambda a, n: {"signs": "+-" if n % 2 else "++"}, lambda u, a, n: u[0] - u[1] if n % 2 else u[0] + u[1]),
    "product": (2, lambda a, n: {"operations": "**"}, lambda u, a, n: u[0] * u[1]),
    "trigonometric": (
        1,
        lambda a, n: {"function": "cos" if a > 0 else "sin", "multiple": n},
        lambda u, a, n: (math.cos if a > 0 else math.sin)(n * u[0]),
    ),
    "saturation": (1, lambda a, n: {"lower": -0.4, "upper": 0.6}, lambda u, a, n: min(max(u[0], -0.4), 0.6)),
    "dead_zone": (1, lambda a, n: {"width": 0.3}, lambda u, a, n: dead_zone(u[0], 0.3)),
    "absolute": (1, lambda a, n: {}, lambda u, a, n: abs(u[0])),
    "math_function": (1, lambda a, n: {"function": "tanh"}, lambda u, a, n: math.tanh(u[0])),
    "min_max": (
        2,
        lambda a, n: {"function": "maximum" if n % 2 else "minimum", "count": 2},
        lambda u, a, n: max(u) if n % 2 else min(u),
    ),
}


@st.composite
def networks(draw: Any) -> tuple[int, list[tuple[str, float, int, list[int]]], list[int], list[float]]:
    """Return states, algebraic blocks (type, a, n, sources), sources of the states, start values.

    Source k < states is a state, then comes the ramp of time, then the algebraic blocks in order.
    """
    states = draw(st.integers(1, 4))
    blocks = []
    for k in range(draw(st.integers(1, 14))):
        kind = draw(st.sampled_from(sorted(KINDS)))
        sources = [draw(st.integers(0, states + k)) for _ in range(KINDS[kind][0])]
        blocks.append((kind, draw(st.sampled_from(CONSTANTS)), draw(st.integers(-4, 4)), sources))
    last = states + len(blocks)
    return (
        states,
        blocks,
        [draw(st.integers(0, last)) for _ in range(states)],
        [draw(st.floats(-1, 1)) for _ in range(states)],
    )


def document(network: Any) -> dict[str, Any]:
    states, blocks, rates, start = network
    names = [f"x{k}.output" for k in range(states)] + ["ramp.output"] + [f"b{k}.output" for k in range(len(blocks))]
    made: dict[str, Any] = {f"x{k}": {"type": "integrator", "parameters": {"initial": start[k]}} for k in range(states)}
    made["ramp"] = {"type": "ramp", "parameters": {"slope": 3.0}}
    wires = [[names[source], f"x{k}.input"] for k, source in enumerate(rates)]
    for k, (kind, a, n, sources) in enumerate(blocks):
        made[f"b{k}"] = {"type": kind, "parameters": KINDS[kind][1](a, n)}
        ports = ["input"] if len(sources) == 1 else ["input1", "input2"]
        wires += [[names[source], f"b{k}.{port}"] for source, port in zip(sources, ports, strict=True)]
    return {"blocks": made, "wires": wires, "record": names, "solver": {"step": STEP, "stop": STEP * STEPS}}


def values(network: Any, t: float, x: np.ndarray) -> list[float]:
    states, blocks, _, _ = network
    found = [*x, 3.0 * t]
    for kind, a, n, sources in blocks:
        found.append(float(KINDS[kind][2]([found[k] for k in sources], a, n)))
    assert len(found) == states + 1 + len(blocks)
    return found


def run(network: Any) -> np.ndarray:
    """Return every signal at every step by Kutta's method, shape (STEPS + 1, signals)."""

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        found = values(network, t, x)
        return np.array([found[k] for k in network[2]])

    x, rows = np.array(network[3]), []
    for k in range(STEPS):
        t, h = k * STEP, STEP
        rows.append(values(network, t, x))
        k1 = slope(t, x)
        k2 = slope(t + h / 2, x + h / 2 * k1)
        k3 = slope(t + h / 2, x + h / 2 * k2)
        k4 = slope(t + h, x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    rows.append(values(network, STEPS * STEP, x))
    return np.array(rows)


def compare(network: Any, use_compiler: bool) -> None:
    with np.errstate(all="ignore"):
        expected = run(network)
    if not (np.abs(expected) < 1e6).all():
        return  # products of products blow up: nothing to compare
    model = compile_diagram(load(document(network)))
    names = model.record_names()
    instance = make_instance(model, names, model.p0, use_compiler=use_compiler)
    rows = np.empty((STEPS + 1, instance.n_y))
    instance.start(0.0)
    assert instance.run(0, STEPS, 0.0, STEP, 1, rows) == STEPS
    rows[STEPS] = instance.record(STEPS * STEP, instance.x)
    scale = 1 + np.abs(expected).max()
    assert np.abs(rows - expected).max() < 1e-9 * scale


@settings(max_examples=40, deadline=None, derandomize=True)
@given(networks())
@pytest.mark.slow
def test_the_virtual_machine_runs_random_diagrams_as_their_formulas_say(network):
    compare(network, use_compiler=False)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(networks())
def test_compiled_c_runs_random_diagrams_as_their_formulas_say(network):
    compare(network, use_compiler=True)


@pytest.mark.parametrize("every", [1, 2, 5, 7])
@pytest.mark.parametrize("chunks", [(12,), (1, 11), (3, 4, 5), (5, 2, 4, 1)])
def test_rows_do_not_depend_on_how_a_run_is_cut(every, chunks):
    network = (1, [("gain", 2.0, 0, [0])], [2], [0.5])
    model = compile_diagram(load(document(network)))
    whole = run(network)
    for use_compiler in (True, False):
        instance = make_instance(model, model.record_names(), model.p0, use_compiler=use_compiler)
        instance.start(0.0)
        rows = np.full((STEPS // every + 2, instance.n_y), np.nan)
        n = 0
        for chunk in chunks:
            n = instance.run(n, n + chunk, 0.0, STEP, every, rows[-(-n // every) :])
        kept = -(-STEPS // every)
        assert rows[:kept] == pytest.approx(whole[:STEPS:every], rel=1e-12)
        assert np.isnan(rows[kept:]).all()
