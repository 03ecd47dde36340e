"""Before and after a diagnosis beside what was measured: harmonics of both diagrams, or both simulated in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.conclusions import Diagnosis
from rotorsim.diagnosis.evidence.harmonic import Source
from rotorsim.diagnosis.evidence.scoring import Held, predict
from rotorsim.errors import RotorsimError
from rotorsim.identification.identification import Identification
from rotorsim.identification.whitening import harmonics_of_time
from rotorsim.jobs.threads import one_thread
from rotorsim.report.identification.comparison import EXCEEDED, Comparison, Harmonics, Signal

__all__ = ["Pair", "Trace", "excess_of", "fitted_pair", "held_pair", "labels_of", "traces"]


@dataclass(frozen=True, eq=False)
class Pair:
    """The diagram as given (before) and repaired (after) beside the same runs.

    None where a diagram has no settled motion. held: the runs took no part in fitting. same: there is no difference.
    labels: what the diagrams are called.
    """

    before: Comparison | None
    after: Comparison | None
    held: bool
    same: bool
    labels: Mapping[str, str]

    @property
    def any(self) -> Comparison:
        """A comparison, for what was measured."""
        found = self.after or self.before
        assert found is not None
        return found

    @property
    def models(self) -> list[tuple[str, Comparison]]:
        """The diagrams that predict something, by name: "before", "after", or "model" where nothing was changed."""
        if self.same and self.after is not None:
            return [("model", self.after)]
        return [(name, one) for name, one in (("before", self.before), ("after", self.after)) if one is not None]

    @property
    def runs(self) -> str:
        """What the runs are called."""
        return "held-out runs" if self.held else "runs that were fitted"

    @cached_property
    def _curves(self) -> dict[tuple[int, str, str, tuple[int, ...]], tuple[np.ndarray, np.ndarray]]:
        return {}

    def curve(
        self, compared: Comparison, group: str, signal: Signal, orders: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return speeds and harmonics of a diagram over speed (`Comparison.curve`), computed once."""
        key = id(compared), group, signal.x, tuple(orders.tolist())
        if key not in self._curves:
            self._curves[key] = compared.curve(group, signal, orders)
        return self._curves[key]

    @cached_property
    def every(self) -> list[Signal]:
        """Every measured signal: two axes together where both were measured, nodes one by one."""
        return self.any.every

    @cached_property
    def telling(self) -> list[Signal]:
        """One signal of each port: of several nodes the one that the diagram as given explains least."""
        compared = self.before or self.any
        best: dict[str, tuple[float, Signal]] = {}
        for signal in self.every:
            excess = [
                float(np.nan_to_num(excess_of(compared, r, signal)).max()) for r in range(len(self.any.experiment.runs))
            ]
            port = signal.x.partition("[")[0]
            if port not in best or max(excess) > best[port][0]:
                best[port] = max(excess), signal
        return [signal for _, signal in best.values()]


def excess_of(compared: Comparison, r: int, signal: Signal) -> np.ndarray:
    """Return what a model leaves of each harmonic of run r in standard deviations of the noise, (orders,).

    |R - R_model| / sqrt(trace of the covariance of R); noise alone has a root mean square of 1.
    """
    measured = compared.measured(r, signal)
    return np.asarray(np.abs(measured.value - compared.model(r, signal)) / deviation(measured))


def deviation(measured: Harmonics) -> np.ndarray:
    """Return the square root of the trace of the covariance of each harmonic, (orders,)."""
    alone = measured.noise**2 / -np.log(EXCEEDED)
    across = np.abs(measured.value) * np.minimum(measured.phase_std, 1.0)
    return np.asarray(np.sqrt(np.maximum(alone, measured.amplitude_std**2 + across**2)) + 1e-300)


def labels_of(found: Diagnosis) -> dict[str, str]:
    """Return what the diagrams before and after are called; "model" where nothing was changed."""
    after = "nearest model" if found.verdict == "outside_catalogue" else "repaired diagram"
    return {"before": "diagram as given", "after": after, "model": "diagram as given"}


def fitted_pair(found: Diagnosis) -> Pair | None:
    """Return both diagrams beside the runs that they were fitted to; None for recordings in time."""
    source = found.source
    if source is None or not getattr(source, "harmonics", ()):
        return None
    return _pair(found, _fitted(source), None if found.readings is None else _fitted(found.readings[0]), held=False)


