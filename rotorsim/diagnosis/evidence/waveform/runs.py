"""Runs as samples in time beside a diagram, and its best fit to them: what waveforms and resonances share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

from rotorsim.diagnosis.evidence.fit import FAILURES, TO_THE_END, Effort, Fit, Starts, failed_fit
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording


@dataclass(frozen=True, eq=False)
class SampledRuns(ABC):
    """Runs as samples in time, to be compared with a diagram that is read as the given one was.

    sizes: largest magnitude of signals by flat name.
    """

    recording: Recording
    runs: tuple[SampledRun, ...]
    channels: Channels
    sizes: Mapping[str, float]
    folder: str | None
    trust_blocks: bool

    def load(self, document: Mapping[str, Any]) -> Diagram:
        """Return the diagram of a document. Raises RotorsimError."""
        return load(document, folder=Path(self.folder) if self.folder else None, trust_blocks=self.trust_blocks)

    def largest(self) -> Mapping[str, float]:
        """Return the largest magnitude of signals by flat name."""
        return self.sizes

    @property
    def recorded(self) -> list[str]:
        """The flat names of the recorded signals."""
        return [*self.channels.inputs, *self.channels.outputs]

    def fit(self, document: Mapping[str, Any], starts: Starts, effort: Effort = TO_THE_END) -> Fit:
        """Return the best fit of a diagram from the best of each group of starts {free parameter: SI value}.

        What a start does not name begins as written. A nonlinear diagram costs no more, and is fitted, too.
        """
        began = process_time()
        try:
            fit = self._fit(document, starts, effort)
        except FAILURES as error:
            fit = failed_fit(document, error)
        return replace(fit, seconds=process_time() - began)

    @abstractmethod
    def _fit(self, document: Mapping[str, Any], starts: Starts, effort: Effort) -> Fit:
        """Return the best fit of a diagram. Raises one of FAILURES where it cannot be compared with the runs."""
