"""The next experiment in time: which input, amplitude, or sensor would determine what the data leave open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from rotorsim.criteria import Z90
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.identification.advice import LONGER, Advice
from rotorsim.identification.verdict import relative_width
from rotorsim.identification.waveform.driven.equations import driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.errors import errors_of
from rotorsim.identification.waveform.estimate import TimeEstimate, without_starts
from rotorsim.identification.waveform.noise_model import NoiseModel
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM
from rotorsim.linear import linearisation as linear

TRIED = "length, amplitude, pace or sensor"
LARGER = (2.0, 4.0)  # times as large
PACES = (2.0, 0.5)  # times as fast
MOST_SENSORS = 40  # signals that are tried
SENSOR_SAMPLES = 8192  # of all runs, on which sensors are tried
SMALL_NOISE = 1e-3  # of the rms of a signal: what the noise of a further sensor is at least


def advise_in_time(
    estimate: TimeEstimate, noise: NoiseModel, channels: Channels, open_names: Sequence[str], precision: float
) -> list[Advice]:
    """Return changes of the experiment that would determine parameters left open, the most helpful first.

    Tried are longer runs, inputs of other amplitudes and paces, and sensors of further signals, whose noise is taken
    to be as large, of their rms, as that of the measured ones. Each is judged by the information that it would add at
    the estimate, and by how much wider than by white noise the intervals at hand are.
    """
    names = [item.name for item in estimate.free]
    wanted = [names.index(name) for name in open_names]
    at_hand = estimate.information
    white = np.sqrt(np.maximum(np.diag(_inverse(at_hand)), 0.0))
    sound = np.isfinite(estimate.std) & (estimate.std > 0) & (white > 0)
    factor = np.where(sound, estimate.std / np.where(white > 0, white, 1.0), 1.0)
    factor[~sound] = np.median(factor[sound]) if sound.any() else 1.0
    results = []
    for change, added in _candidates(estimate, noise, channels):
        std = factor * np.sqrt(np.maximum(np.diag(_inverse(at_hand + added)), 0.0))
        widths = [relative_width(float(estimate.theta[j]), Z90 * std[j], estimate.free[j].unit) for j in wanted]
        solved = tuple(names[j] for j, width in zip(wanted, widths, strict=True) if width <= precision)
        if solved:
            results.append((len(solved), -float(np.max(widths)), Advice(change, std, solved)))
    results.sort(key=lambda item: item[:2], reverse=True)
    return [advice for _, _, advice in results]


def _inverse(information: np.ndarray) -> np.ndarray:
    """Return the covariance that information promises, very large where it is none."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-100))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, 1e-13)) @ vectors.T * np.outer(scale, scale))


def _candidates(estimate: TimeEstimate, noise: NoiseModel, channels: Channels) -> Iterator[tuple[str, np.ndarray]]:
    """Yield changes in words with the information (m, m) that they add."""
    search, unknowns = estimate.search, estimate.evaluation.unknowns
    yield f"runs {LONGER:g} times as long", (LONGER - 1) * estimate.information
    driving = [name for name in channels.inputs if any(np.ptp(run.values[name]) > 0 for run in search.runs)]
    for name, times in ((name, times) for name in driving for times in LARGER):
        runs = [replace(run, values={**run.values, name: times * run.values[name]}) for run in search.runs]
        yield from _repeated(f"the same runs again with {name} {times:g} times as large", search, runs, unknowns)
    for pace in PACES if driving else ():
        runs = [replace(run, time=run.start + (run.time - run.start) / pace) for run in search.runs]
        text = f"the same runs again with {' and '.join(driving)} {'twice' if pace > 1 else 'half'} as fast"
        yield from _repeated(text, search, runs, unknowns)
    yield from _sensors(estimate, noise, channels)


