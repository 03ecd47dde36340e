"""What a recording in time is to be judged by: the flexible model, what it leaves over, and how that scatters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from rotorsim.block import In
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.harmonic import Fit, left_out
from rotorsim.diagnosis.evidence.waveform.data import Channels, TimeRun, channels_of, read_run
from rotorsim.diagnosis.evidence.waveform.equations import ForceMap, TimeEquations
from rotorsim.diagnosis.evidence.waveform.kernel import TimeKernel
from rotorsim.diagnosis.evidence.waveform.search import Evaluation, Point, TimeSearch
from rotorsim.diagnosis.evidence.waveform.source import MATERIAL, MOST, Stretch, TimeSource, block_misfit, stacked
from rotorsim.diagnosis.evidence.waveform.views import WHOLE, starts_by_name, views_of
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear import linearisation as linear
from rotorsim.recordings.recording import Recording

__all__ = ["judged_by", "open_time_source"]

RESOLUTION = 1e-3  # of the scale of a signal: model errors below are not looked for
ACCURACY = 3e-4  # of the scale of a signal, of the steps between samples
MOST_STEPS = 16
STRETCHES = 20  # of all runs together; 4 of each run at least
MOST_ROWS = 2000
LEAST_ROWS = 4  # times the stretches
REWEIGHTED = 4  # times that a fit and the weights follow one another
FLEXIBLE_EVALUATIONS = 15
NOISY = 0.3  # of the rms of a signal: more is left of it by noise alone only where it is white
WHITE = 0.5  # of the mean square of what is left, from which on it counts as white
MOST_PORTS = 4  # where a flexible force is tried
SIGNALS = 200  # whose size is found


def open_time_source(diagram: Diagram, recording: Recording, *, trust_blocks: bool = False) -> TimeSource:
    """Return the runs to identify from, ready to be fitted to.

    Raises RotorsimError with all that does not fit, and where the diagram diverges when it is driven as recorded.
    """
    channels = channels_of(diagram, recording)
    chosen = recording.select("identify")
    if not chosen:
        hint = '"use": "identify" marks the runs that parameters are taken from'
        raise RotorsimError(Problem("no run to identify from", recording.name, hint=hint))
    runs = tuple(read_run(diagram, run, channels) for run in chosen)
    views = views_of(diagram, channels)
    search = TimeSearch(views, runs, [[np.ones(len(view.outputs))] * len(runs) for view in views])
    search.weights = [[1 / _scale(search, k)] * len(runs) for k in range(len(views))]
    point, found = _base(search)
    if not np.isfinite(found.cost):
        hint = "start from values nearer to the machine's, or check the signs and units of what drives it"
        raise RotorsimError(Problem("its simulation diverges when it is driven as recorded", diagram.name, hint=hint))
    sizes = _sizes(diagram, channels, search, point)
    _reweigh(search, found)
    base, found_base = search, found
    search, point, found = _flexible(diagram, channels, search, point, sizes)
    stretches = _stretches(runs)
    starts: dict[str, list[float]] = {}
    for k, view in enumerate(search.views):
        starts.update(starts_by_name(view, point.starts[k]))
    variance, noise = _variances(search, found), _noise_in(search, found)
    source = TimeSource(
        recording=recording,
        runs=runs,
        channels=channels,
        views=tuple(view.name for view in views),
        variance={name: value * noise for name, value in variance.items()},
        rows=_independent(block_misfit(search, found, stretches), stretches),
        stretches=stretches,
        allowed=np.zeros(0),
        least=search.least,
        starts=starts,
        sizes=sizes,
        old=frozenset(item.name for item in diagram.free),
        folder=str(Path(diagram.file).parent) if diagram.file else None,
        trust_blocks=trust_blocks,
    )
    flexible, given = (_left_out(source, *pair) for pair in ((search, found), (base, found_base)))
    return replace(source, allowed=_allowed(flexible, given, noise))


def _allowed(flexible: np.ndarray, given: np.ndarray, noise: float) -> np.ndarray:
    """Return what an adequate model may leave of stretches left out, (B,).

    flexible, given: what the flexible model and the diagram leave; noise: the share of the former that can be noise.
    """
    if noise < 1:
        return np.asarray(MATERIAL**2 * noise * flexible)
    return np.asarray(np.maximum(MATERIAL**2 * flexible, flexible + MOST * (given - flexible)))


def judged_by(source: TimeSource, fit: Fit) -> TimeSource:
    """Return a source whose noise is what a fit leaves, for one that leaves less than the flexible model."""
    search = source.search(values_in(fit.document, fit.values))
    _, found = _reweighted(search, search.first(source.starts))
    rows = _independent(block_misfit(search, found, source.stretches), source.stretches)
    new = replace(source, variance=_variances(search, found), rows=rows)
    return replace(new, allowed=MATERIAL**2 * _left_out(new, search, found))


def _variances(search: TimeSearch, found: Evaluation) -> dict[tuple[str, str], float]:
    return {
        (view.name, name): float(value)
        for k, view in enumerate(search.views)
        for name, value in zip(view.outputs, _variance(search, found, k), strict=True)
    }


def _noise_in(search: TimeSearch, found: Evaluation) -> float:
    """Return the share of what is left over that can be noise: 1, unless that is much of a signal, and smooth.

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
        if square > NOISY**2 * total and white < WHITE * square:
            least = min(least, white / square)
    return max(least, RESOLUTION)


