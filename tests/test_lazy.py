"""Public names are imported when they are used, and are what the modules call by this name."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec

import pytest

CALLED = ("simulate", "identify", "diagnose")  # rooms that do the work of the function they hide
PACKAGES = ("rotorsim", *(f"rotorsim.{room}" for room in ("simulate", "recordings", "identify", "diagnose", "fmi")))


def said(code: str) -> str:
    """Return what another interpreter prints."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_found_in_its_module(package: str) -> None:
    module = import_module(package)
    assert dir(module) == sorted(module.__all__)
    for name, home in module._HOME.items():
        assert getattr(import_module(f"{package}.{home}"), name) is not None
        if package == "rotorsim" and name in CALLED:
            continue
        assert find_spec(f"{package}.{name}") is None  # a module would hide it
        assert getattr(module, name) is getattr(import_module(f"{package}.{home}"), name)


@pytest.mark.parametrize("package", PACKAGES)
def test_other_names_are_not_there(package: str) -> None:
    with pytest.raises(AttributeError, match=f"^module '{package}' has no attribute 'nothing'$"):
        _ = import_module(package).nothing


def test_importing_the_package_imports_nothing_else() -> None:
    code = "import sys, rotorsim; print(sorted(n for n in sys.modules if n[:8] in ('rotorsim', 'numpy')))"
    assert said(code) == "['rotorsim', 'rotorsim._lazy']\n"


@pytest.mark.parametrize(
    "first",
    ["from rotorsim.simulate import periodic; import rotorsim",
     *(pytest.param(first, marks=pytest.mark.slow) for first in (
        "import rotorsim", "import rotorsim.simulate",
        "from rotorsim import simulate; simulate(diagram, stop=0.01); import rotorsim",
     ))],
)  # fmt: skip
def test_simulate_can_be_called_whatever_was_imported_before(first: str) -> None:
    """The package of this name is what Python puts in the place of the function."""
    call = "print(rotorsim.simulate(diagram, stop=0.01).status, rotorsim.simulate.modes is rotorsim.modes)"
    code = f"from rotorsim.diagram import load; diagram = load('jeffcott'); {first}; {call}; {call}"
    assert said(code) == "finished True\n" * 2
