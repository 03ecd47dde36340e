"""Public names are imported when they are used, and are what the modules call by this name."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from types import ModuleType

import pytest

import rotorsim


def said(code: str) -> str:
    """Return what another interpreter prints."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("name", sorted(rotorsim._HOME))
def test_every_public_name_is_found_in_its_module_and_no_module_hides_it(name: str) -> None:
    found = getattr(rotorsim, name)
    assert found is getattr(import_module(f"rotorsim.{rotorsim._HOME[name]}"), name)
    assert not isinstance(found, ModuleType)


def test_public_names_are_listed_in_order_and_others_are_not_there() -> None:
    assert dir(rotorsim) == sorted(rotorsim.__all__)
    assert list(rotorsim._HOME) == sorted(rotorsim._HOME)
    with pytest.raises(AttributeError, match=r"^module 'rotorsim' has no attribute 'nothing'$"):
        _ = rotorsim.nothing


def test_importing_the_package_imports_nothing_else() -> None:
    code = "import sys, rotorsim; print(sorted(n for n in sys.modules if n[:8] in ('rotorsim', 'numpy')))"
    assert said(code) == "['rotorsim', 'rotorsim._lazy']\n"
