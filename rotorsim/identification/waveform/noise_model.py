"""What counts as noise beside a diagram: what a flexible model leaves of the runs, and what an adequate one may leave.

How it is weighed: `rotorsim.identification.waveform.noise`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from math import log
from operator import attrgetter

import numpy as np

from rotorsim.block import In
from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.waveform.driven.equations import ForceMap, driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.evaluation import Evaluation, Label
from rotorsim.identification.waveform.noise import (
    Stretch,
    Variance,
    left_over,
    misfits_left_out,
    residual_variance,
    reweighted,
    stretches_of,
    unpredicted,
    variance_scale,
    weights_of,
)
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun, mean_of
from rotorsim.identification.waveform.search import SIMULATION_SUBSTEPS, OutputErrorSearch
from rotorsim.identification.waveform.shooting import angle_starts, is_lost, shot
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM, subsystems_of
from rotorsim.linear import linearisation as linear

SIMULATION_DIVERGES = "its simulation diverges"
ACCURACY = 3e-4  # of the scale of a signal, of the steps between samples
ACCURATE_SUBSTEPS = 16  # between samples, to be as accurate
ANGLE_STEPS = 6  # from each start of free angles, before the best is followed
MOST_PORTS = 4  # where a flexible force is tried
SIGNALS = 200  # whose size is evaluated


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """What counts as noise in some runs.

    variance: mean square of every output. rows: independent samples. stretches: into which the runs are divided.
    allowed (B,): what an adequate model may leave of each when it is left out. by_force: whether noise is what a
    diagram with a flexible force leaves; else what no black box predicts. unjudged: see `Noise`. least: steps between
    samples. starts: states at the first samples. theta (m,): parameters of the diagram that leave least; near: by name.
    sizes: largest magnitude of every signal, recorded or simulated.
    """

    variance: Variance
    rows: int
    stretches: tuple[Stretch, ...]
    allowed: np.ndarray
    by_force: bool
    unjudged: str
    least: int
    starts: Mapping[Label, float]
    theta: np.ndarray
    near: Mapping[str, float]
    sizes: Mapping[str, float]


def noise_model(
    diagram: Diagram, channels: Channels, runs: Sequence[SampledRun], near: NoiseModel | None = None
) -> NoiseModel:
    """Return what counts as noise in some runs; near: of the same runs a little otherwise, where the fit begins.

    Raises RotorsimError where the diagram diverges when it is driven as recorded.
    """
    base, evaluation = _base(subsystems_of(diagram, channels), runs, near)
    if not np.isfinite(evaluation.cost) and base.substeps(evaluation.unknowns) >= SIMULATION_SUBSTEPS:
        what = f"has modes too fast for {SIMULATION_SUBSTEPS} steps between samples"
        hint = "correct its stiffness or mass, or leave it out: a lag that is faster than the recording shows is a gain"
        raise RotorsimError(Problem(what, diagram.name, hint=hint))
    if not np.isfinite(evaluation.cost):
        hint = "start from values nearer to the machine's, or check the signs and units of what drives it"
        if np.isfinite(base.unlimited.evaluate(evaluation.unknowns, evaluation.sub).cost):
            hint = "it takes the root or the logarithm of a number below zero, as of a tank that runs empty: put a max "
            hint += "with 0 in front (block min_max), or start from other values"
        raise RotorsimError(Problem(f"{SIMULATION_DIVERGES} when it is driven as recorded", diagram.name, hint=hint))
    sizes = _sizes(diagram, channels, base, evaluation)
    weights = {signal: 1 / value for signal, value in residual_variance(base, evaluation).items()}
    flexible, residual = _flexible(diagram, channels, replace(base, weights=weights), evaluation, sizes)
    stretches = stretches_of(runs)
    given, after = residual_variance(base, evaluation), residual_variance(flexible, residual)
    by_force = flexible.m > base.m and min(after[s] / given[s] for s in given) < CRITERIA.surpassed
    if by_force:  # a force that may be any law explains much
        share = _noise_share(flexible, residual)
        noise = left_over(flexible, residual, stretches, share)
        weighted = replace(base, weights=weights_of(noise.variance, runs, noise.rows))
        allowed = allowed_misfits(noise.left, misfits_left_out(weighted, evaluation, stretches), share)
    else:
        noise = unpredicted(diagram, base, evaluation, stretches)
        allowed = CRITERIA.model_error * noise.left
    return NoiseModel(
        variance=noise.variance,
        rows=noise.rows,
        stretches=stretches,
        allowed=allowed,
        by_force=by_force,
        unjudged=noise.unjudged,
        least=base.least,
        starts=flexible.starts(residual.unknowns),
        theta=evaluation.unknowns[: base.m],
        near=dict(zip((item.name for item in base.free), evaluation.unknowns.tolist(), strict=False)),
        sizes=sizes,
    )


def allowed_misfits(flexible: np.ndarray, given: np.ndarray, noise: float) -> np.ndarray:
    """Return what an adequate model may leave of stretches left out, (B,).

    flexible, given: what the flexible model and the diagram leave; noise: the share of the former that can be noise.
    """
    if noise < 1:
        return np.asarray(CRITERIA.no_worse**2 * noise * flexible)
    return np.asarray(
        np.maximum(CRITERIA.no_worse**2 * flexible, flexible + CRITERIA.flexible_share * (given - flexible))
    )


def _noise_share(search: OutputErrorSearch, evaluation: Evaluation) -> float:
    """Return the share of the residual that can be noise: 1, unless that is much of a signal, and smooth.

    Then it is the share of its white part, half of the mean square of its differences (J. von Neumann, Ann. Math.
    Stat. 12 (1941) 367): the flexible model has failed, and what it leaves is motion.
    """
    square, white, total = (
        sum(np.nansum(part**2, axis=0) for part in parts)
        for parts in (
            evaluation.residuals[0],
            [np.diff(error, axis=0) / np.sqrt(2) for error in evaluation.residuals[0]],
            [y - mean_of(y) for y in search.measured[0]],
        )
    )
    failed = (square > CRITERIA.noisy**2 * total) & (white < CRITERIA.white * square)
    return float(max((white[failed] / square[failed]).min(initial=1.0), CRITERIA.resolution))


def _base(
    systems: tuple[Simulation, ...], runs: Sequence[SampledRun], near: NoiseModel | None
) -> tuple[OutputErrorSearch, Evaluation]:
    """Return the fit of the diagram as it is, at steps that are short enough.

    Controllers with their measured inputs come first; what they leave is their noise, whatever the whole leaves.
    """
    search = OutputErrorSearch(systems, runs, {})
    scale = variance_scale(search)
    search = replace(search, weights={signal: 1 / value for signal, value in scale.items()})
    if near is not None:
        search = replace(
            search, weights={signal: 1 / value for signal, value in near.variance.items()}, least=near.least
        )
        start = search.first(near.starts)
        start[: search.m] = near.theta
        return search, search.minimise(start)
    starts = angle_starts(search, search.first())
    start = starts[0]
    if len(systems) > 1:
        whole = {signal: weight for signal, weight in search.weights.items() if signal[0] == WHOLE_DIAGRAM}
        evaluation = replace(search, weights={**search.weights, **dict.fromkeys(whole, 0.0)}).minimise(start)
        start = evaluation.unknowns
        if np.isfinite(evaluation.cost):
            weights = {signal: 1 / value for signal, value in residual_variance(search, evaluation).items()}
            search = replace(search, weights={**weights, **whole})
    if len(starts) > 1:
        turned = [start.copy() for _ in starts]
        for point, other in zip(turned, starts, strict=True):
            point[search.angles] = other[search.angles]
        still = replace(search, systems=tuple(replace(system, by_start=False) for system in systems), hold="starts")
        start = min((still.minimise(point, ANGLE_STEPS) for point in turned), key=attrgetter("cost")).unknowns
    evaluation = search.minimise(start)
    if is_lost(search, evaluation):
        evaluation = min(evaluation, search.minimise(shot(search, start)), key=attrgetter("cost"))
    return refined(search, evaluation, scale)


def refined(
    search: OutputErrorSearch, evaluation: Evaluation, scale: Mapping[tuple[str, str], float]
) -> tuple[OutputErrorSearch, Evaluation]:
    """Return a fit at steps so short that half of them would change it by less than ACCURACY of the signals."""
    while search.least < ACCURATE_SUBSTEPS and not _is_fine(search, evaluation, scale):
        search = replace(search, least=2 * search.least)
        evaluation = search.minimise(evaluation.unknowns)
    return search, evaluation


def _is_fine(search: OutputErrorSearch, evaluation: Evaluation, scale: Mapping[tuple[str, str], float]) -> bool:
    """Return whether half the step, or none, would change what is simulated by less than ACCURACY.

    A linear diagram is simulated without steps, but not what a law of a fault makes of it.
    """
    stepped, point = replace(search, stepped=True), evaluation.unknowns
    coarse = stepped.evaluate(point, stepped.substeps(point), sensitivities=False)
    fine = search.evaluate(point, 2 * coarse.sub, sensitivities=False)
    if not (np.isfinite(coarse.cost) and np.isfinite(fine.cost)):
        return not np.isfinite(fine.cost)
    changed = [
        np.sqrt(mean_of((b - a) ** 2)) / np.sqrt([scale[signal] for signal in system.signals])
        for system, some, more in zip(search.systems, coarse.residuals, fine.residuals, strict=True)
        for a, b in zip(some, more, strict=True)
    ]
    return bool(np.concatenate(changed).max() <= ACCURACY)


def _sizes(diagram: Diagram, channels: Channels, base: OutputErrorSearch, evaluation: Evaluation) -> dict[str, float]:
    """Return the largest magnitude of every signal of the diagram, simulated, and of every recorded one."""
    signals = base.systems[0].equations.model.signals
    names = [name for port, signal in signals.items() for name in linear.entry_names(port, signal.shape)][:SIGNALS]
    equations = driven_equations(diagram, names, channels.inputs, diagram.free, fastest=channels.fastest)
    search = replace(base, systems=(Simulation(equations, sensitive=False),))
    unknowns = search.first(base.starts(evaluation.unknowns))
    unknowns[: search.m] = evaluation.unknowns[: search.m]
    runs = [run.values for run in base.runs]
    sizes = {name: max(float(np.nanmax(np.abs(own[name]), initial=0.0)) for own in runs) for name in runs[0]}
    for r in range(len(base.runs)):
        y, _ = search.simulated(unknowns, 0, r, evaluation.sub, sensitivities=False)
        for name, size in zip(names, np.nan_to_num(np.abs(y).max(axis=0)), strict=True):
            sizes[name] = max(sizes.get(name, 0.0), float(size))
    return sizes


def _force_maps(diagram: Diagram, channels: Channels, sizes: Mapping[str, float]) -> list[ForceMap]:
    """Return a flexible force at every additive scalar port whose displacement was measured."""
    ports = (
        (str(port), f"{name}.{port.declaration.conjugate}", f"{name}.velocity")
        for name, node in diagram.nodes.items()
        for port in node.inputs.values()
        if port.shape == () and isinstance(port.declaration, In)
        if port.declaration.additive and port.declaration.conjugate
    )
    measured = ((port, q, v) for port, q, v in ports if q in channels.outputs and sizes.get(q) and sizes.get(v))
    return [ForceMap(port, q, v, (sizes[q], sizes[v])) for port, q, v in islice(measured, MOST_PORTS)]


def _flexible(
    diagram: Diagram, channels: Channels, given: OutputErrorSearch, evaluation: Evaluation, sizes: Mapping[str, float]
) -> tuple[OutputErrorSearch, Evaluation]:
    """Return the fit of the flexible model that leaves least; the diagram as it is where none does better."""
    m, forces = given.m, _force_maps(diagram, channels, sizes)
    best = reweighted(given, evaluation.unknowns) if forces else (given, evaluation)
    base = best[0]
    for force in forces:
        search = replace(base, systems=subsystems_of(diagram, channels, force=force))
        for start in (evaluation.unknowns, base.first()):  # where the fit went, and where the diagram stood
            after = reweighted(search, np.concatenate([start[:m], np.zeros(force.count), start[m:]]))
            best = min(best, after, key=_left)
    return best


def _left(fit: tuple[OutputErrorSearch, Evaluation]) -> float:
    """Return the sum of the logarithms of what is left of every signal: minus twice a log-likelihood, per sample."""
    search, evaluation = fit
    return sum(map(log, residual_variance(search, evaluation).values())) if np.isfinite(evaluation.cost) else np.inf
