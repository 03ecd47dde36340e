"""Linear equations from sample to sample: SciPy's exponentials, its integration, derivatives, and what is linear."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm, expm_frechet

from rotorsim.identification.waveform.driven.equations import DrivenEquations, driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.linear import sampled
from rotorsim.linear.sampled import Tangent, phi_functions, zero_order_hold
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.linearity import is_affine
from rotorsim.model.load import load
from rotorsim.settled.equations import is_linear
from tests.diagnosis.evidence.waveform.machines import OSCILLATOR

DT, SAMPLES = 0.02, 200
THETA = np.array([2.0, 3.0, 900.0])  # mass, damping, stiffness
START = np.array([0.02, -0.3])


def equations_of(extra: dict | None = None) -> DrivenEquations:
    document = {**OSCILLATOR, "blocks": {**OSCILLATOR["blocks"], **(extra or {})}}
    wires = [["oscillator.velocity", f"{name}.velocity"] for name in extra or {}]
    wires += [[f"{name}.force", "oscillator.force"] for name in extra or {}]
    diagram = load({**document, "wires": [*OSCILLATOR["wires"], *wires]})
    return driven_equations(diagram, ["oscillator.displacement", "oscillator.velocity"], ["drive.output"], diagram.free)


def force(samples: int = SAMPLES) -> np.ndarray:
    return 10 * np.cumsum(np.random.default_rng(3).normal(size=samples))


def run_of(kind: str, values: np.ndarray, time: np.ndarray | None = None) -> SampledRun:
    time = DT * np.arange(len(values)) if time is None else time
    measured = dict.fromkeys(("oscillator.displacement", "oscillator.velocity"), np.zeros(len(values)))
    return SampledRun("run", {"drive.output": values, **measured}, {"drive.output": kind}, time, {})


def search_of(kind: str, **options: object) -> OutputErrorSearch:
    simulation = Simulation(equations_of(), **options)
    return OutputErrorSearch((simulation,), [run_of(kind, force())], dict.fromkeys(simulation.signals, 1.0))


def phi_by_integral(M: np.ndarray, power: int) -> np.ndarray:
    s, w = np.polynomial.legendre.leggauss(40)
    return sum(0.5 * wk * ((1 + sk) / 2) ** power * expm((1 - sk) / 2 * M) for sk, wk in zip(s, w, strict=True))


@given(st.integers(1, 6), st.floats(1e-3, 30.0), st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_exponential_and_phi_functions_with_derivatives_are_those_of_scipy(n, size, seed):
    random = np.random.default_rng(seed)
    M, dM = random.normal(size=(n, n)), random.normal(size=(2, n, n))
    M *= size / np.linalg.norm(M)
    phi = phi_functions(Tangent(M, dM))
    scale = max(np.linalg.norm(expm(M)), 1.0)
    assert np.abs(phi.exp.value - expm(M)).max() < 1e-11 * scale
    assert np.abs(phi.one.value - phi_by_integral(M, 0)).max() < 1e-11 * scale
    assert np.abs(phi.two.value - phi_by_integral(M, 1)).max() < 1e-11 * scale
    assert np.abs(2 * phi.three.value - phi_by_integral(M, 2)).max() < 1e-11 * scale
    for direction, slope in zip(dM, phi.exp.slopes, strict=True):
        expected = expm_frechet(M, direction, compute_expm=False)
        assert np.abs(slope - expected).max() < 1e-10 * np.linalg.norm(expected)


def test_a_mode_far_faster_than_the_samples_is_exact():
    A, B = np.array([[[-1e7, 0.0], [1.0, -1.0]]]), np.array([[1e7], [0.0]])
    F, G = zero_order_hold(A, B, np.array([0.1]))
    rounding = 0.1 * 1e7 * np.finfo(float).eps  # as often as the step is doubled from where the fast mode is slow
    assert F[0] == pytest.approx(expm(0.1 * A[0]), abs=rounding)
    assert G[0, :, 0] == pytest.approx([1.0, 1 - np.exp(-0.1)], rel=1e-6)


@pytest.mark.parametrize("power", [0, 10, 20, 40])
def test_units_of_states_do_not_spoil_it(power):
    """FAULT: in units 2^20 apart the error was 8e-7, 2^30 apart 5 %, of a system whose modes are slow."""
    A, d = np.array([[0.0, 0.01, 0.0], [-10.0, -0.02, 0.01], [0.0, -0.03, -0.05]]), 2.0 ** np.array([0, power, -power])
    expected = expm(A) * d[:, None] / d
    F = phi_functions(Tangent(A * d[:, None] / d, np.zeros((0, 3, 3)))).exp
    assert (np.abs(F.value - expected) < 1e-13 * np.abs(expected)).all()


def test_beyond_thirty_doublings_there_is_no_answer():
    """2^30 eps = 2.4e-7 of a slow mode beside the fast one; in a search it is a point where the simulation diverges."""
    for stiffness, finite in ((4e12, True), (4e22, False)):
        search = search_of("hold")
        y, _ = search.simulated(np.array([2.0, 3.0, stiffness, 0.0, 0.0]), 0, 0, 1)
        assert np.isfinite(y).all() == finite
        assert np.isfinite(search.evaluate(np.array([2.0, 3.0, stiffness, 0.0, 0.0]), 1).cost) == finite


@pytest.mark.parametrize("kind", ["hold", "linear"])
@pytest.mark.parametrize("use_compiler", [True, False])
def test_a_linear_diagram_is_simulated_as_it_is_integrated(kind, use_compiler):
    search, u = search_of(kind, use_compiler=use_compiler), force()
    assert search.is_exact(0, 0)
    y, _ = search.simulated(np.concatenate([THETA, START]), 0, 0, 1)
    x, expected = START, [START]
    for k in range(SAMPLES - 1):

        def rates(t, x, k=k):
            f = u[k] + (u[k + 1] - u[k]) * t / DT if kind == "linear" else u[k]
            return x[1], (f - THETA[1] * x[1] - THETA[2] * x[0]) / THETA[0]

        x = solve_ivp(rates, (0, DT), x, rtol=1e-11, atol=1e-13, method="DOP853").y[:, -1]
        expected.append(x)
    assert np.abs(y - expected).max(axis=0) == pytest.approx([0, 0], abs=1e-9 * np.abs(expected).max())


def test_steps_converge_to_it_with_the_fourth_order():
    search, point = search_of("linear"), np.concatenate([THETA, START])
    exact = search.simulated(point, 0, 0, 1)
    stepped = OutputErrorSearch(search.systems, search.runs, search.weights, stepped=True)
    for k in (0, 1):  # outputs, and their derivatives
        errors = [np.abs(stepped.simulated(point, 0, 0, sub)[k] - exact[k]).max() for sub in (4, 8, 16)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.3)
        assert np.log2(errors[1] / errors[2]) == pytest.approx(4, abs=0.3)


@pytest.mark.parametrize("use_compiler", [True, False])
def test_derivatives_by_parameters_and_start(use_compiler):
    search, point = search_of("linear", use_compiler=use_compiler), np.concatenate([THETA, START])
    _, derivatives = search.simulated(point, 0, 0, 1)
    assert derivatives.shape == (SAMPLES, 2, 5)
    for j in range(5):
        step = np.zeros(5)
        step[j] = 1e-6 * max(abs(point[j]), 1.0)
        ends = [search.simulated(point + sign * step, 0, 0, 1, sensitivities=False)[0] for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step[j])
        assert np.abs(derivatives[:, :, j] - expected).max() < 1e-7 * np.abs(expected).max()


def test_without_a_compiler_the_numbers_are_the_same(monkeypatch):
    point, found = np.concatenate([THETA, START]), search_of("hold").simulated(np.concatenate([THETA, START]), 0, 0, 1)
    monkeypatch.setattr(sampled, "_response", lambda *_: None)
    for a, b in zip(found, search_of("hold").simulated(point, 0, 0, 1), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-13 * np.abs(b).max())


@pytest.mark.parametrize("use_compiler", [True, False])
def test_what_diverges_is_no_number_from_there_on(use_compiler):
    search = search_of("hold", use_compiler=use_compiler)
    y, derivatives = search.simulated(np.array([2.0, -3000.0, 900.0, 0.02, -0.3]), 0, 0, 1)
    gone = np.isnan(y).any(axis=1)
    assert gone[-1]
    assert not gone[0]
    assert (gone == np.isnan(derivatives).any(axis=(1, 2))).all()


def test_a_linear_diagram_needs_no_steps_for_its_fast_modes():
    search, stiff = search_of("hold"), np.array([2.0, 3.0, 9e8, 0.0, 0.0])
    assert search.substeps(stiff) == 1
    assert OutputErrorSearch(search.systems, search.runs, search.weights, stepped=True).substeps(stiff) == 64


def test_uneven_samples_and_curved_inputs_are_simulated_in_steps():
    simulation, time = Simulation(equations_of()), DT * np.arange(SAMPLES)
    time[70:] += 5 * DT
    runs = [run_of("hold", force()), run_of("band_limited", force()), run_of("hold", force(), time)]
    search = OutputErrorSearch((simulation,), runs, dict.fromkeys(simulation.signals, 1.0))
    assert [search.is_exact(0, r) for r in range(3)] == [True, False, False]


def test_dry_friction_is_not_linear_though_its_slope_is_zero():
    x, v, p = (ca.SX.sym(name) for name in "xvp")
    by = ca.vertcat(x, v)
    for affine in (p * x + ca.sin(p) * v + p**2, (x + 2 * v - 3) / p, -(x * p) * 2, ca.if_else(p > 0, x, 2 * v)):
        assert is_affine(affine, by)
    for other in (ca.sign(x), x * v, x**2, p / x, ca.if_else(x > 0, 1.0, 2.0), ca.fabs(v), ca.fmax(x, p)):
        assert not is_affine(other, by)
    for affine in (p * x + v, x + ca.sin(v), x / p - v**2, ca.if_else(p > 0, x, v)):
        assert is_affine(affine, x, v)
    for other in (v * x, x / v, ca.if_else(v > 0, x, 0.0), x * ca.sin(v * p)):
        assert not is_affine(other, x, v)
    friction = {"friction": {"type": "coulomb_friction", "parameters": {"friction": 1.0}}}
    assert equations_of().linear is not None
    assert equations_of(friction).linear is None


@pytest.mark.parametrize("law", ["sign", "gain"])
def test_a_sign_in_a_loop_is_not_linear_for_any_analysis(law):
    """FAULT: its slope is zero, so that a diagram with dry friction passed for linear, and its friction for nothing."""
    blocks = {"drive": {"type": "sine", "parameters": {"amplitude": 1.0, "frequency": 3.0}}, "sum": {"type": "sum"}}
    blocks |= {"speed": {"type": "integrator"}, "friction": {"type": law}, "back": {"type": "gain"}}
    wires = [["drive.output", "sum.input1"], ["back.output", "sum.input2"], ["sum.output", "speed.input"]]
    wires += [["speed.output", "friction.input"], ["friction.output", "back.input"]]
    document = {"schema_version": 1, "name": "braked", "blocks": blocks, "wires": wires, "record": ["speed.output"]}
    model = compile_diagram(load(document))
    assert model.linear == (law == "gain")
    assert is_linear(model, ["speed.output"]) == (law == "gain")


@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("use_compiler", [True, False])
def test_outputs_are_those_of_the_recursion_written_out(varying, use_compiler, monkeypatch):
    N, n, P, c, K = 7, 3, 2, 4, 5
    draw = np.random.default_rng(4).normal
    F, G, H, D = (draw(size=(N if varying else 1, *shape)) for shape in ((n, n), (n, P), (c, n), (c, P)))
    d = draw(size=(N, P, K))
    if not use_compiler:
        monkeypatch.setattr(sampled, "_recursion", lambda: None)
    found = sampled.outputs(F, G, H, D, d)
    x = np.zeros((n, K))
    for k in range(N):
        j = k if varying else 0
        np.testing.assert_allclose(found[k], H[j] @ x + D[j] @ d[k], rtol=1e-12, atol=1e-12)
        x = F[j] @ x + G[j] @ d[k]


def test_a_part_without_states_is_held_too():
    """Its outputs follow the inputs alone: no matrix exponential is asked for, and none is refused."""
    phi = phi_functions(Tangent(np.zeros((3, 0, 0)), np.zeros((2, 3, 0, 0))))
    assert phi.exp.value.shape == (3, 0, 0)
