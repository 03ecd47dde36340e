"""What is located at the ports of an FMU may as well be inside it, and that is said."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.diagnosis.conclude.wording import _inside
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass
from tests.fmi.plant import make_fmu
from tests.fmi.test_equations import of_plant


@pytest.fixture
def found(tmp_path: Path) -> Any:
    """Return what a diagnosis has of a diagram that drives an FMU."""
    make_fmu(tmp_path / "plant2.fmu")
    force = {"type": "constant", "parameters": {"value": 1.0}}
    gauge = {"type": "gain"}
    other = {"type": "constant", "parameters": {"value": 2.0}}
    wires = [
        ["force.output", "it.u"],
        ["other.output", "it.u"],
        ["it.y", "gauge.input"],
        ["other.output", "beside.input"],
    ]
    diagram = of_plant(tmp_path, blocks={"force": force, "gauge": gauge, "other": other, "beside": gauge}, wires=wires)
    made = SimpleNamespace(_as_given=diagram, verdict="missing_physics")
    made.inside = lambda spot: Diagnosis.inside(made, spot)  # type: ignore[arg-type]
    return made


def test_places_next_to_an_fmu(found: Any) -> None:
    assert found.inside(Spot("it", "u")) == ("it",)
    assert found.inside(Spot("it", "y")) == ("it",)
    assert found.inside(Spot("force", "output")) == ("it",)
    assert found.inside(Spot("it", "y", side="reading")) == ()
    assert found.inside(Spot("gauge", "output")) == ()
    assert found.inside(Spot("other", "output")) == ()  # another block takes it, too


def test_it_is_said_of_the_likeliest_places(found: Any) -> None:
    found.places = (PlaceClass((Spot("force", "output"), Spot("it", "u")), 0.9), PlaceClass((Spot("it", "y"),), 0.1))
    assert _inside(found) == (
        "What acts at force.output and it.u may as well be inside it, whose equations are its own and are not looked "
        "into."
    )
    found.places = (PlaceClass((Spot("gauge", "output"),), 1.0),)
    assert _inside(found) == ""
