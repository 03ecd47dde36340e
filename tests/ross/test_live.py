"""Where ROSS is installed: files that it saves itself, and what it finds for them, beside the imported diagrams."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.ross_agreement import deviation, eigenvalues
from tests.ross.rotors import ROTORS, toml

pytestmark = pytest.mark.filterwarnings("ignore")  # those of ROSS and of what it imports
PROMISED = 1e-6


@pytest.fixture(scope="module")
def ross() -> Any:
    return pytest.importorskip("ross")


@pytest.mark.parametrize("name", ROTORS)
def test_files_that_ross_saves_again_agree(name: str, ross: Any, tmp_path: Path) -> None:
    written, saved = tmp_path / "written.toml", tmp_path / "saved.toml"
    written.write_text(toml(ROTORS[name]))
    rotor = ross.Rotor.load(written)
    rotor.save(saved)
    for file in (written, saved):
        assert deviation(file, 400.0, eigenvalues(rotor, 400.0)) < PROMISED


def test_the_example_of_ross_agrees(ross: Any, tmp_path: Path) -> None:
    rotor = ross.rotor_example()
    for name in ("example.toml", "example.json"):
        rotor.save(tmp_path / name)
        for speed in (0.0, 500.0):
            assert deviation(tmp_path / name, speed, eigenvalues(rotor, speed)) < PROMISED
