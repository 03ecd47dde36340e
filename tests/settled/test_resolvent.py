"""The response of many runs at many orders, by inverses and by the ports of what nothing moves."""

from itertools import pairwise

import numpy as np
import pytest

from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from rotorsim.settled.equations import Equations
from rotorsim.settled.motion import DENSE, LinearMotion
from rotorsim.settled.nonlinear import NonlinearMotion
from rotorsim.settled.ports import open_ports
from rotorsim.settled.resolvent import DynamicStiffness, product, resolvent_of
from rotorsim.settled.slow_states import ALL_MODES, slow_states

SPEEDS = np.array([150.0, -260.0, 410.0])
SLOW = [np.array([], int), np.array([2]), np.array([0, 5])]


def systems(n: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(n)
    A = random.standard_normal((3, n, n)) - 2 * np.sqrt(n) * np.eye(n)
    return A, 1j * np.array([[10.0], [20.0], [31.0]]) * np.arange(4)


def test_the_response_solves_the_system():
    n = 30
    A, s = systems(n)
    random = np.random.default_rng(1)
    right = random.standard_normal((3, 4, n, 2)) + 1j * random.standard_normal((3, 4, n, 2))
    X = resolvent_of(A, s, SLOW).gain @ right
    for r in range(3):
        for k in range(4):
            matrix, b = s[r, k] * np.eye(n) - A[r], right[r, k]
            if k == 0 and len(SLOW[r]):  # slow states rest, and their equations are not asked for
                kept = np.setdiff1d(np.arange(n), SLOW[r])
                assert np.abs(X[r, 0, SLOW[r]]).max() == 0.0
                matrix, b, x = matrix[np.ix_(kept, kept)], b[kept], X[r, 0, kept]
            else:
                x = X[r, k]
            assert np.abs(matrix @ x - b).max() < 1e-11 * np.abs(b).max() * n


def test_ports_respond_as_the_whole_does_to_what_moves_them():
    n, ranks = 40, 3
    A, s = systems(n)
    random = np.random.default_rng(2)
    B = random.standard_normal((n, ranks))
    columns = np.array([4, 7, 8, 30])
    samples = [1e-9 * B @ random.standard_normal((ranks, 5)), 1e6 * B[:, :1]]  # of any size
    ports = open_ports(A, s, SLOW, columns, samples)
    assert len(ports.rows) == ranks
    assert ports.columns.tolist() == [0, 2, 4, 5, 7, 8, 30]  # the slow states are seen, too
    D = np.zeros((3, n, n))
    D[:, :, columns] = np.einsum("ij,rjk->rik", B, 0.3 * random.standard_normal((3, ranks, len(columns))))
    force = np.einsum("ij,rkjm->rkim", B, random.standard_normal((3, 4, ranks, 2)))
    whole = resolvent_of(A + D, s, SLOW)
    change = (A + D)[:, ports.rows[:, None], ports.columns] - ports.within
    part = ports.closed(change)
    expected = (whole.gain @ force)[:, :, ports.columns]
    assert part.gain @ force[:, :, ports.rows] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    for r in range(3):
        assert part.slow[r] == pytest.approx(whole.slow[r][ports.columns], rel=1e-9, abs=1e-9)


def test_a_dynamic_stiffness_solves_the_system_without_its_velocities():
    """Positions whose rates are states, one beside an acceleration (a chain of three), first-order states and one that
    rests; forces on all, where nothing rests on that of positions, too."""
    n, m = 20, 7
    A, s = systems(n)
    A, s = A[0], s[0]
    positions, velocities = np.arange(0, 2 * m, 2), np.arange(1, 2 * m, 2)
    A[positions] = 0.0
    A[positions, velocities] = 1.0
    A[16] = np.eye(n)[0]  # the integral of a position: its rate is a state that is a position itself
    resting = np.array([17])
    stiffness = DynamicStiffness.of(A, s, resting)
    assert stiffness.positions.tolist() == [*positions]
    assert stiffness.velocities.tolist() == [*velocities]
    assert stiffness.size == 4 * 13 * 13 * 16
    random = np.random.default_rng(4)
    F = random.standard_normal((4, n, 3)) + 1j * random.standard_normal((4, n, 3))
    X = stiffness.solve(F)
    F[0, resting] = 0.0
    expected = resolvent_of(A[None], s[None], [resting]).gain[0] @ F
    assert np.abs(X - expected).max() < 1e-13 * np.abs(X).max()
    assert not X[0, resting].any()


@pytest.mark.parametrize("n", [44, ALL_MODES + 20])
def test_slow_states_of_large_systems_are_those_of_all_modes(n):
    random = np.random.default_rng(3)
    blocks = np.diag(-np.linspace(40.0, 900.0, n))
    blocks[3, 3], blocks[11, 11], blocks[12, 12] = -0.07, -0.02, -0.02  # two of them alike
    T = np.eye(n) + 0.02 * random.standard_normal((n, n))
    A = T @ blocks @ np.linalg.inv(T)
    assert slow_states(A, 1.0).tolist() == [3, 11, 12]
    assert slow_states(A + 50.0 * np.eye(n) - 100.0 * np.eye(n), 1.0).tolist() == []


@pytest.mark.parametrize("n", [24, ALL_MODES])
def test_slow_states_of_two_axes_that_are_exactly_alike(n):
    axis = np.diag(-np.linspace(40.0, 900.0, n)) + 2.0 * np.eye(n, k=1)
    axis[5, 5] = -0.07
    A = np.kron(axis, np.eye(2))
    assert slow_states(A, 1.0).tolist() == [10, 11]
    assert slow_states(np.kron(axis, np.eye(3)), 1.0).tolist() == [15, 16, 17]


def machine(**parameters):
    document = shipped_diagrams()["fe_rigid"]
    diagram = load(document)
    free = [item for item in diagram.free if item.name != "crack_phase"]
    model = compile_diagram(diagram)
    outputs = [f"rotor.displacement[{node},{axis}]" for node in (2, 3, 5) for axis in (1, 2)]
    p = np.array([model.parameter_vector({"speed": speed, "controller.KD": 3.0 + r}) for r, speed in enumerate(SPEEDS)])
    return model, [*outputs, "controller.current[1]"], free, p


def test_a_beam_moves_by_way_of_its_ports_as_by_all_its_states():
    model, outputs, free, p = machine()
    equations = Equations(model, outputs, free)
    assert equations.n > DENSE
    motion = LinearMotion(equations, p, SPEEDS, 7, np.ones(3), np.array([0.0, 0.4, 1.1]))
    motion.condensed(equations.theta0)
    theta = equations.theta0 * np.linspace(0.8, 1.3, len(free))
    whole, part = motion.response(theta), motion.condensed(theta)
    assert part.A.shape[2] < whole.A.shape[2]
    X, x = whole.states(), part.states()
    Y = whole.outputs(X)
    assert np.abs(part.outputs(x) - Y).max() < 1e-9 * np.abs(Y).max()
    slopes = whole.sensitivity(X)
    for j in range(len(free)):
        assert np.abs(part.sensitivity(x) - slopes)[..., j].max() < 1e-8 * np.abs(slopes[..., j]).max()
    for r in range(3):
        assert part.C[r] @ part.slow_states(r) == pytest.approx(whole.C[r] @ whole.slow_states(r), rel=1e-8, abs=1e-12)


def test_finer_meshes_change_the_motion_by_a_sixteenth_each():
    """Cubic elements err with the fourth power of their length. In beams of 4 mm, s^2 is 1e-11 of the entries of A."""
    document = load("two_amb_rotor").document
    outputs = [f"rotor.displacement[{node},1]" for node in (3, 4, 6, 7)]
    found = []
    for subdivisions in (1, 2, 4):
        document["blocks"]["rotor"]["parameters"]["subdivisions"] = subdivisions
        diagram = load(document)
        model = compile_diagram(diagram)
        p = np.array([model.parameter_vector({"speed": speed}) for speed in SPEEDS])
        motion = LinearMotion(Equations(model, outputs, diagram.free), p, SPEEDS, 3, np.ones(3), np.zeros(3))
        found.append(motion.predict(motion.equations.theta0).Y)
    first, second = (np.linalg.norm(fine - coarse) for coarse, fine in pairwise(found))
    assert first < 1e-3 * np.linalg.norm(found[-1])
    assert first / second == pytest.approx(16.0, rel=0.05)


def test_a_product_has_more_digits_than_rounding_leaves():
    """[B, D - B] [x, x] = D x of integers: sums of 2^80 that cancel but for 2^32."""
    random = np.random.default_rng(6)
    n, c = 60, 4
    B, D = random.integers(-(1 << 50), 1 << 50, (2 * n, n)), random.integers(-3, 4, (2 * n, n))
    x = random.integers(-(1 << 26), 1 << 26, (n, c))
    A, X = np.hstack([B, D - B]).astype(float), np.vstack([x, x]).astype(float)
    size = (np.abs(A) @ np.abs(X)).max()
    assert np.abs(A @ X - D @ x).max() > 2.0**-56 * size
    assert np.abs(product(A, X.view(complex)).view(float) - D @ x).max() < 2.0**-72 * size


def test_harmonic_balance_of_a_linear_beam_is_its_direct_response():
    model, outputs, free, p = machine()
    equations = Equations(model, outputs, free)
    motion, balance = (
        kind(equations, p, SPEEDS, 7, np.ones(3), np.array([0.0, 0.4, 1.1])) for kind in (LinearMotion, NonlinearMotion)
    )
    theta = equations.theta0 * np.linspace(0.8, 1.3, len(free))
    response = motion.response(theta)
    X = response.states()
    found = balance.predict(theta)
    assert found.settled.all()
    Y, slopes = response.outputs(X), response.sensitivity(X)
    assert np.abs(found.Y - Y).max() < 1e-9 * np.abs(Y).max()
    for j in range(len(free)):
        assert np.abs(found.sensitivity()[..., j] - slopes[..., j]).max() < 1e-8 * np.abs(slopes[..., j]).max()


def test_what_is_the_same_in_all_runs_becomes_a_number_and_changes_nothing():
    model, outputs, free, p = machine()
    whole, folded = Equations(model, outputs, free), Equations(model, outputs, free, p)
    slots = {slot for some in folded.slots for slot in some}
    assert len(folded.known) > 20
    assert not slots & set(folded.known)
    theta = whole.theta0 * np.linspace(0.8, 1.3, len(free))
    many = np.repeat(theta[None], len(p), 0)
    for key, matrix in whole.whole.matrices.items():
        for ours, theirs in zip(folded.whole.matrices[key](p, many), matrix(p, many), strict=True):
            assert np.abs(ours - theirs).max(initial=0.0) <= 1e-10 * np.abs(theirs).max(initial=0.0)
    for ours, theirs in zip(
        folded.whole.forcing(p, many, SPEEDS, 5), whole.whole.forcing(p, many, SPEEDS, 5), strict=True
    ):
        assert np.abs(ours - theirs).max() < 1e-10 * np.abs(theirs).max()


def test_known_parameters_of_other_runs_are_not_those_of_the_first():
    model, outputs, free, p = machine()
    folded = Equations(model, outputs, free, p)
    assert folded.at(p[::-1]) is folded
    other = p.copy()
    place = model.parameters["controller.KP"].start
    other[:, place] *= 1.5
    found = LinearMotion(folded, other, SPEEDS, 3, np.ones(3), np.zeros(3)).response(folded.theta0).A
    right = LinearMotion(Equations(model, outputs, free), other, SPEEDS, 3, np.ones(3), np.zeros(3))
    expected = right.response(folded.theta0).A
    assert found == pytest.approx(expected, rel=1e-10, abs=1e-10)
    assert not folded.at(other).known


def test_an_undamped_mode_at_an_order_has_no_response():
    """x'' = -100 x: at 10 rad/s s I - A is singular, and at others it responds."""
    A, force, here = np.array([[[0.0, 1.0], [-100.0, 0.0]]]), np.array([[0.0], [1.0]]), np.array([0])
    none = [np.zeros(0, int)]
    P = open_ports(A, 1j * np.array([[0.0, 20.0]]), none, here, [force]).P
    assert P.ravel() == pytest.approx([0.01, -1 / 300], rel=1e-12)
    with pytest.raises(np.linalg.LinAlgError):
        open_ports(A, 1j * np.array([[0.0, 10.0]]), none, here, [force])
