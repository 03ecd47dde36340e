"""State feedback designed from the linearised plant."""

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.linear.control.design import closed_loop, design_state_feedback, plant_of, reduce_modes
from rotorsim.linear.state_space import StateSpace
from tests.reference.handmade import jeffcott


def test_plant_leaves_out_the_states_of_the_controller():
    plant = plant_of(jeffcott(external="replace"), "controller")
    assert plant.A.shape == (4, 4)
    np.testing.assert_allclose(plant.response(0.0)[0], -42.1 / (7.6e5 - 105210) * np.eye(2), rtol=1e-12)


@pytest.mark.parametrize("integral", [False, True])
@pytest.mark.parametrize("force_displacement", [105210.0, 9e5])  # the second bearing is unstable without control
def test_designed_controller_makes_the_loop_stable_with_the_expected_sign(integral, force_displacement):
    model = jeffcott(external="replace", amb__force_displacement_factor=force_displacement)
    found = design_state_feedback(model, integral=integral)
    plant = plant_of(model, "controller")
    matrices = tuple(found[key] for key in "ABCD")
    assert np.linalg.eigvals(closed_loop(plant, matrices)).real.max() < 0
    # the bearing pushes back: positive displacement, positive current where the plant is unstable
    if force_displacement > 7.6e5 and not integral:
        static = -found["C"] @ np.linalg.solve(found["A"], found["B"])
        assert (np.diag(static) > 0).all()
    assert found["D"].shape == (2, 2)


def test_integral_action_leaves_no_static_displacement():
    model = jeffcott(external="replace")
    found = design_state_feedback(model, integral=True)
    plant = plant_of(model, "controller")
    whole = closed_loop(plant, tuple(found[key] for key in "ABCD"))
    push = np.zeros(len(whole))
    push[2] = 1.0
    rest = np.linalg.solve(whole, -push)
    assert abs(plant.C @ rest[:4]).max() < 1e-8 * 1 / 3.3e5


def test_reduction_keeps_slow_modes_exactly_and_the_static_gain():
    rng = np.random.default_rng(1)
    blocks = [np.array([[-0.01 * w, w], [-w, -0.01 * w]]) for w in (1.0, 3.0, 40.0, 90.0, 200.0)]
    A = np.zeros((10, 10))
    for k, block in enumerate(blocks):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
    T = rng.normal(size=(10, 10))
    plant = StateSpace(T @ A @ np.linalg.inv(T), rng.normal(size=(10, 2)), rng.normal(size=(2, 10)), np.zeros((2, 2)))
    small = reduce_modes(plant, 5)  # a pair is never parted
    assert small.A.shape == (4, 4)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(small.A).imag), [-3, -1, 1, 3], rtol=1e-9)
    np.testing.assert_allclose(small.response(0.0)[0].real, plant.response(0.0)[0].real, rtol=1e-8)


def test_unknown_controller_is_refused():
    with pytest.raises(RotorsimError, match="no such block"):
        design_state_feedback(jeffcott(external="replace"), "controll")


def test_a_current_that_moves_nothing_is_refused():
    model = jeffcott(external="replace", amb__force_current_factor=0.0, amb__force_displacement_factor=9e5)
    with pytest.raises(RotorsimError) as caught:
        design_state_feedback(model)
    assert str(caught.value) == (
        "error: controller: its output does not act on its input 'displacement'\n\n"
        "hint: wire it to a bearing that moves what is measured; the force-current factor must not be zero"
    )
