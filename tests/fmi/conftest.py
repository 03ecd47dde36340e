"""Exported FMUs that several tests share."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest

from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.load import load
from tests.cli.conftest import run  # noqa: F401 - a fixture of the command line, here too

Make = Callable[..., Path]


def lacking(file: Path, kinds: Iterable[str]) -> Path:
    """Write a copy of an FMU of FMI 3.0 that does not offer some derivatives, directional or adjoint; return it."""
    copy = file.with_stem(f"{file.stem}-{''.join(kind[0] for kind in kinds)}")
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(copy, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            for kind in kinds if name == "modelDescription.xml" else ():
                flag = f'provides{kind.capitalize()}Derivatives="%s"'.encode()
                assert flag % b"true" in data
                data = data.replace(flag % b"true", flag % b"false")
            new.writestr(name, data)
    return copy


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
