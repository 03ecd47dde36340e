"""Lines of fixed frequency: forces, that the closed loop shows in all signals, or pick-up of some channels only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.harmonic.bounds import open_bounds
from rotorsim.diagnosis.evidence.harmonic.residual import free_amplitudes
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.signals.asynchronous import Asynchronous, with_asynchronous
from rotorsim.signals.pickup import find_mains

TURN = 2 * np.pi


@dataclass(frozen=True)
class _Explained:
    """What a line leaves over, |r|^2, by numbers that are free in each run."""

    rest: float
    free: int

    def criterion(self, rows: int) -> float:
        return self.rest + self.free * float(np.log(max(rows, 2)))


def find_pickups(base: Fit, record: HarmonicRuns) -> list[float]:
    """Return the frequencies [Hz] of lines that the fitted diagram says are no forces.

    Tried are the mains and their multiples, and an asynchronous frequency without sidebands (`HarmonicRuns.second`).
    """
    odds = dict.fromkeys(find_mains(record.recording, record.harmonics), CRITERIA.pickup_odds)
    second = record.second
    if second is not None and not second.follows and second.orders == (0,):
        close = 1 / max(float(np.ptp(item.run.time)) for item in record.harmonics)
        own = second.value / TURN
        near = [at for at in odds if abs(at - own) <= close]
        odds = {at: value for at, value in odds.items() if at not in near} | {
            own: CRITERIA.pickup_odds if near else 0.0
        }
    return sorted(at for at, value in odds.items() if _is_pickup(base, record, at, value))


def _is_pickup(base: Fit, record: HarmonicRuns, frequency: float, odds: float) -> bool:
    """Return whether a line [Hz] is less likely to be a force somewhere than pick-up of some or all channels.

    odds: twice the logarithm of those for pick-up before the channels are looked at.

    A force has one complex amplitude for each entry of its port in each run, and the closed loop says what all channels
    show of it. Pick-up has one for each channel that picks up. Compared by the Bayesian information criterion.
    """
    second = Asynchronous(TURN * frequency, 0.0, False, (0,))
    fitted, _ = with_asynchronous(record.recording, record.harmonics, second)
    if len(fitted) < 1:
        return False
    opened = open_bounds(base, replace(record, harmonics=fitted, second=second))
    if opened is None:  # the diagram is not linear: the mains are taken for what they mostly are
        return odds > 0
    likelihood, order = opened.likelihood, opened.likelihood.K + 1
    runs = range(len(fitted))
    lines = [likelihood.data[r, order, : likelihood.c] for r in runs]
    unit = np.eye(likelihood.c)
    rows = 2 * likelihood.c * len(fitted)

    def explained(columns: Sequence[np.ndarray]) -> _Explained:
        rest = sum(free_amplitudes(likelihood, r, order, columns[r], lines[r])[2] for r in runs)
        return _Explained(rest, 2 * columns[0].shape[1] * len(fitted))

    whole = explained([np.zeros((likelihood.c, 0))] * len(fitted)).rest
    groups: dict[str, list[int]] = {}
    for name, entry in opened.places.items():
        groups.setdefault(_part(name), []).append(entry)
    forces = [explained([opened.transfer[r, order][:, group] for r in runs]) for group in groups.values()]
    channels: dict[str, list[int]] = {}
    for k, name in enumerate(likelihood.experiment.predicted):
        for part in {name, _part(name), name.partition("[")[0]}:
            channels.setdefault(part, []).append(k)
    some = [explained([unit[:, group]] * len(fitted)) for group in channels.values() if len(group) < likelihood.c]
    force = min(forces, key=lambda item: item.criterion(rows))
    partial = min((item.criterion(rows) for item in some), default=np.inf)
    if force.criterion(rows) + odds < partial and whole - force.rest - force.free > CRITERIA.line_force * (
        whole - rows
    ):
        return False
    return min(partial, rows * float(np.log(rows))) < force.criterion(rows) + odds


def _part(name: str) -> str:
    """Return the part of a port, without the axis, that an entry belongs to: rotor.force[3,1] -> rotor.force[3]."""
    port, _, index = name.partition("[")
    node, comma, _ = index.rstrip("]").rpartition(",")
    return f"{port}[{node}]" if comma else port
