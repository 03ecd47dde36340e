"""Files of ROSS that several tests read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from rotorsim.errors import RotorsimError
from rotorsim.ross.to_diagram import ImportedRoss, import_ross

Import = Callable[..., ImportedRoss]
Refusal = Callable[..., list[str]]


@pytest.fixture
def read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Import:
    """Return a function that imports a text."""
    monkeypatch.chdir(tmp_path)

    def call(text: str, name: str = "rotor.toml") -> ImportedRoss:
        Path(name).write_text(text, encoding="utf-8")
        return import_ross(name)

    return call


@pytest.fixture
def refusal(read: Import) -> Refusal:
    """Return a function that gives the mistakes in a text, as they are printed."""

    def call(text: str, name: str = "rotor.toml") -> list[str]:
        with pytest.raises(RotorsimError) as caught:
            read(text, name)
        return [str(problem) for problem in caught.value.problems]

    return call