def _repeated(
    text: str, search: OutputErrorSearch, runs: Sequence[SampledRun], unknowns: np.ndarray
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the information of further runs, unless they diverge."""
    further = replace(search, runs=runs)
    evaluation = further.evaluate(unknowns, further.substeps(unknowns))
    if np.isfinite(evaluation.cost):
        m = search.m
        yield text, without_starts(_without_priors(search, evaluation.information), m)


def _without_priors(search: OutputErrorSearch, information: np.ndarray) -> np.ndarray:
    out = information.copy()
    for j, item in enumerate(search.free):
        out[j, j] -= 0.0 if item.prior_std is None else 1 / item.prior_std**2
    return out


def _sensors(estimate: TimeEstimate, noise: NoiseModel, channels: Channels) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the information that a sensor of each signal that was not measured would add to the same runs."""
    whole, diagram = estimate.search.systems[0].equations, estimate.search.systems[0].equations.model.diagram
    names = _unmeasured(diagram, channels, estimate)
    errors = errors_of(estimate.search, [(estimate.evaluation, [slice(None)] * len(estimate.search.runs))])
    if not names or errors is None:
        return
    floor = errors.floor({name: noise.variance[WHOLE_DIAGRAM, name] for name in errors.outputs})
    share = max(float(np.median([*floor.values()])), SMALL_NOISE)
    try:
        equations = driven_equations(
            diagram, [*whole.outputs, *names], whole.inputs, diagram.free, fastest=whole.fastest
        )
    except RotorsimError:
        return
    short = estimate.search.shortened(SENSOR_SAMPLES)
    runs = [replace(run, values={**run.values, **{name: np.zeros(run.size) for name in names}}) for run in short.runs]
    samples = sum(run.size for run in estimate.search.runs) / sum(run.size for run in runs)
    weights = {(WHOLE_DIAGRAM, name): 1.0 for name in equations.outputs}
    search = OutputErrorSearch((Simulation(equations),), runs, weights, short.least)
    unknowns = search.first(estimate.search.starts(estimate.evaluation.unknowns))
    unknowns[: search.m] = estimate.theta
    evaluation = search.evaluate(unknowns, search.substeps(unknowns))
    if not np.isfinite(evaluation.cost):
        return
    known = [(WHOLE_DIAGRAM, name) for name in whole.outputs]
    measured = dict(zip(known, (estimate.search.weights[signal] for signal in known), strict=True))
    base = _information(search, evaluation.jacobians[0], [*measured.values()], range(len(known)))
    simulated = np.concatenate([-residual for residual in evaluation.residuals[0]])
    level = np.median([weight * noise.variance[signal] for signal, weight in measured.items()])
    for c, name in enumerate(names, start=len(known)):
        size = float(simulated[:, c].std())
        if size > 0:
            weight = level / (share * size) ** 2
            further = base + _information(search, evaluation.jacobians[0], [weight], [c])
            gained = without_starts(further, search.m) - without_starts(base, search.m)
            yield f"a sensor of {name} besides, with noise of {100 * share:.2g} % of its rms", samples * gained


def _unmeasured(diagram: Diagram, channels: Channels, estimate: TimeEstimate) -> list[str]:
    """Return the flat names of signals that blocks compute and nobody measured."""
    signals = estimate.search.systems[0].equations.model.signals
    own = {f"{name}.{port}" for name, node in diagram.nodes.items() for port in node.outputs}
    every = (name for port in own for name in linear.entry_names(port, signals[port].shape) if port in signals)
    return list(islice((name for name in sorted(every) if name not in channels.columns), MOST_SENSORS))


def _information(
    search: OutputErrorSearch, jacobians: Sequence[np.ndarray], weights: Sequence[float], outputs: Sequence[int]
) -> np.ndarray:
    """Return J^T W J (q, q) of some outputs in all runs."""
    size = search.m + len(search.labels)
    total = np.zeros((size, size))
    for r, dy in enumerate(jacobians):
        own, there = search.columns(0, r), np.isfinite(search.measured[0][r])
        for c, weight in zip(outputs, weights, strict=True):
            J = dy[there[:, c], c]
            total[np.ix_(own, own)] += weight * (J.T @ J)
    return total
