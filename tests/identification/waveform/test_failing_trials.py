"""Searches in which trials fail: shorter steps are tried, and an end beyond which a search would go on is no result."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from rotorsim.diagram.standalone import Standalone
from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.identification import locate as locating
from rotorsim.identification.harmonic.estimate import Search
from rotorsim.identification.locate import Locations, locate
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.model.heard import BARRED, tell

EDGE = 1.2  # beyond, all fails


def failure() -> RotorsimError:
    return RotorsimError(Problem("fails (t = 1 s)", "it", Place("a.fmu")))


class Curve(OutputErrorSearch):
    """One parameter, and ten equal residuals q^2 - goal^2."""

    m, free, angles = 1, (), np.array([], int)
    bounds = np.array([[-np.inf], [np.inf]])
    goal: ClassVar[float] = 1.0

    def substeps(self, unknowns: np.ndarray) -> int:
        return 1

    def evaluate(self, unknowns: np.ndarray, sub: int, sensitivities: bool = True) -> Evaluation:
        [q] = unknowns
        if q > EDGE:
            raise failure()
        r, J = 10.0 * (q**2 - self.goal**2), 20.0 * q
        return Evaluation(unknowns, sub, r**2, gradient=np.array([J * r]), information=np.array([[J * J]]))


def in_harmonics(goal: float) -> Search:
    """Return the same as a search in harmonics."""

    def residual(q: np.ndarray) -> np.ndarray:
        if q[0] > EDGE:
            raise failure()
        return np.array([10.0 * (q[0] ** 2 - goal**2), 0.0])

    made: Any = object.__new__(Search)
    made.coordinates = SimpleNamespace(bounds=(np.array([-np.inf]), np.array([np.inf])))
    made.residual, made.jacobian = residual, lambda q: np.array([[20.0 * q[0]], [0.0]])
    found: Search = made
    return found


def searched(kind: str, goal: float) -> float:
    if kind == "harmonics":
        return float(in_harmonics(goal).minimise(np.array([0.2]))[0])
    curve = type("To", (Curve,), {"goal": goal})((), (), {})
    return float(curve.minimise(np.array([0.2])).reached().unknowns[0])


@pytest.mark.parametrize("kind", ["time", "harmonics"])
def test_a_step_too_far_is_made_shorter(kind: str) -> None:
    """The first one would lead to 2.6."""
    assert searched(kind, 1.0) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("kind", ["time", "harmonics"])
def test_an_end_beyond_which_it_would_go_on_is_none(kind: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        searched(kind, 1.5)
    said = "a.fmu: error: it: the search ends where it fails, and would go on beyond: fails (t = 1 s)"
    assert (str(caught.value), caught.value.exit_code) == (said, 1)


@pytest.mark.parametrize("kind", ["time", "harmonics"])
def test_what_would_gain_less_than_a_misfit_of_one_is_an_end(kind: str) -> None:
    """At 1.2 the misfit is (10 (goal^2 - 1.44))^2, which the next step would take away."""
    assert BARRED == 1.0
    near, far = (float(np.sqrt(EDGE**2 + 0.1 * root)) for root in (0.9, 1.1))
    assert searched(kind, near) == pytest.approx(EDGE, abs=2e-3)
    with pytest.raises(RotorsimError, match="would go on beyond"):
        searched(kind, far)


def test_a_place_that_cannot_be_fitted_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def fit(places: tuple[int, ...], *_: Any, tries: int) -> Any:
        if places == (2,):
            tell(failure())
            raise failure()
        estimate = SimpleNamespace(misfit=float(10 * places[0]), freedom=5)
        return SimpleNamespace(estimate=estimate, diagram=SimpleNamespace(document={}))

    made: dict[str, Any] = {
        "_wires": lambda *_: [],
        "_nodes": lambda *_: [1, 2, 3],
        "_placed": lambda *given: given[-1],
        "load": lambda moved, **_: moved,
        "load_standalone": lambda given: (given, Standalone({})),
        "renamed": lambda given, _: given,
        "harmonics_of": lambda *_: [],
        "fit_harmonics": fit,
        "on_fine_meshes": lambda _, fit: (fit, []),
        "contradictions_of": lambda *_: [],
    }
    for name, fake in made.items():
        monkeypatch.setattr(locating, name, fake)
    diagram: Any = SimpleNamespace(document={}, folder=None, trusted=False)
    recording: Any = SimpleNamespace(select=lambda use: [])
    found = locate(diagram, recording, "crack")
    assert isinstance(found, Locations)
    assert [one.nodes for one in found] == [(1,), (3,)]
    assert found.failed == {(2,): "a.fmu: error: it: fails (t = 1 s)"}
    assert [str(one) for one in found.warnings] == [
        "a.fmu: warning: it: fails (t = 1 s): 1 trial failed so, and other values were tried"
    ]
    monkeypatch.setattr(locating, "_nodes", lambda *_: [2])
    with pytest.raises(RotorsimError, match="it: fails"):
        locate(diagram, recording, "crack")
