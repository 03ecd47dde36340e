"""Operating points and linearisation against closed forms."""

import math

import casadi as ca
import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.linear.drift import drifting_states
from rotorsim.linear.linearisation import equilibrium, linearise
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from tests.reference.handmade import TABLE_2_1, handmade, jeffcott


def test_state_matrix_of_the_jeffcott_rotor_is_the_one_of_the_thesis():
    system = linearise(jeffcott(), inputs=(), outputs=("controller.current",))
    v = TABLE_2_1
    k = v["rotor.stiffness"] - v["amb.force_displacement_factor"] + 42.1 * 12200
    c = 76 + 42.1 * 3
    axis = np.array([[0, 1, 0], [-k / 2, -c / 2, -42.1 * 2000 / 2], [1, 0, 0]])
    np.testing.assert_allclose(system.A, np.kron(axis, np.eye(2)), rtol=1e-14)
    np.testing.assert_allclose(system.C, np.kron([[12200, 3, 2000]], np.eye(2)), rtol=1e-14)
    assert system.states[:3] == ("rotor.q[1]", "rotor.q[2]", "rotor.v[1]")
    assert system.output_units == ("A", "A")
    assert system.B.shape == (6, 0)


def test_injected_current_acts_through_the_force_current_factor():
    system = linearise(jeffcott(external="inject"))
    expected = np.zeros((6, 2))
    expected[2, 0] = expected[3, 1] = -42.1 / 2
    np.testing.assert_allclose(system.B, expected, rtol=1e-14)
    assert system.inputs == ("controller.current[1]", "controller.current[2]")
    assert system.outputs == ("rotor.displacement[1]", "rotor.displacement[2]")


def test_a_nonlinear_diagram_with_an_injected_signal_is_compiled():
    """FAULT of an earlier version: C with an undeclared input, a warning, and CasADi's virtual machine instead."""
    diagram = load("jeffcott_rub")
    model = compile_diagram(diagram, inject=("controller.displacement",))
    x = equilibrium(model, None, None, hold_drifting=True)
    assert model.without != "the C compiler failed"
    np.testing.assert_allclose(x, equilibrium(compile_diagram(diagram), None, None, hold_drifting=True), rtol=1e-12)


def test_nonlinear_bearing_is_linearised_at_its_equilibrium_under_weight():
    model = jeffcott(nonlinear_amb=True, opening="none", gravity=100.0, unbalance__eccentricity=0.0)
    x = equilibrium(model, t=None)
    np.testing.assert_allclose(x[:4], 0.0, atol=1e-15)  # the integral carries the weight
    current = 2000 * x[4]
    i0, gap = 1.0, 0.4e-3
    constant = 42.1 * gap**2 / (4 * i0)
    assert constant * (((i0 - current) / gap) ** 2 - ((i0 + current) / gap) ** 2) == pytest.approx(100.0, rel=1e-12)
    system = linearise(model, inputs=())
    k_s = 2 * constant * ((i0 - current) ** 2 + (i0 + current) ** 2) / gap**3
    assert system.A[2, 0] == pytest.approx((-7.6e5 + k_s - 42.1 * 12200) / 2, rel=1e-12)
    np.testing.assert_allclose(system.x, x, rtol=1e-12)


def test_equilibrium_needs_something_that_returns_every_state():
    with pytest.raises(RotorsimError) as caught:
        equilibrium(jeffcott(with_amb=False))
    assert [problem.subject for problem in caught.value.problems] == [
        "controller.integral[1]",
        "controller.integral[2]",
    ]
    assert caught.value.problems[0].what == (
        "no equilibrium: nothing returns this state, it may take any value or drift"
    )


def test_equilibrium_that_does_not_exist_names_the_block():
    model = handmade(
        {"spring.x": 1},
        {},
        lambda t, x, p, v: {"xdot": {"spring.x": x["spring.x"] ** 2 + 1}, "signals": {"spring.y": x["spring.x"]}},
        initial={"spring.x": 3.0},
    )
    with pytest.raises(RotorsimError, match=r"no equilibrium found: the rate of spring\.x"):
        equilibrium(model)


def test_a_jacobian_that_depends_on_time_is_averaged_over_one_turn_and_says_so():
    model = handmade(
        {"beam.x": 1},
        {"speed": 10.0},
        lambda t, x, p, v: {
            "xdot": {"beam.x": -(3 + ca.cos(p["clock.speed"] * t)) * x["beam.x"]},
            "signals": {"beam.y": x["beam.x"]},
        },
    )
    system = linearise(model, inputs=(), outputs=("beam.y",))
    assert system.A[0, 0] == pytest.approx(-3, rel=1e-14)
    assert system.notes == (
        "the Jacobian depends on time and was averaged over one turn; parametric resonance is not seen",
    )


