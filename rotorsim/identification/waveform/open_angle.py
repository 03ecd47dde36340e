"""What pulses leave open of the shaft angle, and what that leaves open of parameters.

The scatter of stretches shows nothing of an error that a whole run shares. An independent error of one standard
deviation changes the gradient by g and the estimate by u = -H^-1 g; u u^T is added to its covariance.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.driven.equations import clock_ports
from rotorsim.identification.waveform.evaluation import Evaluation, solved
from rotorsim.identification.waveform.noise import INVERTED
from rotorsim.identification.waveform.recorded.along_angle import ANGLE_UNITS, turned_later
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.recordings.recording import Recording
from rotorsim.signals.pulse_curve import PulseCurve
from rotorsim.signals.turning import turning

SHOWN = 0.01  # sum of squares of weighted changes: below, no parameter goes by more than 0.1 of its standard deviation
MOST_ERRORS = 32  # of a run; of more, so many sums with random signs: a standard deviation is known to 1/8 of itself


@dataclass(frozen=True, eq=False)
class OpenAngle:
    """What is not known of the angle in a recording as it was made: late, the std of what all pulses share [s]."""

    diagram: Diagram
    recording: Recording
    late: float = 0.0

    def covariance(self, search: OutputErrorSearch, evaluation: Evaluation) -> np.ndarray:
        """Return what the angle leaves open of the unknowns of a search, (q, q); zero at bounds."""
        changes = [*self._late(search, evaluation), *self._between(search, evaluation)]
        u = np.zeros((len(evaluation.unknowns), len(changes)))
        if changes:
            searched = ~search.at_bound(evaluation.unknowns)
            H = evaluation.information[np.ix_(searched, searched)]
            u[searched] = solved(H, np.stack(changes, axis=1)[searched], INVERTED)
        return u @ u.T

    def _late(self, search: OutputErrorSearch, evaluation: Evaluation) -> Iterator[np.ndarray]:
        """Yield by how much the gradient changes where all pulses are late by one standard deviation."""
        if self.late:
            later = replace(search, runs=[turned_later(run, self.diagram, self.late) for run in search.runs])
            yield later.evaluate(evaluation.unknowns, evaluation.sub).gradient - evaluation.gradient

    def _between(self, search: OutputErrorSearch, evaluation: Evaluation) -> Iterator[np.ndarray]:
        """Yield by how much the gradient changes with each error between the pulses of each run."""
        for r, run in enumerate(search.runs):
            curve = self._curve(run)
            if curve is None:
                continue
            y, _ = search.simulated(evaluation.unknowns, 0, r, evaluation.sub, sensitivities=False)
            if float(np.sum((search.root(0, r) * y * curve.std(run.time)[:, None]) ** 2)) >= SHOWN:
                yield from changed_gradients(search, evaluation, r, turned_off(self.diagram, run, curve))

    def _curve(self, run: SampledRun) -> PulseCurve | None:
        """Return the curve through the pulses of a run, or of the one that it is a part of; None without pulses."""
        runs = self.recording.runs
        whole = next((own for own in runs if run.id == own.id or run.id.startswith(f"{own.id} from ")), None)
        return None if whole is None else turning(self.recording, whole).curve


def turned_off(diagram: Diagram, run: SampledRun, curve: PulseCurve) -> Iterator[SampledRun]:
    """Yield a run whose angle is off by independent errors of one standard deviation, one after another."""
    few = curve.principal(run.time)
    if few.root.shape[1] > MOST_ERRORS:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (few.root.shape[1], MOST_ERRORS))
        few = replace(few, root=few.root @ signs / np.sqrt(MOST_ERRORS))
    ports = [port for port in clock_ports(diagram) if port in run.values]
    orders = {port: list(ANGLE_UNITS).index(port.rpartition(".")[2]) for port in ports}
    for one in few.root.T:
        alone = replace(few, root=one[:, None])
        off = {port: run.values[port] + alone.errors(run.time, order)[:, 0] for port, order in orders.items()}
        yield replace(run, values={**run.values, **off})


def changed_gradients(
    search: OutputErrorSearch, evaluation: Evaluation, r: int, others: Iterable[SampledRun]
) -> Iterator[np.ndarray]:
    """Yield by how much the gradient changes with others in the place of a run: by J^T W d, d of the outputs."""
    known, own = np.isfinite(search.measured[0][r]), search.columns(0, r)
    names = search.systems[0].equations.outputs
    y, _ = search.simulated(evaluation.unknowns, 0, r, evaluation.sub, sensitivities=False)
    weighted = search.root(0, r)[:, :, None] ** 2 * evaluation.jacobians[0][r]
    for other in others:
        there = replace(search, runs=[other if k == r else run for k, run in enumerate(search.runs)])
        changed, _ = there.simulated(evaluation.unknowns, 0, r, evaluation.sub, sensitivities=False)
        g = np.zeros(len(evaluation.unknowns))
        g[own] = np.tensordot(weighted, other.beside_nuisances(y - changed, known, names), axes=([0, 1], [0, 1]))
        yield g
