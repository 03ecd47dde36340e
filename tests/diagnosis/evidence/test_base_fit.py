"""Meshes as fine as the data tell, with an evidence whose prediction errs with the fourth power of the length."""

from types import SimpleNamespace

import numpy as np
import pytest

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.evidence.base_fit import base_fit
from rotorsim.model.load import load


class Meshes:
    """The residual is that of the limit and ``error`` over the fourth power of the subdivisions, in two rows."""

    def __init__(self, error: float) -> None:
        self.error = error
        self.starts = []

    def fit(self, document, starts):
        self.starts.append(starts)
        values = {"rotor.mass": float(len(self.starts))}
        return SimpleNamespace(document=document, values=values, failure="", rows=2000)

    def residual(self, document):
        parts = document["blocks"]["rotor"]["parameters"].get("subdivisions", 1)
        return np.array([0.0, 3.0]) + self.error * np.array([0.6, 0.8]) / parts**4


def test_what_shows_is_one_standard_deviation():
    assert CRITERIA.mesh_visible == 1.0


@pytest.mark.parametrize(
    ("error", "level"),
    [
        (1.0, 1),
        (1.06, 1),  # 15/16 of it by the next
        (1.07, 2),
        (17.0, 2),
        (17.1, 4),
        (273.0, 4),
        (274.0, 8),
        (4368.0, 8),
    ],
)
def test_a_mesh_is_refined_until_a_finer_one_changes_a_standard_deviation(error, level):
    found, notes = base_fit(load("fe_rigid"), Meshes(error))
    parts = found.document["blocks"]["rotor"]["parameters"].get("subdivisions", 1)
    assert parts == level
    told = f"rotor: subdivisions {level}, for what the coarser mesh gets wrong shows in these data"
    assert notes == ([] if level == 1 else [told])


def test_a_finer_mesh_is_fitted_from_the_coarser_fit():
    meshes = Meshes(17.1)
    base_fit(load("fe_rigid"), meshes)
    assert meshes.starts == [[], [[{"rotor.mass": 1.0}]], [[{"rotor.mass": 2.0}]]]


def test_what_the_finest_mesh_leaves_is_said():
    _, notes = base_fit(load("fe_rigid"), Meshes(4400.0))
    assert notes == [
        "rotor: subdivisions 8, for what the coarser mesh gets wrong shows in these data; a finer one would show, too"
    ]
