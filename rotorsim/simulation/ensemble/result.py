"""The result of an ensemble: what was kept of every run, how each ended, with what it was run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim._shown import Shown
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.simulation.result import flat_name

COLUMNS = ("peak", "peak_to_peak", "mean", "rms", "radius", "last", "harmonics")  # kinds that fit into a table


@dataclass(frozen=True, eq=False)
class Ensemble(Shown):
    """Reductions of n runs of one diagram.

    parameters: varied ones by name, (n, ...) in SI. values: kind ("peak", "harmonics", ...; see
    `rotorsim.simulation.ensemble.reductions.KINDS`) -> signal -> (n, ...); NaN where a run did not reach its end.
    status, message: of every run, as in `Result`. step_error: relative, (n,). units: of parameters and signals.
    window: (n, 2) [s], of the reductions. stop, step: (n,) [s]. counters: runs, alone (those that had to run by
    themselves), CPU seconds. shapes: of signals. provenance: what was run, with what.

    ``ensemble["peak", "rotor.displacement"]`` are the values of one signal.
    """

    parameters: Mapping[str, np.ndarray]
    values: Mapping[str, Mapping[str, np.ndarray]]
    status: np.ndarray
    message: tuple[str, ...]
    step_error: np.ndarray
    units: Mapping[str, str]
    shapes: Mapping[str, tuple[int, ...]]
    window: np.ndarray
    stop: np.ndarray
    step: np.ndarray
    counters: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.ensemble:ensemble_figure"

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, key: tuple[str, str]) -> np.ndarray:
        """Return the values (n, ...) of a kind and a signal. Raises RotorsimError for what was not kept."""
        kind, signal = key
        if kind not in self.values:
            raise RotorsimError(Problem("this was not kept of the runs", kind, hint=near_miss(kind, self.values)))
        if signal not in self.values[kind]:
            hint = near_miss(signal, self.values[kind]).replace("known:", "recorded:")
            raise RotorsimError(Problem(f"no {kind} of this signal was kept", signal, hint=hint))
        return self.values[kind][signal]

    @property
    def finished(self) -> np.ndarray:
        """Which runs finished, (n,)."""
        return np.asarray(self.status == "finished")

    @property
    def counts(self) -> dict[str, int]:
        """How many runs ended how."""
        return dict(Counter(self.status.tolist()))

    def to_table(self) -> list[dict[str, Any]]:
        """Return one row for every run: varied parameters [SI], status, and what is one number of each signal's entry.

        Of harmonics the amplitude (0-peak) and the phase [deg] of every order.
        """
        columns: dict[str, np.ndarray] = {}
        for name, array in self.parameters.items():
            columns |= _entries(name, array)
        columns["status"] = self.status
        for kind in (kind for kind in COLUMNS if kind in self.values):
            for name, array in self.values[kind].items():
                if kind != "harmonics":
                    columns |= _entries(f"{kind} {name}", array)
                    continue
                for k in range(array.shape[-1]):
                    columns |= _entries(f"{k}X {name}", np.abs(array[..., k]))
                    if k:
                        columns |= _entries(f"{k}X phase {name}", np.degrees(np.angle(array[..., k])))
        columns["message"] = np.array(self.message, object)
        return [{name: _plain(column[k]) for name, column in columns.items()} for k in range(len(self))]

    def __repr__(self) -> str:
        ended = ", ".join(f"{n} {status}" for status, n in self.counts.items())
        return f"Ensemble({self.provenance.get('diagram', '')}: {len(self)} runs, {ended}; {', '.join(self.values)})"


def _entries(name: str, array: np.ndarray) -> dict[str, np.ndarray]:
    """Return every entry of values (n, *shape) by its flat name."""
    return {flat_name(name, index): array[:, *index] for index in np.ndindex(array.shape[1:])}


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
