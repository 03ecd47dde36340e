"""What small forces change in a settled motion: by transfer matrices where it is linear, else by its derivatives."""

import numpy as np
import pytest

from rotorsim.identification.harmonic.experiment import Experiment, open_experiment
from rotorsim.settled.equations import Equations
from tests.identification import changed, made, recorded

SPEEDS = np.array([60.0, 190.0])
NODE_3, NODE_4 = [4, 5], [6, 7]  # of rotor.force, x and y
CRACK_FORCE = ("crack.force[1]", "crack.force[2]")


def experiment(*changes, free="eccentricity") -> Experiment:
    def change(document):
        document["identify"] = {free: {}}
        for one in changes:
            one(document)

    data = recorded(made("fe_rigid", SPEEDS.tolist(), gains=(12200.0, 0.0, 3.0)))
    return open_experiment(changed("fe_rigid", change), data, inject=["rotor.force"])


def asymmetric(document):
    """Add a shaft with a keyway: a stiffness that turns with it, so that order k answers to 2 - k."""
    document["blocks"]["keyway"] = {"type": "asymmetric_shaft", "parameters": {"asymmetry": 3e4, "phase": 0.4}}
    document["wires"] += [
        ["rotor.displacement[3]", "keyway.displacement"],
        ["clock.theta", "keyway.theta"],
        ["keyway.force", "rotor.force[3]"],
    ]


def opposed(document):
    """Put magnets whose force is not linear in the place of the linear ones."""
    magnets = {"force_current_factor": 42.1, "force_displacement_factor": 105210.0, "bias_current": 0.1}
    document["blocks"]["amb"] = {"type": "amb_nonlinear", "parameters": magnets}


def test_a_linear_motion_answers_by_its_transfer_matrices():
    motion = experiment().motion
    assert motion.is_linear
    found = motion.predict(np.array([30e-6]))
    added = np.random.default_rng(1).standard_normal((2, 4, 2, 3)) * (1 + 1j)
    expected = found.by_inputs()[:, :4, :, [3, 5]] @ added
    assert np.abs(found.answers(added, [3, 5]) - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.slow
@pytest.mark.parametrize("changes", [[], [asymmetric], [opposed], [asymmetric, opposed]])
def test_the_answer_to_the_force_of_an_unbalance_is_the_derivative_by_its_eccentricity(changes):
    """F = m e W^2 (cos, sin)(W t + phase) at node 3."""
    motion = experiment(*changes).motion
    assert motion.is_linear == (not changes)
    found = motion.predict(np.array([30e-6]))
    assert found.settled.all()
    added = np.zeros((2, motion.K + 1, 2, 1), complex)
    added[:, 1, 0, 0] = 2 * SPEEDS**2 * np.exp(1j * np.radians(30)) / 2
    added[:, 1, 1, 0] = -1j * added[:, 1, 0, 0]
    expected = found.sensitivity()
    assert np.abs(found.answers(added, NODE_3) - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.slow
@pytest.mark.parametrize("changes", [[asymmetric], [opposed], [asymmetric, opposed]])
def test_the_answer_to_all_orders_of_the_force_of_a_crack_is_the_derivative_by_its_stiffness(changes):
    """At node 4, of a force that a motion with the force as its output tells."""
    one = experiment(*changes, free="crack_stiffness")
    motion, theta = one.motion, np.array([3e5])
    equations = Equations(one.model, (*one.predicted, *CRACK_FORCE), one.free, motion.p)
    force = motion.reading(equations).predict(theta).sensitivity()[:, :, -2:]
    assert (np.abs(force[:, [0, 1, 2, 3]]) > 1e-3 * np.abs(force).max()).any(axis=2).all()
    found = motion.predict(theta)
    expected = found.sensitivity()
    assert np.abs(found.answers(force, NODE_4) - expected).max() < 1e-9 * np.abs(expected).max()
