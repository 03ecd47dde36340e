"""Scalar programs: every rewriting must leave the value as CasADi computes it."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.angle_recurrence import share_harmonics
from rotorsim.model.emit.program import Program

NAMES = ("t", "x", "p")
UNARY = [ca.sin, ca.cos, lambda a: -a, lambda a: a * a, ca.fabs, lambda a: 2 * a, ca.tanh, lambda a: a + a]
BINARY = [
    lambda a, b: a + b,
    lambda a, b: a - b,
    lambda a, b: a * b,
    lambda a, b: a / (b * b + 1),
    ca.fmin,
    lambda a, b: ca.if_else(a < b, a, b),
]


def evaluate(program: Program, outputs: list[int], inputs: dict[str, np.ndarray]) -> list[float]:
    """Evaluate a program in plain Python, independently of the C emitter."""
    value: dict[int, float] = {}
    for number in program.needed(outputs):
        op, a, b = program.nodes[number]
        if op == ir.INPUT:
            value[number] = float(inputs[a][b])
        elif op == ir.CONSTANT:
            value[number] = float(a)
        else:
            u, v = ca.SX.sym("u"), ca.SX.sym("v")
            made = ca.SX.binary(op, u, v) if b >= 0 else ca.SX.unary(op, u)
            f = ca.Function("f", [u, v], [made])
            value[number] = float(f(value[a], value[b] if b >= 0 else 0.0))
    return [value[k] for k in outputs]


@st.composite
def expressions(draw):
    symbols = {name: ca.SX.sym(name, 3) for name in NAMES}
    pool = [symbols[name][i] for name in NAMES for i in range(3)] + [ca.SX(v) for v in (0.0, 1.0, -1.0, 0.5, 3.0)]
    for _ in range(draw(st.integers(3, 25))):
        a = pool[draw(st.integers(0, len(pool) - 1))]
        if draw(st.booleans()):
            pool.append(draw(st.sampled_from(UNARY))(a))
        else:
            pool.append(draw(st.sampled_from(BINARY))(a, pool[draw(st.integers(0, len(pool) - 1))]))
    return symbols, pool[-4:]


def loaded(symbols, outputs, reassociate):
    function = ca.Function("f", [symbols[n] for n in NAMES], [ca.densify(ca.vertcat(*outputs))])
    program = Program(reassociate=reassociate)
    return function, program, program.load(function, NAMES)[0]


@settings(max_examples=60, deadline=None)
@given(expressions(), st.integers(0, 2**31), st.booleans())
def test_program_has_the_value_of_the_expression(made, seed, reassociate):
    symbols, outputs = made
    function, program, nodes = loaded(symbols, outputs, reassociate)
    values = {name: np.random.default_rng(seed).uniform(-2, 2, 3) for name in NAMES}
    expected = np.array(function(*[values[n] for n in NAMES])).ravel()
    found = evaluate(program, nodes, values)
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-9 * max(1.0, np.abs(expected).max()))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.integers(-9, 9), st.sampled_from([0.0, 1.0, -0.5])), min_size=1, max_size=8),
    st.floats(-50, 50),
    st.floats(-3, 3),
)
def test_harmonics_by_recurrence_equal_sines_and_cosines(terms, t, phase):
    symbols = {name: ca.SX.sym(name, 3) for name in NAMES}
    theta = symbols["p"][0] * symbols["t"][0] + symbols["p"][1]
    outputs = [f(k * (theta + q * symbols["p"][2]) + q) for k, q in terms for f in (ca.sin, ca.cos)]
    _, program, nodes = loaded(symbols, outputs, False)
    program.reassociate = True
    shared, new = share_harmonics(program, nodes)
    values = {"t": [t, 0, 0], "x": [0, 0, 0], "p": [1.7, phase, 0.3]}
    angle = 1.7 * t + phase
    exact = [f(k * (angle + q * 0.3) + q) for k, q in terms for f in (math.sin, math.cos)]
    assert np.allclose(evaluate(shared, new, {k: np.array(v) for k, v in values.items()}), exact, atol=1e-11)


def test_one_sine_and_one_cosine_serve_all_harmonics_of_an_angle():
    symbols = {name: ca.SX.sym(name, 3) for name in NAMES}
    theta = symbols["p"][0] * symbols["t"][0]
    outputs = [ca.cos(k * theta) for k in (1, 2, 3, 5, 7, 9)] + [ca.sin(2 * theta), ca.cos(theta + symbols["p"][1])]
    _, program, nodes = loaded(symbols, outputs, False)
    shared, new = share_harmonics(program, nodes)
    in_time = [
        shared.nodes[k][0]
        for k in shared.needed(new)
        if shared.levels[k] >= ir.LEVEL_TIME and shared.nodes[k][0] in (ir.SIN, ir.COS)
    ]
    assert sorted(in_time) == sorted([ir.SIN, ir.COS])


def test_angles_that_are_no_multiples_stay_as_they_are():
    symbols = {name: ca.SX.sym(name, 3) for name in NAMES}
    t = symbols["t"][0]
    outputs = [ca.sin(2.0 * t), ca.sin(3.1 * t), ca.cos(ca.sqrt(2) * t)]
    _, program, nodes = loaded(symbols, outputs, False)
    shared, new = share_harmonics(program, nodes)
    found = evaluate(shared, new, {"t": np.array([0.7, 0, 0]), "x": np.zeros(3), "p": np.zeros(3)})
    assert found == pytest.approx([math.sin(1.4), math.sin(2.17), math.cos(0.7 * math.sqrt(2))], rel=1e-14)


def test_what_depends_on_parameters_only_is_hoisted():
    symbols = {name: ca.SX.sym(name, 3) for name in NAMES}
    p, x = symbols["p"], symbols["x"]
    outputs = [x[0] * p[0] / p[1] * p[2]]
    _, program, nodes = loaded(symbols, outputs, True)
    work = [k for k in program.needed(nodes) if program.levels[k] == ir.LEVEL_STATE and program.nodes[k][0] != ir.INPUT]
    assert len(work) == 1  # one product with the hoisted p0 / p1 p2
    assert len(program.boundary(nodes, ir.LEVEL_PARAMETER)) == 1
