"""The diagram as given, on meshes as fine as an evidence tells whose prediction errs with the fourth power."""

from types import SimpleNamespace

import numpy as np

from rotorsim.diagnosis.evidence.base_fit import base_fit, first_free
from rotorsim.model.load import load


class Meshes:
    """The residual is that of the limit and ``error`` over the fourth power of the subdivisions, in two rows."""

    def __init__(self, error: float, failure: str = "") -> None:
        self.error, self.failure = error, failure
        self.starts = []

    def fit(self, document, starts):
        self.starts.append(starts)
        values = {"rotor.mass": float(len(self.starts))}
        failure = self.failure if len(self.starts) > 1 else ""
        return SimpleNamespace(
            document=document, values=values, failure=failure, goodness=0.0, misfit=9000.0, freedom=2000
        )

    def residual(self, document):
        parts = document["blocks"]["rotor"]["parameters"].get("subdivisions", 1)
        return np.array([0.0, 3.0]) + self.error * np.array([0.6, 0.8]) / parts**4


def test_a_finer_mesh_is_fitted_from_the_coarser_fit():
    meshes = Meshes(17.1)
    found, notes = base_fit(load("fe_rigid"), meshes)
    assert found.document["blocks"]["rotor"]["parameters"]["subdivisions"] == 4
    assert notes == ["rotor: subdivisions 4, for what the coarser mesh gets wrong shows in these data"]
    assert meshes.starts == [[], [[{"rotor.mass": 1.0}]], [[{"rotor.mass": 2.0}]]]


def test_a_finer_mesh_that_cannot_be_fitted_is_said():
    found, notes = base_fit(load("fe_rigid"), Meshes(17.1, failure="diverges"))
    assert "subdivisions" not in found.document["blocks"]["rotor"]["parameters"]
    assert notes == ["rotor: subdivisions 2 cannot be compared (diverges)"]


def test_what_is_free_by_its_tolerance_is_no_effect():
    """FAULT: fits of run-ups took the damping of a disc, where a start named it, for a parameter of the law."""
    own = {item.name for item in load("fe_rigid").free}
    assert first_free(load("fe_rigid")) == own | {"rotor.disc_damping[1]"}
    assert first_free(load("jeffcott")) == {item.name for item in load("jeffcott").free}
