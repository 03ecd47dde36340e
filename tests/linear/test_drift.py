"""Poles at zero, of free bodies and of integrators without feedback, told from what rounding makes of them."""

import numpy as np
import pytest
from scipy.stats import ortho_group

from rotorsim.linear.control.root_locus import root_locus
from rotorsim.linear.drift import drifting_entries, eigenvectors
from rotorsim.linear.linearisation import linearise
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load

FREE = ("amb_a", "amb_b")  # bearings without which the rotor of `drawn_rotor` touches nothing


def chain(k: float = 1e8, m: float = 2.0) -> np.ndarray:
    """Return A of three free masses joined by springs: a double zero, and w^2 = k / m, 3 k / m."""
    K = k * np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    return np.block([[np.zeros((3, 3)), np.eye(3)], [-K / m, np.zeros((3, 3))]])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_free_chain_has_two_zeros_whatever_its_coordinates(seed):
    turn = ortho_group.rvs(6, random_state=seed)
    A = turn @ np.diag([1, 1, 1, 1e-4, 1e-4, 1e-4]) @ chain() @ np.diag([1, 1, 1, 1e4, 1e4, 1e4]) @ turn.T
    values, left, right = eigenvectors(A)
    assert right.shape == left.shape == (6, 4)
    assert (values[4:] == 0).all()
    frequencies = np.sort(np.abs(values[:4].imag))
    np.testing.assert_allclose(frequencies, np.sqrt([0.5e8, 0.5e8, 1.5e8, 1.5e8]), rtol=1e-12)
    size = np.abs(A).max()
    np.testing.assert_allclose(A @ right, right * values[:4], atol=1e-13 * size * np.abs(right).max())
    np.testing.assert_allclose(left.conj().T @ A, values[:4, None] * left.conj().T, atol=1e-13 * size)


def test_zeros_of_all_multiplicities_are_counted():
    jordan = np.diag([1.0, 1.0], 1)  # three integrators in a row
    values = eigenvectors(np.block([[jordan, np.ones((3, 1))], [np.zeros((1, 3)), -5.0]]))[0]
    assert values[0] == pytest.approx(-5.0, rel=1e-14)
    assert values[1:].tolist() == [0.0, 0.0, 0.0]
    assert eigenvectors(np.zeros((2, 2)))[0].tolist() == [0.0, 0.0]
    assert eigenvectors(np.zeros((0, 0)))[0].tolist() == []


def test_a_sampled_free_mass_has_two_multipliers_at_one():
    h = 1e-4
    M = np.array([[1, h, 0], [0, 1, h], [0, 0, 0.5]])  # position, velocity, force that is forgotten
    assert sorted(1 + eigenvectors(M - np.eye(3), about=1.0)[0].real) == pytest.approx([0.5, 1.0, 1.0], abs=1e-15)


@pytest.mark.slow
def test_the_modes_of_a_free_beam_are_no_rounding():
    at = {speed: modes(load("drawn_rotor", without=FREE), parameters={"speed": speed}) for speed in (0.0, 50.0, 100.0)}
    zeros = {speed: int((found.real_poles == 0).sum()) for speed, found in at.items()}
    assert zeros == {0.0: 12, 50.0: 10, 100.0: 10}  # four integrators; two translations and tilts, double or not
    conical = {speed: min(found.modes, key=lambda one: one.frequency_hz) for speed, found in at.items() if speed}
    assert conical[100.0].frequency_hz / conical[50.0].frequency_hz == pytest.approx(2.0, rel=1e-4)  # W I_p / I_t
    assert abs(conical[100.0].damping_ratio) < 1e-7
    assert at[0.0].notes == tuple(
        f"{name} has a pole at zero: nothing returns it"
        for name in ("rotor.position", "rotor.velocity", "controller_a.integral", "controller_b.integral")
    )


@pytest.mark.slow
def test_the_root_locus_of_a_free_beam_has_no_points_of_rounding():
    found = root_locus(load("drawn_rotor", without=FREE), "speed", [0.0, 100.0])
    assert found.zeros.tolist() == [12, 10]
    slowest = [np.abs(row[(row != 0) & np.isfinite(row)]).min() / 2 / np.pi for row in found.poles]
    assert slowest == pytest.approx([211.9, 1.2438], rel=1e-3)  # Hz: the first bent mode; the conical one
    assert found.stable.all()


def test_entries_that_drift_are_named_one_by_one_where_others_do_not():
    model = load("jeffcott")
    A = linearise(model, inputs=(), outputs=()).A
    whole = "controller.integral"
    names = [name for name, state in compile_diagram(model).states.items() for _ in range(int(np.prod(state.shape)))]
    first = names.index(whole)
    A[:, first] = A[first] = 0.0  # a gain of zero on one axis
    assert drifting_entries(compile_diagram(model), A) == [f"{whole}[1]"]
