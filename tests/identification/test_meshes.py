"""Meshes as fine as a recording shows: of fits whose prediction errs with the fourth power of the length, of a beam."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from rotorsim.criteria import CRITERIA
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.files import identified_diagram
from rotorsim.identification.identification import identify
from rotorsim.identification.meshes import on_fine_meshes
from rotorsim.identification.result import Identification
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.identification import TRUTH, errors, made, recorded

WORDS = "for what the coarser mesh gets wrong shows in these data"


@dataclass(frozen=True)
class Fit:
    """A prediction that is that of the limit and ``error`` over the fourth power of the parts, in two rows."""

    error: float
    adequate: bool = False
    worse: float = 0.0
    most: int = 100
    parts: int = 1

    @property
    def estimate(self) -> Fit:
        return self

    def _at(self, parts: int) -> np.ndarray:
        return self.error * np.array([0.6, 0.8]) / parts**4

    def change(self, block: str, parts: int) -> float:
        assert block == "rotor"
        change = self._at(parts) - self._at(self.parts)
        return float(change @ change)

    def finer(self, block: str, parts: int) -> Fit:
        if parts > self.most:
            raise RotorsimError(Problem("has modes too fast", "fe_rigid"))
        return replace(self, parts=parts)

    def worse_by(self, other: Fit) -> float:
        return self.worse


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
    found, notes = on_fine_meshes(load("fe_rigid"), Fit(error))
    assert found.parts == level
    assert notes == ([] if level == 1 else [f"rotor: subdivisions {level}, {WORDS}"])


def test_what_the_finest_mesh_leaves_is_said():
    _, notes = on_fine_meshes(load("fe_rigid"), Fit(4400.0))
    assert notes == [f"rotor: subdivisions 8, {WORDS}; a finer one would show, too"]


def test_data_of_a_mesh_itself_keep_it():
    """A finer one shows, but explains less of what the coarser one explains; of what neither does, it is taken."""
    for fit, level in ((Fit(100.0, True, 1.01), 1), (Fit(100.0, True, 0.99), 4), (Fit(100.0, False, 1.01), 4)):
        assert on_fine_meshes(load("fe_rigid"), fit)[0].parts == level


def test_a_finer_mesh_that_cannot_be_had_is_said():
    found, notes = on_fine_meshes(load("fe_rigid"), Fit(100.0, most=2))
    told = "subdivisions 4 cannot be compared (has modes too fast)"
    assert (found.parts, notes) == (2, [f"rotor: subdivisions 2, {WORDS}; {told}"])
    assert on_fine_meshes(load("fe_rigid"), Fit(100.0, most=1))[1] == [
        "rotor: subdivisions 2 cannot be compared (has modes too fast)"
    ]


def test_diagrams_without_a_mesh_are_left_as_they_are():
    fit = SimpleNamespace()
    assert on_fine_meshes(load("jeffcott"), fit) == (fit, [])


def said(found: Identification) -> list[str]:
    """Return what was warned of but for the pinned nodes, which were recorded at rest."""
    return [problem.what for problem in found.warnings if not problem.what.startswith("constant signal")]


@pytest.fixture(scope="module")
def fine():
    """A beam whose elements are four each, beside noise of a hundred-thousandth of the signals."""
    runs = made("fe_rigid", (70.0, 140.0, 210.0), replace(TRUTH, parts=4), level=1e-5)
    return identify(load("fe_rigid"), recorded(runs), profile=False)


def test_a_beam_is_identified_on_a_mesh_as_fine_as_the_recording_shows(fine):
    assert said(fine) == [f"rotor: subdivisions 4, {WORDS}"]
    assert fine.adequate
    assert fine.diagram.nodes["rotor"].block.option.subdivisions == 4
    assert fine.diagram.document["blocks"]["rotor"]["parameters"]["subdivisions"] == 4
    assert max(errors(fine).values()) < 1e-3
    for name, item in fine.parameters.items():
        assert abs(item.value - TRUTH[name]) < 4 * item.std, name


def test_the_diagram_that_is_written_runs(fine):
    """Finer meshes are faster: RK4 is not stable with its step."""
    document, [note] = identified_diagram(fine)
    told = "what is written has the step 1.02e-07 s: its modes are too fast for the step of the diagram as given"
    assert str(note) == f"warning: fe_rigid: {told}"
    written = load(document)
    assert written.solver.step == 1e-5 / 98
    assert simulate(written, stop=0.002).status == "finished"


def test_a_beam_of_the_mesh_as_drawn_stays_on_it():
    runs = made("fe_rigid", (70.0, 140.0, 210.0), level=1e-5)
    found = identify(load("fe_rigid"), recorded(runs), profile=False)
    assert said(found) == []
    assert found.adequate
    assert "subdivisions" not in found.diagram.document["blocks"]["rotor"]["parameters"]