def _left_out(source: TimeSource, search: TimeSearch, found: Evaluation) -> np.ndarray:
    """Return the misfits of stretches left out, (B,), in the units of a source."""
    search.weights = source.weights(search.views)
    errors, slopes, counts = stacked(search, found, source.stretches)
    return left_out(errors, slopes[:, : search.m], counts)


def _scale(search: TimeSearch, k: int) -> np.ndarray:
    """Return the mean squares of the outputs of a view less their regression on its inputs at the same instant.

    A position that follows its reference is no larger than the distance between them.
    """
    y = np.concatenate(search.measured[k])
    given = [run.inputs(search.views[k].equations.inputs, 1)[:, 0] for run in search.runs]
    inputs = np.column_stack([np.ones(len(y)), np.concatenate(given)])
    left = y - inputs @ np.linalg.lstsq(inputs, y, rcond=None)[0]
    return np.asarray(np.maximum((left**2).mean(axis=0), 1e-300))


def _variance(search: TimeSearch, found: Evaluation, k: int) -> np.ndarray:
    """Return the mean square of what is left of each output of a view, RESOLUTION of its scale at least."""
    errors = np.concatenate(found.errors[k])
    return np.asarray(np.maximum((errors**2).mean(axis=0), RESOLUTION**2 * _scale(search, k)))


def _reweigh(search: TimeSearch, found: Evaluation, only: Sequence[int] | None = None) -> None:
    for k in range(len(search.views)) if only is None else only:
        search.weights[k] = [1 / _variance(search, found, k)] * len(search.runs)


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
            _reweigh(search, found, cells)
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
            if (changed > ACCURACY * np.sqrt(_scale(search, k))).any():
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
    best = base, *_reweighted(base, point)
    for force in _force_maps(diagram, channels, sizes):
        views = views_of(diagram, channels, force=force)
        for start in (point, base.first()):  # where the fit went, and where the diagram stood
            theta = np.concatenate([start.theta, np.zeros(force.count)])
            search = TimeSearch(views, base.runs, base.weights, least=base.least)
            after = search, *_reweighted(search, Point(theta, start.starts))
            if _left(after) < _left(best):
                best = after
    return best


def _reweighted(search: TimeSearch, point: Point) -> tuple[Point, Evaluation]:
    """Return a fit and what it leaves; the weights of the whole follow that, in turns."""
    found = search.evaluate(point)
    for _ in range(REWEIGHTED):
        point, found = search.minimise(point, FLEXIBLE_EVALUATIONS)
        if not np.isfinite(found.cost):
            break
        _reweigh(search, found, [0])
    return point, found


def _left(fit: tuple[TimeSearch, Point, Evaluation]) -> float:
    """Return the sum of the logarithms of what is left of every signal: minus twice a log-likelihood, per sample."""
    search, _, found = fit
    if not np.isfinite(found.cost):
        return np.inf
    return float(sum(np.log(_variance(search, found, k)).sum() for k in range(len(search.views))))


def _stretches(runs: Sequence[TimeRun]) -> tuple[Stretch, ...]:
    total = sum(run.size for run in runs)
    found: list[Stretch] = []
    for r, run in enumerate(runs):
        count = max(4, round(STRETCHES * run.size / total))
        ends = np.linspace(0, run.size, count + 1).astype(int)
        found += [(r, int(a), int(b)) for a, b in pairwise(ends)]
    return tuple(found)


def _independent(energies: np.ndarray, stretches: Sequence[Stretch]) -> int:
    """Return the number of independent samples whose sums of squares would scatter as those of the stretches do.

    The sum over one of B stretches of n independent samples has the relative variance 2 B / n.
    """
    lengths = np.array([last - first for _, first, last in stretches])
    level = energies / lengths
    spread = float((level.std(ddof=1) / level.mean()) ** 2) if level.mean() > 0 else 0.0
    count = 2 * len(level) / max(spread, 1e-9)
    return int(np.clip(count, LEAST_ROWS * len(level), min(MOST_ROWS, lengths.sum())))
