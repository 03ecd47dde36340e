"""The finite element rotor against an assembly of its own, closed forms and textbook limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotorsim.blocks.common import beam as _beam
from scipy.linalg import eigh, solve

from tests.blocks.evaluation import prepare

E, RHO, D, L = 2.1e11, 7850.0, 0.016, 0.5
AREA, SECOND = np.pi * D**2 / 4, np.pi * D**4 / 64
PHI = 0.3


def rotor(elements=5, parameters=None, **options):
    nodes = elements + 1
    inputs = {"force": (nodes, 2), "moment": (nodes, 2), "speed": ()}
    values = {"element_length": L / elements, **(parameters or {})}
    return prepare("rotor_fe", inputs, values, {"elements": elements, "pinned_nodes": [1, nodes], **options})


def jacobian(block, speed):
    """Return d(q', v')/d(q, v) by superposition: the equations are linear."""
    nodes = block.shapes["force"][0]
    inputs = {"force": np.zeros((nodes, 2)), "moment": np.zeros((nodes, 2)), "speed": speed}
    n = block.initial["position"].size
    columns = []
    for name in ("position", "velocity"):
        for k in range(n):
            state = np.zeros(n)
            state[k] = 1.0
            found = block.evaluate(inputs, {name: state.reshape(-1, 2)}).derivatives
            columns.append(np.concatenate([found["position"].ravel(), found["velocity"].ravel()]))
    return np.array(columns).T


def frequencies(block, speed):
    slopes = jacobian(block, speed)
    n = len(slopes) // 2
    if not slopes[n:, n:].any():  # neither damping nor gyroscopic moments: w^2 of half the size
        values = 1j * np.sqrt(np.linalg.eigvals(-slopes[n:, :n]).real)
    else:
        values = np.linalg.eigvals(slopes)
    return np.sort(values.imag[values.imag > 0]) / (2 * np.pi)


def test_natural_frequencies_at_rest_are_the_published_ones():
    assert frequencies(rotor(), 0.0)[:6:2] == pytest.approx([54.3005, 338.398, 678.808], rel=1e-6)


def test_natural_frequencies_at_3000_rpm_are_the_published_ones():
    found = frequencies(rotor(), 3000 * np.pi / 30)[:4]
    assert [f"{x:.6g}" for x in found] == ["54.1532", "54.4399", "312.997", "364.277"]


@pytest.mark.slow
def test_a_pinned_shaft_has_the_frequencies_of_the_euler_bernoulli_beam():
    block = rotor(40, {"disc_mass": 0.0, "disc_polar_inertia": 0.0, "disc_diametral_inertia": 0.0})
    k = np.arange(1, 5)
    exact = (k * np.pi / L) ** 2 * np.sqrt(E * SECOND / (RHO * AREA)) / (2 * np.pi)
    assert frequencies(block, 0.0)[:8:2] == pytest.approx(exact, rel=2e-5)


@pytest.mark.slow
def test_a_pinned_timoshenko_shaft_has_the_frequencies_of_the_timoshenko_beam():
    """Roots of rho^2 I/(kG) w^4 - (rho A + rho I b^2 (1 + E/(kG))) w^2 + E I b^4 = 0 (Han et al. 1999)."""
    d, nu = 0.05, 0.3
    area, second = np.pi * d**2 / 4, np.pi * d**4 / 64
    kappa = 6 * (1 + nu) / (7 + 6 * nu)
    shear = E / (2 * (1 + nu))
    values = {"outer_diameter": d, "disc_mass": 0.0, "disc_polar_inertia": 0.0, "disc_diametral_inertia": 0.0}
    exact = []
    for k in (1, 2, 3):
        b = k * np.pi / L
        a2, a1, a0 = (
            RHO**2 * second / (kappa * shear),
            -(RHO * area + RHO * second * b**2 * (1 + E / (kappa * shear))),
            E * second * b**4,
        )
        exact.append(np.sqrt((-a1 - np.sqrt(a1**2 - 4 * a2 * a0)) / (2 * a2)) / (2 * np.pi))
    errors = [
        frequencies(rotor(n, values, theory="timoshenko", rotary_inertia=True), 0.0)[:6:2] / exact - 1 for n in (20, 40)
    ]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.03)  # the element converges with the square of its length
    assert errors[1][0] < 1e-5


@pytest.mark.slow
def test_shaft_gyroscopic_moments_split_the_pinned_rayleigh_beam():
    """rho A w^2 + rho I b^2 (w^2 - 2 W w) = E I b^4 for forward whirl of mode b = k pi / L."""
    d, speed = 0.05, 2000.0
    area, second = np.pi * d**2 / 4, np.pi * d**4 / 64
    values = {"outer_diameter": d, "disc_mass": 0.0, "disc_polar_inertia": 0.0, "disc_diametral_inertia": 0.0}
    block = rotor(20, values, rotary_inertia=True, shaft_gyroscopic=True)
    b = 2 * np.pi / L
    a, c = RHO * area + RHO * second * b**2, E * second * b**4
    half = RHO * second * b**2 * speed
    pair = np.array([-half + np.sqrt(half**2 + a * c), half + np.sqrt(half**2 + a * c)]) / a / (2 * np.pi)
    assert frequencies(block, speed)[2:4] == pytest.approx(pair, rel=1e-4)


def test_static_deflection_under_a_middle_load_is_p_l3_over_48_e_i():
    block = rotor(4, disc_nodes=[3])
    stiff = -jacobian(block, 0.0)[len(block.initial["position"].ravel()) :, : block.initial["position"].size]
    force = np.zeros((5, 2))
    force[2, 0] = 10.0
    inputs = {"force": force, "moment": np.zeros((5, 2)), "speed": 0.0}
    q = solve(stiff, block.evaluate(inputs).derivatives["velocity"].ravel())
    out = block.evaluate(inputs, {"position": q.reshape(-1, 2)}).outputs["displacement"]
    assert out[2, 0] == pytest.approx(10.0 * L**3 / (48 * E * SECOND), rel=1e-9)
    assert out[[0, 4]] == pytest.approx(0, abs=0)


def test_rayleigh_damping_of_the_shaft_is_a0_m_plus_a1_k_of_its_elements():
    a0, a1 = 3.0, 2e-5
    damped = jacobian(rotor(3, {"mass_damping": a0, "stiffness_damping": a1}), 0.0)
    n = len(damped) // 2
    plain = jacobian(rotor(3), 0.0)
    bare = jacobian(rotor(3, {"disc_mass": 0.0, "disc_diametral_inertia": 0.0, "disc_polar_inertia": 0.0}), 0.0)
    mass, shaft = (assembled(3, with_disc) for with_disc in (True, False))
    expected = -np.linalg.solve(mass, a0 * shaft) + a1 * plain[n:, :n]
    assert damped[n:, n:] == pytest.approx(expected, rel=1e-9, abs=1e-6 * np.abs(expected).max())
    assert bare[n:, :n] == pytest.approx(np.linalg.solve(shaft, mass @ plain[n:, :n]), rel=1e-8, abs=1.0)


def assembled(elements, with_disc):
    """Return the mass matrix in the block's order: free dof by node, x and y planes interleaved (App. B)."""
    h = L / elements
    one = (
        RHO
        * AREA
        * h
        / 420
        * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
            ]
        )
    )
    size = 2 * (elements + 1)
    mass = np.zeros((size, size))
    for e in range(elements):
        mass[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += one
    if with_disc:
        mass[4, 4] += 2.0
        mass[5, 5] += 0.0024
    free = [k for k in range(size) if k not in (0, size - 2)]
    return np.kron(mass[np.ix_(free, free)], np.eye(2))


@settings(max_examples=40, deadline=None)
@given(st.floats(0.01, 2), st.floats(0.0, 3), st.floats(0.1, 10))
def test_element_matrices_know_rigid_bodies_and_constant_curvature(length, phi, ei):
    k = np.array(_beam.stiffness(ei, length, phi))
    lift, turn = np.array([1, 0, 1, 0]), np.array([0, 1, length, 1])
    assert np.abs(k @ lift).max() < 1e-9 * np.abs(k).max()
    assert np.abs(k @ turn).max() < 1e-9 * np.abs(k).max()
    bent = np.array([0, 0, length**2 / 2, length])  # w = z^2 / 2: moments E I at the ends, no shear
    assert k @ bent == pytest.approx([0, -ei, 0, ei], abs=1e-9 * np.abs(k).max())
    mass = np.array(_beam.translation_mass(3.0, length, phi))
    assert lift @ mass @ lift == pytest.approx(3.0)
    assert turn @ mass @ turn == pytest.approx(3.0 * length**2 / 3)
    rotary = np.array(_beam.rotary_mass(0.7, length, phi))
    assert turn @ rotary @ turn == pytest.approx(0.7 * length)
    assert np.abs(rotary @ lift).max() < 1e-12


def test_element_matrices_without_shear_are_those_of_appendix_b():
    h = 0.37
    k = np.array(_beam.stiffness(2.0, h, 0.0))
    printed = (
        2.0
        / h**3
        * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
    )
    assert k == pytest.approx(printed, rel=1e-14)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 12), st.integers(0, 2**31))
