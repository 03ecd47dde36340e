"""Eigenvalues of imported rotors are those of ROSS: frequencies, damping, whirl; where they are not, it is said."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rotorsim import load, modes
from rotorsim.ross.to_diagram import import_ross
from tests.ross.reference import REFERENCE
from tests.ross.rotors import DISC, ROTORS, bearing, stepped, tables, toml

PROMISED = 1e-6
SHIPPED = Path(__file__).parents[2] / "diagrams" / "ross_rotor.toml"


@cache
def document(name: str, folder: Path) -> dict:
    if name == SHIPPED.stem:
        return import_ross(SHIPPED).document
    file = folder / f"{name}.toml"
    file.write_text(toml(ROTORS[name]))
    return import_ross(file).document


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ross")


def eigenvalues(diagram: dict, speed: float) -> np.ndarray:
    return np.array([mode.eigenvalue for mode in modes(load(diagram, set={"speed": speed})).modes])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "speed", "expected"), REFERENCE, ids=[f"{n}-{w:g}" for n, w, _ in REFERENCE])
def test_eigenvalues_are_those_of_ross(name: str, speed: float, expected: list[complex], folder: Path) -> None:
    found = eigenvalues(document(name, folder), speed)[: len(expected)]
    assert np.abs(found / np.array(expected) - 1).max() < PROMISED


def test_whirl_is_that_of_ross(folder: Path) -> None:
    """ROSS 2.3.0, rotor "cones" at 400 rad/s: run_modal(400.0).whirl_direction(), lateral modes."""
    found = modes(load(document("cones", folder), set={"speed": 400.0})).modes
    assert [mode.whirl for mode in found[:10]] == ["backward", "forward"] * 5
    expected = [974.913, 977.203, 2693.014, 2833.416, 9138.26, 9320.129]  # its wd [rad/s]
    assert [mode.eigenvalue.imag for mode in found[:6]] == pytest.approx(expected, abs=6e-4)


def test_the_smoothing_of_small_tables_is_not_carried_over(tmp_path: Path) -> None:
    """ROSS 2.3.0: BearingElement(...).C(450.0)[0, 0] is 7.453571428571429, and at 300 rad/s 8.97, where 10 is given."""
    values = [8.0, 9.0, 10.0, 7.0, 8.0]
    over_speed = bearing(0, frequency=[100.0, 200.0, 300.0, 400.0, 500.0], kxx=[1e7] * 5, cxx=values)
    file = tmp_path / "small.toml"
    file.write_text(toml(tables(stepped(), DISC, over_speed, bearing(5, kxx=[1e7], cxx=[500.0]))))
    done = import_ross(file)
    said = [problem.what for problem in done.warnings if problem.subject]
    assert said == ["ROSS smooths this table: its cxx at 450 rad/s is 7.45357, here 6.3125"]
    assert done.document["blocks"]["bearing_0"]["parameters"]["cxx"] == values
