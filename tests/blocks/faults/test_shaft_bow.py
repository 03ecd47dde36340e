"""The bow of a whole shaft against the strain energy of a beam, integrated here."""

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.model.load import load
from tests.blocks.evaluation import prepare

LENGTHS = (0.1, 0.15, 0.05, 0.2)
DIAMETERS = (0.016, 0.02, 0.016, 0.03)
E = 2.1e11


def forces(bend) -> np.ndarray:
    """Return [force, moment] of each node: int E I N'' v'' dz with the cubics N of each element, by Gauss' formula."""
    ends = np.concatenate([[0.0], np.cumsum(LENGTHS)])
    at, weights = np.polynomial.legendre.leggauss(4)
    total = np.zeros((len(ends), 2))
    for e, (length, diameter) in enumerate(zip(LENGTHS, DIAMETERS, strict=True)):
        s = (at + 1) / 2  # of the element
        N = np.array([-6 + 12 * s, length * (-4 + 6 * s), 6 - 12 * s, length * (-2 + 6 * s)]) / length**2
        v = np.concatenate([bend(z) for z in ends[e : e + 2]])
        loads = (N * (v @ N)) @ weights * length / 2 * E * np.pi / 64 * diameter**4
        total[e : e + 2] += loads.reshape(2, 2)
    return total


def test_the_forces_are_those_of_the_strain_energy():
    parameters = {
        "element_length": list(LENGTHS),
        "outer_diameter": list(DIAMETERS),
        "inner_diameter": [0.0] * 4,
        "amplitude1": 2e-6,
        "phase1": 0.4,
        "amplitude2": 3e-7,
        "phase2": -1.1,
        "amplitude3": 0.0,
        "amplitude4": 1e-8,
        "phase4": 2.0,
    }
    theta = 0.9
    out = prepare("shaft_bow", {"theta": ()}, parameters, {"elements": 4}).evaluate({"theta": theta}).outputs
    expected = np.zeros((5, 2), complex)
    for k, size, phase in ((1, 2e-6, 0.4), (2, 3e-7, -1.1), (4, 1e-8, 2.0)):
        w = k * np.pi / sum(LENGTHS)
        expected += forces(lambda z, w=w: (np.sin(w * z), w * np.cos(w * z))) * size * np.exp(1j * (theta + phase))
    for j, port in enumerate(("force", "moment")):
        found = out[port] @ [1, 1j]
        assert found == pytest.approx(expected[:, j], abs=1e-9 * np.abs(expected[:, j]).max())
    # a beam that nothing holds: no force and no moment in all
    assert np.abs(out["force"].sum(axis=0)).max() < 1e-9 * np.abs(out["force"]).max()


def test_a_beam_is_bent_as_a_whole_and_a_point_is_not():
    beam, point = (
        [item for item in insertions(load(name), ()) if item.kind.type_name == "shaft_bow"]
        for name in ("fe_rigid", "jeffcott")
    )
    assert not point
    assert [(str(item.spot), len(item.free)) for item in beam] == [("rotor.force", n) for n in (2, 4, 6, 8)]
    assert {item.physics for item in beam} == {"residual_bow"}
    bent = load(beam[1].document(load("fe_rigid").document, {"amplitude1": 1e-6}))
    assert bent.nodes["residual_bow"].block.option.elements == 5
    assert bent.nodes["residual_bow"].values["element_length"].tolist() == [0.1] * 5
    assert (bent.nodes["residual_bow"].values["outer_diameter"] == 0.016).all()
