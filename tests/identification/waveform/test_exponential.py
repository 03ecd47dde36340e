"""Exponential steps of a turning shaft: against SciPy's integration, their order, derivatives, and fallbacks."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rotorsim.identification.waveform.driven import exponential
from rotorsim.identification.waveform.driven.equations import DrivenEquations, driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.driven.split import Split
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.model.linearity import semi_linear
from rotorsim.model.load import load

DT, SAMPLES = 1e-3, 300
OUTPUTS = ["rotor.displacement[1]", "rotor.displacement[2]"]
KINDS = dict.fromkeys(("clock.theta", "clock.speed", "clock.acceleration"), "smooth")
INPUTS = ["clock.theta", "clock.speed", "clock.acceleration"]
SPEED, ACCELERATION = 300.0, 400.0  # at first [rad/s], and after [rad/s^2]
THETA = np.array([76.0, 24e-6, 2e14])  # damping, eccentricity, cubic stiffness
START = np.array([2e-5, 1e-5, 1e-4, 0.0, 0.0, 0.01, 0.0, 0.02])
ROTOR = {
    "schema_version": 1,
    "name": "disc",
    "blocks": {
        "clock": {"type": "clock", "parameters": {"speed": SPEED}},
        "rotor": {"type": "rotor_4dof"},
        "unbalance": {"type": "unbalance", "parameters": {"phase": 0.0}},
        "spring": {"type": "cubic_stiffness", "parameters": {"stiffness": THETA[2]}},
    },
    "wires": [
        ["clock.theta", "unbalance.theta"],
        ["clock.speed", "unbalance.speed"],
        ["clock.acceleration", "unbalance.acceleration"],
        ["clock.speed", "rotor.speed"],
        ["unbalance.force", "rotor.force"],
        ["rotor.displacement", "spring.displacement"],
        ["spring.force", "rotor.force"],
    ],
    "solver": {"method": "rk4", "step": "1 ms", "stop": "1 s"},
    "record": ["rotor.displacement"],
    "identify": {"rotor.viscous_damping": {}, "unbalance.eccentricity": {}, "spring.stiffness": {}},
}


def equations_of(document: dict = ROTOR) -> DrivenEquations:
    diagram = load(document)
    return driven_equations(diagram, OUTPUTS, INPUTS, diagram.free)


@pytest.fixture(scope="module")
def equations() -> DrivenEquations:
    return equations_of()


def driven(samples: int, sub: int, acceleration: float = ACCELERATION) -> np.ndarray:
    """Return angle, speed and acceleration at ends and middles of steps, (N, 2 sub + 1, 3)."""
    t = (np.arange(samples)[:, None] + np.arange(2 * sub + 1) / (2 * sub)) * DT
    speed = SPEED + acceleration * t
    return np.stack([SPEED * t + acceleration * t**2 / 2, speed, np.full_like(t, acceleration)], axis=2)


def integrated(theta: np.ndarray, samples: int = SAMPLES, acceleration: float = ACCELERATION) -> np.ndarray:
    """Return the displacements (N, 2) of the disc by SciPy; u and a are complex.

    2 u'' + c u' + 11 a' + 7.6e5 u + 8900 a = -k |u|^2 u + 2 e (W^2 - i W') exp(i theta)
    0.0024 a'' + 11 u' + 6 a' + 8900 u + 2350 a = 0.0048 i W a'
    """
    c, e, k = theta

    def rates(t, x):
        u, a, du, da = x[0] + 1j * x[1], x[2] + 1j * x[3], x[4] + 1j * x[5], x[6] + 1j * x[7]
        speed, angle = SPEED + acceleration * t, SPEED * t + acceleration * t**2 / 2
        force = 2.0 * e * (speed**2 - 1j * acceleration) * np.exp(1j * angle) - k * abs(u) ** 2 * u
        ddu = (force - c * du - 11 * da - 7.6e5 * u - 8900 * a) / 2.0
        dda = (0.0048j * speed * da - 11 * du - 6 * da - 8900 * u - 2350 * a) / 0.0024
        return [part for z in (du, da, ddu, dda) for part in (z.real, z.imag)]

    times = np.arange(samples) * DT
    options = {"rtol": 1e-12, "atol": 1e-15, "method": "DOP853"}
    return solve_ivp(rates, (0, times[-1]), START, t_eval=times, **options).y[:2].T


def stepped(equations: DrivenEquations, theta: np.ndarray, sub: int, acceleration: float = ACCELERATION):
    p, v = equations.parameters(equations.model.p0, theta), driven(SAMPLES, sub, acceleration)
    return Simulation(equations).in_exponential_steps(p, START, v, DT)


@pytest.mark.slow
@pytest.mark.parametrize("cubic", [THETA[2], 0.0])
def test_the_error_falls_with_the_fourth_power_of_the_step(equations, cubic):
    theta = np.array([*THETA[:2], cubic])
    exact = integrated(theta, acceleration=0.0)
    errors = [np.abs(stepped(equations, theta, sub, 0.0)[0] - exact).max() for sub in (1, 2, 4)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.6)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4, abs=0.6)


@pytest.mark.slow
def test_steps_are_more_accurate_than_those_of_runge_kutta_of_four_times_their_number():
    """x' = A x + q: a tilt that is fast in a step of Runge-Kutta is exact here."""
    document = {**ROTOR, "blocks": {k: b for k, b in ROTOR["blocks"].items() if k != "spring"}}
    document["wires"] = [wire for wire in ROTOR["wires"] if "spring" not in "".join(wire)]
    document["identify"] = {key: {} for key in ROTOR["identify"] if "spring" not in key}
    linear, exact = equations_of(document), integrated(np.array([*THETA[:2], 0.0]), acceleration=0.0)
    p = linear.parameters(linear.model.p0, THETA[:2])
    own = Simulation(linear).in_exponential_steps(p, START, driven(SAMPLES, 1, 0.0), DT)[0]
    steps = Simulation(linear).simulate(p, START, driven(SAMPLES, 4, 0.0), DT)[0]
    assert np.abs(own - exact).max() < np.abs(steps - exact).max()


def test_derivatives_are_those_of_the_steps(equations):
    _, derivatives = stepped(equations, THETA, 2)
    p, v = lambda theta: equations.parameters(equations.model.p0, theta), driven(SAMPLES, 2)
    simulation = Simulation(equations)
    for j in range(len(THETA) + len(START)):
        step = 1e-5 * THETA[j] if j < len(THETA) else 1e-8
        ends = []
        for sign in (1, -1):
            theta, start = THETA.copy(), START.copy()
            (theta if j < len(theta) else start)[j if j < len(theta) else j - len(theta)] += sign * step
            ends.append(simulation.in_exponential_steps(p(theta), start, v, DT, sensitivities=False)[0])
        expected = (ends[0] - ends[1]) / (2 * step)
        assert np.abs(derivatives[:, :, j] - expected).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.slow
def test_blocks_of_samples_follow_a_shaft_that_runs_up_fast(equations, monkeypatch):
    """In a block the speed is that of its middle: the error is of second order in its length."""
    exact, errors = integrated(THETA), {}
    for block in (exponential.BLOCK_SAMPLES, 16, 32):
        monkeypatch.setattr(exponential, "BLOCK_SAMPLES", block)
        errors[block] = np.abs(stepped(equations, THETA, 4)[0] - exact).max()
    assert errors[32] / errors[16] == pytest.approx(4, rel=0.5)
    assert errors[8] < 1e-4 * np.abs(exact).max()  # in 8 ms, in which the speed rises by 1 %


def test_what_changes_with_the_angle_or_is_not_linear_is_a_law(equations):
    split = Split.of(equations)
    assert (split.laws, [equations.inputs[k] for k in split.slow]) == (2, ["clock.speed"])
    assert split.r == 5  # the force of the spring and the unbalance in x and y, and 1


def test_no_shaft_no_compiler_or_a_run_that_diverges(equations, monkeypatch):
    p, v = equations.parameters(equations.model.p0, THETA), driven(SAMPLES, 1)
    assert Simulation(equations, use_compiler=False).in_exponential_steps(p, START, v, DT) is None
    soft = equations.parameters(equations.model.p0, np.array([-1e6, 24e-6, 0.0]))
    y, dy = Simulation(equations).in_exponential_steps(soft, START, v, DT)
    assert np.isfinite(y[0]).all()
    assert np.isnan(y[-1]).all()
    assert np.isnan(dy[-1]).all()
    diagram = load(ROTOR)
    still = driven_equations(diagram, OUTPUTS, [], diagram.free)
    assert Split.of(still) is None


def test_a_semi_linear_form_is_the_same_expression():
    x, u, s, p = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("s"), ca.SX.sym("p")
    touched = ca.fmax(x[0] - p, 0) * x[1]
    of = ca.vertcat(p * s * x[0] + s**2 * ca.cos(u) - 3 * touched / p, u * x[0] + x[1] + ca.sin(x[1]), s / p + x[0])
    found = semi_linear(of, x, u, s)
    assert found.w.numel() == 5  # unbalance, contact, what the input multiplies, the sine, what is slow
    B = ca.jacobian(found.of, ca.vertcat(x, found.w))
    assert not ca.depends_on(B, ca.vertcat(x, u, found.w))
    assert ca.depends_on(B, s)
    assert not ca.depends_on(ca.substitute(found.of, ca.vertcat(x, found.w), ca.SX.zeros(7)), s)
    both = [ca.Function("f", [x, u, s, p], [e]) for e in (of, ca.substitute(found.of, found.w, found.phi))]
    for point in np.random.default_rng(1).normal(size=(5, 5)):
        given = point[:2], point[2], point[3], abs(point[4])
        np.testing.assert_allclose(both[0](*given), both[1](*given), rtol=1e-14)


SHAFT = {
    **ROTOR,
    "name": "shaft",
    "blocks": {
        "clock": {"type": "clock", "parameters": {"speed": SPEED}},
        "rotor": load("fe_rigid").document["blocks"]["rotor"],
        "unbalance": {"type": "unbalance", "parameters": {"mass": 2.0, "eccentricity": 1e-3, "phase": 0.0}},
        "spring": {"type": "cubic_stiffness", "parameters": {"stiffness": 1e11}},
    },
    "wires": [[end.replace("rotor.force", "rotor.force[3]") for end in wire] for wire in ROTOR["wires"]],
    "identify": {"rotor.disc_damping[1]": {}, "unbalance.eccentricity": {}, "spring.stiffness": {}},
}
SHAFT["wires"][5] = ["rotor.displacement[3]", "spring.displacement"]


def test_modes_that_are_left_out_of_matrices_are_those_left_out_of_expressions():
    """Half of the modes of a shaft with a spring whose law they feel: displacements, velocities, derivatives."""
    diagram, rng = load(SHAFT), np.random.default_rng(3)
    outputs = ["rotor.displacement[2,1]", "rotor.displacement[3,2]", "rotor.velocity[3,1]"]
    equations = driven_equations(diagram, outputs, INPUTS, diagram.free, fastest=2e4)
    structure = equations.structure
    assert (equations.n, len(structure.whole)) == (20, 40)
    p, v = equations.parameters(equations.model.p0, np.array([50.0, 1e-3, 1e11])), driven(SAMPLES, 4)
    start = 1e-4 * rng.normal(size=equations.n) * np.where(structure.kept < 20, 1.0, 100.0)
    own, expressions = Simulation(equations), Simulation(replace(equations, structure=None))
    (y, dy), (z, dz) = (one.in_exponential_steps(p, start, v, DT) for one in (own, expressions))
    assert np.abs(y - z).max(axis=0) == pytest.approx(np.zeros(3), abs=1e-6 * np.abs(z).max(axis=0).min())
    assert (np.abs(dy - dz).max(axis=(0, 1)) < 1e-6 * np.abs(dz).max(axis=(0, 1))).all()
    without = equations.parameters(equations.model.p0, np.array([50.0, 1e-3, 0.0]))
    assert np.abs(own.in_exponential_steps(without, start, v, DT)[0] - y).max() > 0.1 * np.abs(y).max()
    at = np.zeros((1, 1)), start[:, None], v[0, 0][:, None], p[:, None]
    A, laws = Split.of(equations).jacobians(*at)
    changed = equations.matrices[0](*at) - A
    assert np.abs(laws - changed).max() < 0.1 * np.abs(changed).max()  # but for the flexibility of the modes left out


def test_steps_follow_what_laws_change_of_the_modes(equations):
    """A cubic spring at rest changes none, however fast the rest is; bent by u it adds 3 k u^2 along it."""
    simulation, v = Simulation(equations), driven(1, 1)[0, 0][:, None]
    p, t, x = equations.parameters(equations.model.p0, THETA)[:, None], np.zeros((1, 1)), np.zeros((8, 1))
    split = simulation.exponential(p[:, 0], DT, dict.fromkeys(INPUTS, (300.0, 420.0)))

    def modes(x: np.ndarray) -> np.ndarray:
        return np.sort(np.abs(np.linalg.eigvals(equations.matrices[0](t, x, v, p)[0])))

    assert simulation.fastest_eigenvalue(t, x, v, p, split) == pytest.approx([0.0])
    at_rest, x[0] = modes(x), 1e-4
    found = simulation.fastest_eigenvalue(t, x, v, p, split)
    assert found == pytest.approx([np.abs(modes(x) - at_rest).max()], rel=0.1)
    assert simulation.fastest_eigenvalue(t, x, v, p, None) == pytest.approx([modes(x)[-1]])


def test_steps_that_are_not_exponential_are_as_short_as_the_fastest_mode_needs(equations, monkeypatch):
    """FAULT: where matrices cannot be interpolated, steps of Runge-Kutta were those of exponential ones."""
    monkeypatch.setattr(exponential, "MOST_POINTS", 1)
    p = equations.parameters(equations.model.p0, THETA)
    assert Simulation(equations).exponential(p, DT, dict.fromkeys(INPUTS, (300.0, 420.0))) is None
    run = SampledRun("a", dict(zip([*INPUTS, *OUTPUTS], np.zeros((5, 2)), strict=True)), KINDS, DT * np.arange(2), {})
    run.values["clock.speed"][:] = SPEED, SPEED + 1.0
    search = OutputErrorSearch(
        (Simulation(equations_of()),), [run], dict.fromkeys((("", name) for name in OUTPUTS), 1.0)
    )
    fastest = np.abs(np.linalg.eigvals(equations.matrices[0](0.0, np.zeros(8), driven(1, 1)[0, 0], p)[0])).max()
    assert search.substeps(search.first()) >= fastest * DT / 2.0 > 1.0