def test_the_banded_factorisation_solves(size, seed):
    rng = np.random.default_rng(seed)
    full = np.zeros((size, size))
    banded = _beam.Banded(size)
    for i in range(size):
        for j in range(max(0, i - _beam.BAND), i + 1):
            value = float(rng.normal()) + (10.0 if i == j else 0.0)
            full[i, j] = full[j, i] = value
            banded.add(i, j, value)
    b = rng.normal(size=size)
    assert eigh(full, eigvals_only=True)[0] > 0
    assert _beam.solve_factored(*banded.factor(), list(b)) == pytest.approx(solve(full, b), rel=1e-9)
    assert banded.times(list(b)) == pytest.approx(full @ b, rel=1e-12, abs=1e-12)


def test_the_shear_coefficient_is_cowpers():
    assert _beam.shear_coefficient(0.3, 0.0, 1.0) == pytest.approx(0.886, abs=1e-3)  # Cowper (1966), solid circle
    assert _beam.shear_coefficient(0.3, 1 - 1e-9, 1.0) == pytest.approx(0.531, abs=1e-3)  # thin tube


@pytest.mark.slow
def test_operations_grow_linearly_with_elements():
    counts = [rotor(n).trace.function("derivatives", ("position", "velocity")).n_instructions() for n in (10, 20, 40)]
    assert counts[2] - counts[1] == pytest.approx(2 * (counts[1] - counts[0]), rel=0.01)


def test_nodes_that_do_not_exist_are_refused():
    with pytest.raises(AssertionError):  # `prepare` asserts that the block has nothing to say against its values
        rotor(5, disc_nodes=[7])
    block = rotor(5).block
    block.option.disc_nodes = [7]
    values = {"inner_diameter": np.array(0.02), "outer_diameter": np.array(0.016)}
    assert block.check(values) == [
        "disc_nodes has node 7; the rotor has nodes 1 to 6",
        "inner_diameter must be smaller than outer_diameter",
    ]
