"""The ground under a whole shaft: what it does to the mass of a rotor, as the rotor has it."""

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import LINES, fixed_of
from rotorsim.model.load import load
from tests.blocks.evaluation import prepare

SHAFT = {
    "element_length": [0.1, 0.15, 0.05, 0.2],
    "outer_diameter": [0.016, 0.02, 0.016, 0.03],
    "inner_diameter": [0.0, 0.01, 0.0, 0.02],
    "density": [7850.0, 7850.0, 2700.0, 7850.0],
    "disc_mass": [2.0, 0.7],
}
OPTIONS = {"elements": 4, "disc_nodes": [2, 5]}


def test_a_free_rotor_stays_where_it_is_while_the_ground_moves():
    """M^-1 (-M r a) = -r a: all nodes are left behind alike, and no slope changes."""
    shaking = {"acceleration": 0.3, "direction": 0.7, "frequency": 50.0, "phase": 0.2}
    forces = prepare("shaken_shaft", {}, {**SHAFT, **shaking}, OPTIONS).evaluate(time=0.01).outputs
    inertias = {"disc_polar_inertia": [0.004, 0.001], "disc_diametral_inertia": [0.002, 0.0006]}
    rotor = prepare("rotor_fe", {"force": (5, 2), "moment": (5, 2), "speed": ()}, {**SHAFT, **inertias}, OPTIONS)
    rates = rotor.evaluate({**forces, "speed": 100.0}).derivatives["velocity"].reshape(5, 2, 2)
    left = -0.3 * np.cos(50.0 * 0.01 + 0.2) * np.array([np.cos(0.7), np.sin(0.7)])
    assert rates[:, 0] == pytest.approx(np.tile(left, (5, 1)), rel=1e-9)
    assert np.abs(rates[:, 1]).max() < 1e-9 * np.abs(left).max() / 0.05


@pytest.mark.parametrize("name", ["fe_rigid", "fe_flexible", "two_amb_rotor"])
def test_the_rotor_of_a_diagram_is_shaken_as_a_whole(name):
    given = load(name)
    [item] = [item for item in insertions(given, ()) if item.kind.type_name == "shaken_shaft"]
    assert (str(item.spot), item.physics) == ("rotor.force", "base_excitation")
    shaken = load(item.document(given.document, fixed_of(item, {LINES: 300.0})))
    carried, rotor = shaken.nodes["base_excitation"], shaken.nodes["rotor"]
    assert carried.block.option.disc_nodes == rotor.block.option.disc_nodes
    for key in SHAFT:
        assert np.array_equal(carried.values[key], rotor.values[key]), key
    assert not [item for item in insertions(load("jeffcott"), ()) if item.kind.type_name == "shaken_shaft"]
