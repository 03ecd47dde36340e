"""Names of a package that are imported when they are first used: the command line starts fast, SciPy may never load."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

TYPE_CHECKING = False  # the module typing takes longer to import than all of this
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any

__all__ = ["callable_as", "lazy"]


def lazy(package: str, homes: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package; homes: public name -> module of the package it is in."""

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        value = getattr(import_module(f"{package}.{homes[name]}"), name)
        # found at once next time; a module of this name, which its import has put there, stays (`rotorsim.simulate`)
        return vars(sys.modules[package]).setdefault(name, value)

    def names() -> list[str]:
        return sorted(vars(sys.modules[package])["__all__"])

    return find, names


class _CallableModule(ModuleType):
    """A package that hides, in `rotorsim`, the function of its name, and does its work: `rotorsim.simulate`."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self._function(*args, **options)

    @property
    def _function(self) -> Any:
        return getattr(self, self.__name__.rpartition(".")[2])

    @property
    def __signature__(self) -> Any:
        from inspect import signature

        return signature(self._function)

    @property
    def __doc__(self) -> str:  # type: ignore[override]
        """The docstring of the package, and signature and docstring of the function."""
        name = self.__name__.rpartition(".")[2]
        return f"{vars(self)['__doc__']}\n\n{name}{self.__signature__}\n\n{self._function.__doc__}"


def callable_as(package: str) -> None:
    """Let a package be called as the function of its own name that it exports."""
    sys.modules[package].__class__ = _CallableModule