def held_pair(found: Diagnosis) -> Pair | None:
    """Return both diagrams beside the held-out runs (the larger set of two), or the fitted ones without any."""
    part = _larger(found.held)
    if part is None:
        return fitted_pair(found)
    return _pair(found, part, None if found.readings is None else _larger(found.readings[1]), held=True)


def _fitted(source: Source) -> Held:
    return Held(source.recording, source.harmonics)


def _larger(parts: Sequence[Held]) -> Held | None:
    return max((part for part in parts if part.harmonics), key=lambda part: len(part.harmonics), default=None)


def _pair(found: Diagnosis, part: Held, readings: Held | None, *, held: bool) -> Pair | None:
    """Return both diagrams beside runs; the one as given beside readings as they are, where converters were found."""
    source = found.source
    assert source is not None
    first = values_in(found.before.document, found.before.values)
    same = not found.effects and found.after is found.before
    before = _comparison(first, source, part if readings is None else readings)
    after = before if same else _comparison(found.document, source, part)
    return None if before is None and after is None else Pair(before, after, held, same, labels_of(found))


def _comparison(document: Mapping[str, Any], source: Source, part: Held) -> Comparison | None:
    try:
        with one_thread():
            found = predict(document, source, part)
    except (RotorsimError, ValueError, np.linalg.LinAlgError):
        return None
    experiment = found.experiment
    if not np.isfinite(found.evaluation.Y).any():
        return None
    pairs = zip(found.evaluation.Y, experiment.fits, strict=True)
    predicted = np.array([harmonics_of_time(y, fit.speed) for y, fit in pairs])
    nobody = cast(Identification, None)  # nothing was identified: only titles of other figures use it
    return Comparison(nobody, part.recording, experiment, experiment.theta0, predicted)


# -- in time -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Trace:
    """A measured signal of one run in time (N,) and what both diagrams simulate (None where one diverges)."""

    run: str
    name: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray | None
    after: np.ndarray | None
    held: bool


def traces(found: Diagnosis) -> list[Trace]:
    """Return the signals of held-out runs, else of those that were fitted, of a diagnosis in time; else nothing."""
    from rotorsim.diagnosis.evidence.waveform.data import read_run
    from rotorsim.diagnosis.evidence.waveform.source import TimeSource

    source: Any = found.source
    if not isinstance(source, TimeSource):
        return []
    runs, held = list(source.runs), False
    try:
        if found.held:
            first, *others = found.held
            wanted = [*first.recording.select("hold_out"), *(run for part in others for run in part.recording.runs)]
            diagram = source.load(found.before.document)
            runs, held = [read_run(diagram, run, source.channels) for run in wanted] or runs, bool(wanted)
    except RotorsimError:
        pass
    same = not found.effects and found.after is found.before
    before = _simulated(values_in(found.before.document, found.before.values), source, runs)
    after = before if same else _simulated(found.document, source, runs)
    units = {name: source.recording.channels[column].unit for name, column in source.channels.columns.items()}
    names = source.channels.outputs
    return [
        Trace(
            run.id,
            name,
            units.get(name, ""),
            run.start + run.dt * np.arange(run.size),
            run.values[name],
            None if before is None else before[r][:, c],
            None if after is None else after[r][:, c],
            held,
        )
        for r, run in enumerate(runs)
        for c, name in enumerate(names)
    ]


def _simulated(document: Mapping[str, Any], source: Any, runs: Sequence[Any]) -> list[np.ndarray] | None:
    """Return the outputs of a diagram in every run, (N, c), with the states at the first samples at their best."""
    from rotorsim.diagnosis.evidence.waveform.search import TimeSearch
    from rotorsim.diagnosis.evidence.waveform.views import WHOLE, views_of

    try:
        view = views_of(source.load(document), source.channels)[0]
        weights = np.array([1 / source.variance[WHOLE, name] for name in view.outputs])
        with one_thread():
            search = TimeSearch([view], runs, [[weights] * len(runs)], least=source.least, hold="theta")
            found = search.minimise(search.first())[1]
    except (RotorsimError, ValueError, KeyError, np.linalg.LinAlgError):
        return None
    if not np.isfinite(found.cost):
        return None
    order = [list(view.outputs).index(name) for name in source.channels.outputs]
    return [
        run.measured(view.outputs)[:, order] - errors[:, order]
        for run, errors in zip(runs, found.errors[0], strict=True)
    ]
