"""What finer meshes than those of the diagram may change of the misfit."""

import numpy as np
import pytest

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.base_fit import base_fit
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.harmonic.evidence import HarmonicEvidence
from tests.diagnosis.test_places import healthy
from tests.identification import shipped


def residual(source: HarmonicEvidence, found: Fit, subdivisions: int) -> np.ndarray:
    document = values_in(found.document, found.values)
    document["blocks"]["rotor"]["parameters"]["subdivisions"] = subdivisions
    whitened = source.residual(document)
    assert whitened is not None
    return whitened


@pytest.mark.slow
def test_all_finer_meshes_together_change_less_than_is_allowed_for():
    """Four times the square of what half the length changes: of changes that halve each time, the sum is twice one.

    Beams converge faster: a mesh with eight times as many elements is no further away than the first change.
    """
    source, _ = healthy()
    found, notes = base_fit(shipped("fe_rigid"), source)
    level = int(found.document["blocks"]["rotor"]["parameters"].get("subdivisions", 1))
    here = residual(source, found, level)
    next_one, finest = (residual(source, found, level * times) - here for times in (2, 8))
    assert CRITERIA.mesh_rest == 4.0
    assert found.mesh == pytest.approx(4.0 * float(next_one @ next_one))
    assert 0 < float(finest @ finest) < found.mesh / 2
    assert float(next_one @ next_one) <= CRITERIA.mesh_visible * found.rows
    assert bool(notes) == (level > 1)


def test_a_diagram_without_meshes_has_nothing_to_refine():
    class Flat:
        def fit(self, document, starts):
            return Fit(document, misfit=10.0, rows=10)

    assert base_fit(shipped("jeffcott"), Flat())[0].mesh == 0.0