def test_sampled_blocks_are_refused_by_name():
    model = handmade({"a.x": 1}, {}, lambda t, x, p, v: {"xdot": {"a.x": -x["a.x"]}, "signals": {"a.y": x["a.x"]}}, z=2)
    with pytest.raises(RotorsimError) as caught:
        linearise(model, inputs=(), outputs=("a.y",))
    assert str(caught.value) == (
        "error: held: linearise needs continuous blocks; this one has a sample time\n\n"
        "hint: `rotorsim swap` a continuous controller in, or use `rotorsim run`"
    )


def test_operating_point_of_a_wrong_size_is_refused():
    with pytest.raises(RotorsimError, match="operating point has 3 entries, 6 expected"):
        linearise(jeffcott(), inputs=(), at=np.zeros(3))


def test_response_is_the_transfer_function():
    hz = np.array([1.0, 40.0, 121.0])
    value = linearise(jeffcott(external="replace"), open_loop=True).response(hz)
    s = 2j * math.pi * hz
    expected = -42.1 / (2 * s**2 + 76 * s + 7.6e5 - 105210)
    np.testing.assert_allclose(value[:, 0, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(value[:, 0, 1], 0, atol=0)


def test_response_on_an_undamped_pole_is_infinite():
    oscillator = handmade(
        {"m.x": 1, "m.v": 1},
        {},
        lambda t, x, p, v: {
            "xdot": {"m.x": x["m.v"], "m.v": -x["m.x"] * (2 * math.pi) ** 2 + v["f.u"]},
            "signals": {"m.y": x["m.x"], "f.u": ca.SX(0)},
        },
        external={"f.u": 1},
    )
    value = linearise(oscillator, inputs=("f.u",), outputs=("m.y",)).response([0.5, 1.0])
    assert np.isfinite(value[0]).all()
    assert np.isinf(value[1]).all() or abs(value[1, 0, 0]) > 1e12


@pytest.mark.parametrize(
    ("matrix", "seeds", "reached"),
    [
        ([[-1.0, 0], [1, 0]], [1], [1]),  # integrator at the end of a chain
        ([[0.0, 0], [1, -1]], [0], [0, 1]),  # integrator that drives a filter
        ([[0.0, 1], [0, 0]], [0, 1], [0, 1]),  # free mass
        ([[0.0, 1], [-4, 0]], [], []),  # spring and mass
        ([[0.0, 0, 1, 0], [0, 0, 0, 1], [-1, 1, 0, 0], [1, -1, 0, 0]], [0, 1, 2, 3], [0, 1, 2, 3]),  # two free masses
    ],
)
def test_states_without_a_mean_are_found(matrix, seeds, reached):
    assert drifting_states(np.array(matrix)) == (seeds, reached)


def test_an_equilibrium_is_found_where_only_rounding_is_left():
    """A controller KP (1 + r^2 / a^2) with integral action holds the rotor at zero: nothing there has a size."""

    def build(t, x, p, v):
        q, w, integral = x["rotor.q"], x["rotor.v"], x["controller.integral"]
        r2 = ca.dot(q, q)
        current = 12200.0 * (1 + r2 / 400e-12) * q + 2000.0 * integral + 3.0 * w
        theta = p["clock.speed"] * t + 0.3
        force = 2 * 24e-6 * p["clock.speed"] ** 2 * ca.vertcat(ca.cos(theta), ca.sin(theta)) - ca.vertcat(19.62, 0)
        acceleration = (force - 76.0 * w - 760e3 * q + 105e3 * q - 42.1 * current) / 2.0
        return {
            "xdot": {"rotor.q": w, "rotor.v": acceleration, "controller.integral": q},
            "signals": {"rotor.displacement": q},
        }

    states = {"rotor.q": 2, "rotor.v": 2, "controller.integral": 2}
    model = handmade(states, {"speed": 157.0}, build, record=("rotor.displacement",))
    x = equilibrium(model, t=None)
    assert x[4] == pytest.approx(-19.62 / (42.1 * 2000), rel=1e-9)  # the integral carries the weight
    assert np.abs(x[:4]).max() < 1e-15
    assert abs(x[5]) < 1e-15
