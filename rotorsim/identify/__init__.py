"""From recordings to parameters: regression, maximum likelihood, intervals, verdicts, the next experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rotorsim._lazy import callable_as, lazy

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
__getattr__, __dir__ = lazy(__name__, _HOME)
callable_as(__name__)
