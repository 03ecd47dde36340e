"""Evidence that scores fits on hold-out runs, or on parts of the recording left out, each once."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Defaults, HeldScore, Validation
from rotorsim.diagnosis.evidence.fit import Fit


class Validated(Defaults, Validation):
    """Evidence whose hold-out runs have noise that is known, so that a misfit is expected of them."""

    held: Sequence[Any] = ()

    @property
    def validation(self) -> Validation:
        """Itself."""
        return self

    @property
    def held_out(self) -> bool:
        """Whether runs are held out for good."""
        return bool(self.held)

    def score(self, fit: Fit) -> HeldScore:
        """Return the score of a fit on hold-out runs, or on parts of the recording left out; computed once."""
        if fit not in self._scores:
            self._scores[fit] = self.scored(values_in(fit.document, fit.values))
        return self._scores[fit]

    @cached_property
    def _scores(self) -> dict[Fit, HeldScore]:
        return {}

    @abstractmethod
    def scored(self, document: Mapping[str, Any]) -> HeldScore:
        """Return the score of a document as it is on hold-out runs, or on parts of the recording left out."""
