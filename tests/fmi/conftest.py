"""Exported FMUs that several tests share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.load import load
from tests.cli.conftest import run  # noqa: F401 - a fixture of the command line, here too

Make = Callable[..., Path]


@pytest.fixture(scope="session")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Return a function that exports a diagram, once for every set of arguments."""
    folder = tmp_path_factory.mktemp("exported")
    made: dict[str, Path] = {}

    def make(diagram: Any, version: str = "2.0", **options: Any) -> Path:
        key = repr((diagram, version, sorted(options.items())))
        if key not in made:
            loaded = load(diagram, set=options.pop("set", {}))
            made[key] = folder / f"{len(made)}.fmu"
            export_fmu(loaded, made[key], version=version, **options)
        return made[key]

    return make
