"""Where along a beam a crack is, with meshes as fine as the recording shows, and what the beam is held at."""

from dataclasses import replace

import pytest

from rotorsim.criteria import CRITERIA
from rotorsim.identification.held import is_contradicted
from rotorsim.identification.locate import Locations, locate
from rotorsim.model.load import load
from tests.identification import TRUTH, changed, made, recorded


def found(diagram: str = "fe_rigid", *, start: int = 4, **truth: float) -> Locations:
    """Return where a crack at node 4 is found, of a diagram with it at another."""
    runs = made("fe_rigid", (70.0, 140.0, 210.0), replace(TRUTH, **truth), level=1e-4)

    def moved(document):
        document["wires"] = [
            [source, f"rotor.force[{start}]"] if source == "crack.force" else [source, target]
            for source, target in document["wires"]
        ]

    return locate(changed(diagram, moved), recorded(runs), "crack")


@pytest.mark.parametrize("start", [4, pytest.param(2, marks=pytest.mark.slow)])
def test_a_crack_is_found_on_a_mesh_as_fine_as_the_recording_shows(start):
    locations = found(start=start, parts=4)
    best = locations[0]
    assert best.nodes == (4,)
    assert best.probability > 0.999
    assert best.estimate.goodness > CRITERIA.not_explained
    [note] = [str(one) for one in locations.warnings]
    assert note == "warning: rotor: subdivisions 4, for what the coarser mesh gets wrong shows in these data"
    assert load(best.document).nodes["rotor"].block.option.subdivisions == 4


@pytest.mark.slow
def test_the_mesh_that_data_were_made_on_stays():
    locations = found()
    assert locations[0].nodes == (4,)
    assert locations[0].estimate.goodness > CRITERIA.not_explained
    assert locations.warnings == []


@pytest.mark.slow
def test_damping_that_is_held_at_zero_is_said():
    locations = found(disc_damping=4.0)
    assert locations[0].nodes == (4,)
    assert is_contradicted(locations.warnings)
