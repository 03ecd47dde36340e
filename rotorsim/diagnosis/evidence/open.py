"""Open a recording beside a diagram: which evidence it gives is decided here, and nowhere else."""

from __future__ import annotations

from collections.abc import Sequence

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.evidence.harmonic.open import open_harmonics
from rotorsim.diagnosis.evidence.opened import Opened
from rotorsim.diagnosis.evidence.orders.open import open_orders
from rotorsim.diagnosis.evidence.resonance.open import is_by_resonances, open_resonances
from rotorsim.diagnosis.evidence.waveform.open import open_waveforms
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.in_time import TURNING
from rotorsim.identification.waveform.recorded.along_angle import is_in_time, turns_as_recorded
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import Recording

__all__ = ["Opened", "open_evidence"]


def open_evidence(
    diagram: Diagram,
    recording: Recording | OrderRecording,
    hold_out: Recording | OrderRecording | None,
    catalogue: Catalogue,
    warnings: Sequence[Problem],
) -> Opened:
    """Return a recording as evidence, and the diagram as given fitted to it.

    Harmonics where the shaft turns at steady speeds, else samples in time; resonances where no simulation follows the
    modes in time; order vectors where they were recorded instead of samples.
    warnings: earlier ones, of which those that do not matter are dropped.
    Raises RotorsimError for recordings that do not fit the diagram.
    """
    if isinstance(recording, OrderRecording):
        if isinstance(hold_out, Recording):
            raise RotorsimError(Problem("orders and samples cannot be compared", hold_out.name))
        return open_orders(diagram, recording, hold_out, catalogue, warnings)
    if isinstance(hold_out, OrderRecording):
        raise RotorsimError(Problem("orders and samples cannot be compared", hold_out.name))
    if not is_in_time(diagram, recording):
        return open_harmonics(diagram, recording, hold_out, catalogue, warnings)
    if turns_as_recorded(diagram, recording):
        return open_waveforms(diagram, recording, hold_out, catalogue, warnings)
    warnings = [problem for problem in warnings if problem.code not in TURNING]
    opener = open_resonances if is_by_resonances(diagram, recording) else open_waveforms
    return opener(diagram, recording, hold_out, catalogue, warnings)
