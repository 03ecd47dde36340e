"""The run, at another speed or with another gain, that separates two hypotheses.

Separation of two fitted diagrams by n runs alike, in standard deviations:

    S_n^2 = d^T (I / n + J_1 C_1 J_1^T + J_2 C_2 J_2^T)^-1 d

d: difference of their whitened predictions; J: their Jacobians by the free parameters, C: their covariance. What the
parameters can still imitate within their intervals does not count (Hunter and Reiner, Technometrics 7 (1965) 307).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.diagnosis.evidence.change import Change, best_of, change_of
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.identification.harmonic.experiment import open_experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.signals.converters import before_converters
from rotorsim.signals.harmonics import RunHarmonics
from rotorsim.units import format_quantity

SEPARATION_GAINS = (0.7, 1.5)
SLOWER, FASTER = (0.1, 0.25, 0.5), 1.25  # times the lowest and the highest speed of the recording
MOST_GAPS = 6  # between recorded speeds in whose middle a run is tried
REPEATED_RUNS = 3  # of the recording that are repeated with another gain
LARGEST_SIGNAL = (
    2.0  # times the largest signal on record: what exceeds it is not proposed at new gains or higher speeds
)
RPM = np.pi / 30


@dataclass(frozen=True, eq=False)
class _Predicted:
    """A run as a fitted diagram has it: whitened y (n,), its Jacobian by unknowns of unit covariance (n, m)."""

    y: np.ndarray
    scatter: np.ndarray


def best_change(first: Fit, second: Fit, record: HarmonicRuns) -> Change | None:
    """Return the run that separates two fitted diagrams most, or None if none does.

    Tried are speeds between, below and above those on record, and runs on record with another gain.
    """
    return best_of(_separations(first, second, record))


def _separations(first: Fit, second: Fit, record: HarmonicRuns) -> Iterator[Change | None]:
    """Yield what each run tells that both diagrams can make."""
    for words, runs in _changes(record.load(first.document), record):
        both = [_predicted(fit, record, runs) for fit in (first, second)]
        for text, a, b in zip(words, *both, strict=True):
            if a is not None and b is not None:
                yield _separated(text, a, b)


def _separated(words: str, a: _Predicted, b: _Predicted) -> Change | None:
    """Return how far apart a run puts two predictions, with as many of it as that takes; None if it tells nothing."""
    spread = np.concatenate([a.scatter, b.scatter], axis=1)
    vectors, sizes, _ = np.linalg.svd(spread, full_matrices=False)
    d = a.y - b.y
    inside = vectors.T @ d
    rest = max(float(d @ d - inside @ inside), 0.0)
    return change_of(words, lambda n: float(np.sqrt(n * rest + (inside**2 / (1 / n + sizes**2)).sum())))


# -- what can be changed -----------------------------------------------------------------------------------------------


def _changes(diagram: Diagram, record: HarmonicRuns) -> Iterator[tuple[list[str], tuple[RunHarmonics, ...]]]:
    """Yield lists of runs that can be made, with words for each."""
    on_record = sorted(record.harmonics, key=lambda item: abs(item.fit.speed))
    speeds = np.array([abs(item.fit.speed) for item in on_record])
    wanted = _speeds(speeds)
    nearest = [on_record[int(np.argmin(np.abs(np.log(speeds / speed))))] for speed in wanted]
    moved = [
        replace(
            item,
            fit=replace(item.fit, speed=float(np.copysign(speed, item.fit.speed))),
            run=replace(item.run, settings=_without(item)),
        )
        for item, speed in zip(nearest, wanted, strict=True)
    ]
    several = any(_without(item) != _without(on_record[0]) for item in on_record)
    yield (
        [
            f"a run at {_rpm(speed)}" + (f" with the settings of run {item.run.id}" if several else "")
            for speed, item in zip(wanted, nearest, strict=True)
        ],
        tuple(moved),
    )
    places = np.unique(np.linspace(0, len(on_record) - 1, REPEATED_RUNS).round().astype(int))
    repeated = [on_record[int(k)] for k in places]
    for name, node in diagram.nodes.items():
        if "controller" not in node.block.roles:
            continue
        for key, value in node.values.items():
            if value.ndim or not float(value) or key not in ("KP", "KD", "KI"):
                continue
            unit = node.block.parameters[key].unit or "1"
            for factor in SEPARATION_GAINS:
                full = f"{name}.{key}"
                words, changed = [], []
                for item in repeated:
                    gain = _rounded(factor * _number(item.run.settings.get(full), unit, float(value)), 3)
                    changed.append(replace(item, run=replace(item.run, settings={**_without(item), full: gain})))
                    words.append(f"a run at {_rpm(abs(item.fit.speed))} with {full} = {format_quantity(gain, unit)}")
                yield words, tuple(changed)


def _speeds(recorded: np.ndarray) -> list[float]:
    """Return round speeds [rad/s] below, between and above ascending ones, those in the widest gaps."""
    gaps = np.flatnonzero(np.diff(recorded) > 0.05 * recorded[1:])
    widest = sorted(gaps[np.argsort(-np.diff(recorded)[gaps], kind="stable")][:MOST_GAPS])
    middle = [float(np.sqrt(recorded[k] * recorded[k + 1])) for k in widest]
    return [
        _rounded(v / RPM, 2) * RPM for v in (*(part * recorded[0] for part in SLOWER), *middle, FASTER * recorded[-1])
    ]


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _rpm(speed: float) -> str:
    return f"{_rounded(speed / RPM, 3):.10g} rpm"


def _without(item: RunHarmonics) -> dict[str, object]:
    return {key: value for key, value in item.run.settings.items() if key != "speed"}


def _number(given: object, unit: str, default: float) -> float:
    try:
        return default if given is None else float(numeric(given, unit))
    except (ValueProblem, TypeError):
        return default


# -- what diagrams say of it -------------------------------------------------------------------------------------------


def _predicted(fit: Fit, record: HarmonicRuns, runs: tuple[RunHarmonics, ...]) -> Sequence[_Predicted | None]:
    """Return each run as a fitted diagram has it, without its means, or None where it does not settle or goes far."""
    nothing: list[_Predicted | None] = [None] * len(runs)
    try:
        experiment = open_experiment(
            before_converters(record.load(fit.document)),
            record.recording,
            runs=[item.run for item in runs],
            harmonics=runs,
        )
        likelihood = Likelihood(experiment)
        theta = np.array([fit.values.get(item.name, item.value) for item in experiment.free])
        found = experiment.motion.predict(theta)
        Y, dY, settled = found.Y, found.sensitivity(), found.settled
        if experiment.motion.is_linear:
            rates = np.linalg.eigvals(experiment.linear.response(theta, 0, forced=False).A)
            settled = (rates.real <= 1e-6 * np.abs(rates).max()).all(axis=-1)
    except FAILURES:
        return nothing
    scale = _spread(fit, [item.name for item in experiment.free])
    lines = likelihood.orders - Y.shape[1]  # a nonlinear diagram says nothing of lines beside the harmonics
    Y, dY = np.pad(Y, ((0, 0), (0, lines), (0, 0))), np.pad(dY, ((0, 0), (0, lines), (0, 0), (0, 0)))
    turned = np.pi * 1j * Y * (np.arange(likelihood.orders) > likelihood.K)[:, None]  # their phase will be any
    largest = record.largest()
    limits = LARGEST_SIGNAL * np.array([largest.get(name, np.inf) for name in experiment.predicted])
    fastest = max(abs(item.fit.speed) for item in record.harmonics)
    settings = [_without(item) for item in record.harmonics]
    rms = np.sqrt(2 * (np.abs(Y[:, 1:]) ** 2).sum(axis=1))
    for r in range(len(runs)):
        if not settled[r] or not np.isfinite(Y[r]).all():
            continue
        passed = abs(runs[r].fit.speed) < fastest and _without(runs[r]) in settings  # run up through it already
        if not passed and (np.sqrt(2) * rms[r] > limits).any():
            continue
        rows = [
            likelihood.white_at(r, k, np.column_stack([Y[r, k], dY[r, k] @ scale, turned[r, k]]))
            for k in range(1, Y.shape[1])
        ]
        white = np.concatenate(rows)
        nothing[r] = _Predicted(white[:, 0], white[:, 1:])
    return nothing


def _spread(fit: Fit, names: Sequence[str]) -> np.ndarray:
    """Return L with L L^T the covariance of parameters; that of those that nothing holds is large."""
    where = [[item.name for item in fit.free].index(name) for name in names]
    covariance = fit.covariance[np.ix_(where, where)].copy()
    loose = ~np.isfinite(covariance).all(axis=1)
    covariance[loose] = covariance[:, loose] = 0.0
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    root = unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    free = np.array([max(abs(fit.values[name]), 1.0) for name in names])
    return np.concatenate([root, np.diag(free)[:, loose]], axis=1)
