"""From recordings to parameters: regression, maximum likelihood, intervals, verdicts, the next experiment."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rotorsim.identify.files import identification_data as identification_data
    from rotorsim.identify.files import save_identification as save_identification
    from rotorsim.identify.identification import Identification as Identification
    from rotorsim.identify.identification import identify as identify

_HOME = {
    "Identification": "identification",
    "identification_data": "files",
    "identify": "identification",
    "save_identification": "files",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
