"""The time by which sampled pulses are late, all alike: fitted beside the parameters, as steady speeds cannot tell it.

A sampled pulse is stamped at the first sample that sees it, at the last one before, or about it: of all pulses of a
recording the same. The angle is theta + late W then, which no phase can stand for where the speed W changes. Beside the
parameters theta, D = dr/d late, J = dr/d theta, all weighted, and a prior standard deviation s:

late = -(D^T r - h^T H^-1 J^T r) / k,  k = D^T D - h^T H^-1 h + 1/s^2,  h = J^T D,  H = J^T J; its variance is 1/k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.driven.equations import clock_ports
from rotorsim.identification.waveform.evaluation import Evaluation, solved
from rotorsim.identification.waveform.noise import weights_of
from rotorsim.identification.waveform.noise_model import NoiseModel, noise_model
from rotorsim.identification.waveform.recorded.along_angle import turned_later
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.sensors import with_sensor_errors
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM, subsystems_of

LATE_PASSES = 2  # Gauss-Newton steps: what is left is of second order in an angle of a few degrees
LARGEST = 2.0  # standard deviations: a period before and after the sample is 2.4


@dataclass(frozen=True, eq=False)
class OnTime:
    """Runs whose angle is right by the time that pulses were late (shift, std: [s]), and what is noise in them.

    Hum and drift of sensors are fitted beside them, where the shaft turns.
    """

    runs: tuple[SampledRun, ...]
    noise: NoiseModel
    shift: float = 0.0
    std: float = 0.0


def on_time(diagram: Diagram, channels: Channels, runs: Sequence[SampledRun], late: float) -> OnTime:
    """Return runs as their shaft turned; late: standard deviation of the time by which all pulses are late [s].

    Raises RotorsimError where the diagram diverges when it is driven as recorded.
    """
    noise, shift, std = noise_model(diagram, channels, runs), 0.0, 0.0
    if {*clock_ports(diagram)} & {*channels.inputs}:
        runs = with_sensor_errors(diagram, channels, runs, noise)
        noise = noise_model(diagram, channels, runs, noise) if any(run.nuisances is not None for run in runs) else noise
    if not late or not _shows(diagram, channels, runs, noise, late):
        return OnTime(tuple(runs), noise)
    for _ in range(LATE_PASSES):
        turned = [turned_later(run, diagram, shift) for run in runs]
        search = OutputErrorSearch(
            subsystems_of(diagram, channels), turned, weights_of(noise.variance, runs, noise.rows), noise.least
        )
        start = search.first(noise.starts)
        start[: search.m] = noise.theta
        evaluation = search.minimise(start)
        step, std = _step(search, evaluation, [turned_later(run, diagram, late) for run in turned], shift, late)
        shift = float(np.clip(shift + step, -LARGEST * late, LARGEST * late))
    turned = [turned_later(run, diagram, shift) for run in runs]
    return OnTime(tuple(turned), noise_model(diagram, channels, turned, noise), shift, std)


def _shows(diagram: Diagram, channels: Channels, runs: Sequence[SampledRun], noise: NoiseModel, late: float) -> bool:
    """Return whether signals that lag by the speed times a time differ by more than a part of their noise."""
    speeds = [name for name in clock_ports(diagram) if name.endswith(".speed")]
    turned = late * max(float(np.nanmax(np.abs(run.values[name]))) for run in runs for name in speeds)
    squares = {name: max(float(np.nanmean(run.values[name] ** 2)) for run in runs) for name in channels.outputs}
    least = CRITERIA.mesh_error
    return any(turned**2 * squares[name] > least * noise.variance[WHOLE_DIAGRAM, name] for name in squares)


def _step(
    search: OutputErrorSearch, evaluation: Evaluation, later: Sequence[SampledRun], shift: float, late: float
) -> tuple[float, float]:
    """Return how much later pulses are than a shift, and its standard deviation; later: runs ``late`` on."""
    other = replace(search, runs=later).evaluate(evaluation.unknowns, evaluation.sub)
    pairs = [(k, r) for k in range(len(search.systems)) for r in range(len(search.runs))]
    r = np.concatenate([np.nan_to_num(search.root(k, j) * evaluation.residuals[k][j]).ravel() for k, j in pairs])
    D = np.concatenate([np.nan_to_num(search.root(k, j) * other.residuals[k][j]).ravel() for k, j in pairs]) - r
    D /= late
    searched = ~search.at_bound(evaluation.unknowns)
    h, g = (other.gradient - evaluation.gradient)[searched] / late, evaluation.gradient[searched]
    H = evaluation.information[np.ix_(searched, searched)]
    moved = solved(H, h)
    curvature = max(float(D @ D - h @ moved), 0.0) + 1 / late**2
    slope = float(D @ r - moved @ g) + shift / late**2
    return -slope / curvature, float(curvature**-0.5)
