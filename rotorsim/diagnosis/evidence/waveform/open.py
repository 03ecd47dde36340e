"""Recordings in time as evidence: the base fit, the flexible model, what it leaves, and how that scatters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rotorsim.block import In
from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.evidence.base_fit import base_fit
from rotorsim.diagnosis.evidence.opened import Opened
from rotorsim.diagnosis.evidence.waveform.data import Channels, channels_of, chosen_runs, read_run
from rotorsim.diagnosis.evidence.waveform.equations import ForceMap, TimeEquations
from rotorsim.diagnosis.evidence.waveform.evidence import WaveformEvidence
from rotorsim.diagnosis.evidence.waveform.kernel import TimeKernel
from rotorsim.diagnosis.evidence.waveform.noise import (
    block_misfit,
    independent,
    misfits_left_out,
    reweigh,
    reweighted,
    scale_of,
    stretches_of,
    variance_of,
    variances,
    weights_of,
)
from rotorsim.diagnosis.evidence.waveform.search import Evaluation, Point, TimeSearch
from rotorsim.diagnosis.evidence.waveform.views import WHOLE, starts_by_name, views_of
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear import linearisation as linear
from rotorsim.recordings.recording import Recording

__all__ = ["open_waveforms", "waveform_evidence"]

ACCURACY = 3e-4  # of the scale of a signal, of the steps between samples
MOST_STEPS = 16
MOST_PORTS = 4  # where a flexible force is tried
SIGNALS = 200  # whose size is found


def open_waveforms(
    diagram: Diagram,
    recording: Recording,
    hold_out: Recording | None,
    catalogue: Catalogue,
    warnings: Sequence[Problem],
) -> Opened:
    """Return the samples of a recording as evidence, and the fit of the diagram as given."""
    evidence = waveform_evidence(diagram, recording, hold_out, trust_blocks=catalogue.trust)
    base, refined = base_fit(diagram, evidence)
    notes = [Problem(note, severity="warning") for note in refined]
    return Opened(evidence, base, base, evidence, catalogue, held_out=bool(evidence.held), warnings=[*warnings, *notes])


def waveform_evidence(
    diagram: Diagram, recording: Recording, hold_out: Recording | None = None, *, trust_blocks: bool = False
) -> WaveformEvidence:
    """Return the runs to identify from, ready to be fitted to, and those that are only scored.

    Raises RotorsimError with all that does not fit, and where the diagram diverges when it is driven as recorded.
    """
    channels = channels_of(diagram, recording)
    runs = tuple(read_run(diagram, run, channels) for run in chosen_runs(recording))
    held = [*recording.select("hold_out"), *(hold_out.runs if hold_out is not None else ())]
    views = views_of(diagram, channels)
    search = TimeSearch(views, runs, [[np.ones(len(view.outputs))] * len(runs) for view in views])
    search.weights = [[1 / scale_of(search, k)] * len(runs) for k in range(len(views))]
    point, found = _base(search)
    if not np.isfinite(found.cost):
        hint = "start from values nearer to the machine's, or check the signs and units of what drives it"
        raise RotorsimError(Problem("its simulation diverges when it is driven as recorded", diagram.name, hint=hint))
    sizes = _sizes(diagram, channels, search, point)
    reweigh(search, found)
    base, found_base = search, found
    search, point, found = _flexible(diagram, channels, search, point, sizes)
    stretches = stretches_of(runs)
    starts = {
        name: values
        for view, first in zip(search.views, point.starts, strict=True)
        for name, values in starts_by_name(view, first).items()
    }
    noise = _noise_share(search, found)
    variance = {name: value * noise for name, value in variances(search, found).items()}
    rows = independent(block_misfit(search, found, stretches), stretches)
    left = []
    for fitted, evaluation in ((search, found), (base, found_base)):
        fitted.weights = weights_of(fitted.views, runs, variance, rows)
        left.append(misfits_left_out(fitted, evaluation, stretches))
    return WaveformEvidence(
        channels=channels,
        folder=str(Path(diagram.file).parent) if diagram.file else None,
        trust_blocks=trust_blocks,
        recording=recording,
        runs=runs,
        views=tuple(view.name for view in views),
        variance=variance,
        rows=rows,
        stretches=stretches,
        allowed=_allowed(left[0], left[1], noise),
        least=search.least,
        starts=starts,
        sizes=sizes,
        old=frozenset(item.name for item in diagram.free),
        held=tuple(read_run(diagram, run, channels) for run in held),
    )


def _allowed(flexible: np.ndarray, given: np.ndarray, noise: float) -> np.ndarray:
    """Return what an adequate model may leave of stretches left out, (B,).

    flexible, given: what the flexible model and the diagram leave; noise: the share of the former that can be noise.
    """
    if noise < 1:
        return np.asarray(CRITERIA.no_worse**2 * noise * flexible)
    return np.asarray(
        np.maximum(CRITERIA.no_worse**2 * flexible, flexible + CRITERIA.flexible_share * (given - flexible))
    )


def _noise_share(search: TimeSearch, found: Evaluation) -> float:
    """Return the share of the residual that can be noise: 1, unless that is much of a signal, and smooth.

    Then it is the share of its white part, half of the mean square of its differences (J. von Neumann, Ann. Math.
    Stat. 12 (1941) 367): the flexible model has failed, and what it leaves is motion.
    """
    least = 1.0
    for c in range(len(search.views[0].outputs)):
        errors = [each[:, c] for each in found.errors[0]]
        square = float(np.concatenate(errors) @ np.concatenate(errors))
        signals = [y[:, c] - y[:, c].mean() for y in search.measured[0]]
        total = float(sum(y @ y for y in signals))
        white = float(sum(np.diff(e) @ np.diff(e) for e in errors)) / 2
        if square > CRITERIA.noisy**2 * total and white < CRITERIA.white * square:
            least = min(least, white / square)
    return max(least, CRITERIA.resolution)


def _base(search: TimeSearch) -> tuple[Point, Evaluation]:
    """Return the fit of the diagram as it is, at steps that are short enough.

    Controllers with their measured inputs come first; what they leave is their noise, whatever the whole leaves.
    """
    point = search.first()
    cells = range(1, len(search.views))
    if len(cells):
        kept = search.weights[0]
        search.weights[0] = [np.zeros_like(w) for w in kept]
        point, found = search.minimise(point)
        search.weights[0] = kept
        if np.isfinite(found.cost):
            reweigh(search, found, cells)
    point, found = search.minimise(point)
    while search.least < MOST_STEPS and not _is_fine(search, point):
        search.least *= 2
        point, found = search.minimise(point)
    return point, found


def _is_fine(search: TimeSearch, point: Point) -> bool:
    """Return whether half the step would change what is simulated by less than ACCURACY."""
    coarse = search.evaluate(point, slopes=False)
    sub, search.sub = search.sub, 2 * search.sub
    fine = search.evaluate(point, slopes=False)
    search.sub = sub
    if not (np.isfinite(coarse.cost) and np.isfinite(fine.cost)):
        return not np.isfinite(fine.cost)
    for k, errors in enumerate(fine.errors):
        for r, error in enumerate(errors):
            changed = np.sqrt(((error - coarse.errors[k][r]) ** 2).mean(axis=0))
            if (changed > ACCURACY * np.sqrt(scale_of(search, k))).any():
                return False
    return True


def _sizes(diagram: Diagram, channels: Channels, search: TimeSearch, point: Point) -> dict[str, float]:
    """Return the largest magnitude of every signal of the diagram, simulated, and of every recorded one."""
    model = search.views[0].equations.model
    names = [name for port, signal in model.signals.items() for name in linear.entry_names(port, signal.shape)][
        :SIGNALS
    ]
    equations = TimeEquations(diagram, names, channels.inputs, diagram.free)
    kernel = TimeKernel(equations)
    known = starts_by_name(search.views[0], point.starts[0])
    sizes: dict[str, float] = {}
    for r, run in enumerate(search.runs):
        start = equations.model.x0(search.p[r])[equations.kept]
        for k, name in enumerate(equations.state_names):
            start[k] = known.get(f"{WHOLE}:{name}", {r: start[k]})[r]
        p = equations.parameters(search.p[r], point.theta)
        y, _ = kernel.simulate(p, start, run.inputs(equations.inputs, search.sub), run.dt, t0=run.start, slopes=False)
        for k, name in enumerate(names):
            sizes[name] = max(sizes.get(name, 0.0), float(np.nan_to_num(np.abs(y[:, k]).max())))
        for name, values in run.values.items():
            sizes[name] = max(sizes.get(name, 0.0), float(np.abs(values).max()))
    return sizes


def _force_maps(diagram: Diagram, channels: Channels, sizes: dict[str, float]) -> list[ForceMap]:
    """Return a flexible force at every additive scalar port whose displacement was measured."""
    found = []
    for name, node in diagram.nodes.items():
        for port, declared in node.inputs.items():
            declaration = declared.declaration
            if not (isinstance(declaration, In) and declaration.additive and declaration.conjugate):
                continue
            q, v = f"{name}.{declaration.conjugate}", f"{name}.velocity"
            if declared.shape == () and q in channels.outputs and sizes.get(q) and sizes.get(v):
                found.append(ForceMap(f"{name}.{port}", q, v, (sizes[q], sizes[v])))
    return found[:MOST_PORTS]


def _flexible(
    diagram: Diagram, channels: Channels, base: TimeSearch, point: Point, sizes: dict[str, float]
) -> tuple[TimeSearch, Point, Evaluation]:
    """Return the fit of the flexible model that leaves least; the diagram as it is where none does better."""
    best = base, *reweighted(base, point)
    for force in _force_maps(diagram, channels, sizes):
        views = views_of(diagram, channels, force=force)
        for start in (point, base.first()):  # where the fit went, and where the diagram stood
            theta = np.concatenate([start.theta, np.zeros(force.count)])
            search = TimeSearch(views, base.runs, base.weights, least=base.least)
            after = search, *reweighted(search, Point(theta, start.starts))
            if _left(after) < _left(best):
                best = after
    return best


def _left(fit: tuple[TimeSearch, Point, Evaluation]) -> float:
    """Return the sum of the logarithms of what is left of every signal: minus twice a log-likelihood, per sample."""
    search, _, found = fit
    if not np.isfinite(found.cost):
        return np.inf
    return float(sum(np.log(variance_of(search, found, k)).sum() for k in range(len(search.views))))
