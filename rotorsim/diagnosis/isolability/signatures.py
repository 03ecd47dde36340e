"""What the laws of faults tell apart: their signatures in harmonics over speeds and gains, free parameters aside.

The signature of a fault is the span of dY/dsize where its size is nil (exact, from the traced equations), or of what
it changes at its declared starts where it has no nil. With P the projection off the slopes of the free parameters,

    share(a, b) = max over signatures s of a of |P_b P s| / |P s|,

P_b off those of b: what b and the free parameters leave of a. Zero: b explains all that a does.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import LINES, Insertion, fixed_of, starts_of
from rotorsim.diagnosis.evidence.base_fit import with_uncertain
from rotorsim.diagnosis.isolability.motion import LinearMotion, NoSignatureError, Runs
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.coordinates import ANGLE_UNIT
from rotorsim.jobs.threads import one_thread
from rotorsim.linear.linearisation import speed_entries
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.model.load import load
from rotorsim.units import format_quantity

__all__ = ["ALIAS", "HARDLY", "NOISE", "SIGMAS", "Shares", "Signatures", "Size", "runs_of", "signatures_of"]

ANY_LINE = 100.0  # rad/s: does not follow the shaft
ALIAS = 1e-6  # share below which nothing tells two faults apart
HARDLY = 0.03  # share below which only a strong fault is told apart
SMALL = 1e-9  # of columns as long as one another: what is less is rounding
NOISE = 1e-3  # of a signal's rms, in the real and the imaginary part of every harmonic
SIGMAS = 5.0
SPEEDS = (0.5, 0.7, 0.9, 1.15, 1.4)  # of the diagram's speed
GAINS = (1.3, 0.8, 1.1)  # of proportional and derivative gains, the first that is stable
MOST_STARTS = 3
ANGLES = (0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4)
SAME = 1e-7  # of the largest harmonic: a fault of this size is none


@dataclass(frozen=True)
class Size:
    """The parameter that makes a fault large or small, and how many columns its first start has."""

    parameter: str
    unit: str
    columns: int


@dataclass(frozen=True, eq=False)
class Signatures:
    """Signatures of faults: columns (rows, m) of real and imaginary parts, each signal in units of its rms.

    free: columns of the free parameters and of means that are open. sizes: of faults whose columns are by one
    parameter. row_set, row_signal (rows,): set of gains and number of the signal in ``signals``.
    skipped: fault -> why it has no signature. parameters: the names of the free ones.
    """

    runs: Runs
    signals: tuple[str, ...]
    free: np.ndarray
    columns: Mapping[str, np.ndarray]
    sizes: Mapping[str, Size]
    skipped: Mapping[str, str]
    row_set: np.ndarray
    row_signal: np.ndarray
    parameters: tuple[str, ...] = ()

    def shares(self, signals: Sequence[str], *, both: bool, only: Iterable[str] | None = None) -> Shares:
        """Return what is told apart by signals (flat names), with the first set of gains or with both.

        only: faults that matter (default: all).
        """
        rows = np.isin(self.row_signal, [self.signals.index(name) for name in signals])
        rows &= (self.row_set == 0) | both
        names = self.columns if only is None else [name for name in only if name in self.columns]
        with one_thread():
            return Shares(self.free[rows], {name: self.columns[name][rows] for name in names}, self.sizes)


class Shares:
    """What the columns of faults (rows, m) leave of one another beside those of the free parameters (rows, f)."""

    def __init__(self, free: np.ndarray, columns: Mapping[str, np.ndarray], sizes: Mapping[str, Size]) -> None:
        self.names, self.sizes = list(columns), sizes
        whole = np.concatenate([free, *columns.values()], axis=1)
        scale = np.linalg.norm(whole, axis=0)
        few = np.linalg.qr(whole / np.where(scale > 0, scale, 1.0), mode="r") * scale  # as many rows as columns
        ends = np.cumsum([free.shape[1], *(c.shape[1] for c in columns.values())])
        parts = dict(zip(self.names, np.split(few, ends[:-1], axis=1)[1:], strict=True))
        base = _basis(few[:, : ends[0]])
        self.whole = {name: np.linalg.norm(c, axis=0) for name, c in parts.items()}
        self.left = {name: c - base @ (base.T @ c) for name, c in parts.items()}
        spans = {name: self._span(name) for name in self.names}
        self.seen = frozenset(name for name, span in spans.items() if span.shape[1])
        """Faults that the free parameters cannot imitate."""
        self._spans = {name: spans[name] for name in self.names if name in self.seen}

    def _span(self, name: str) -> np.ndarray:
        """Return an orthonormal base of what is left of a signature beyond rounding."""
        left, whole = self.left[name], self.whole[name]
        return _basis(left[:, np.linalg.norm(left, axis=0) > ALIAS * whole])

    def part(self, name: str) -> float:
        """Return the largest part of a signature that the free parameters cannot imitate."""
        left, whole = np.linalg.norm(self.left[name], axis=0), self.whole[name]
        return float((left[whole > 0] / whole[whole > 0]).max(initial=0.0))

    @cached_property
    def _gram(self) -> tuple[np.ndarray, dict[str, slice]]:
        ends = np.cumsum([0, *(span.shape[1] for span in self._spans.values())])
        every = np.concatenate(list(self._spans.values()), axis=1)
        return every.T @ every, {name: slice(*ends[k : k + 2]) for k, name in enumerate(self._spans)}

    def share(self, name: str, other: str) -> float:
        """Return the share of a fault that another leaves; both are seen."""
        gram, parts = self._gram
        common = gram[parts[other], parts[name]]
        rest = np.eye(common.shape[1]) - common.T @ common
        return float(np.sqrt(max(np.linalg.eigvalsh(rest)[-1], 0.0)))

    @cached_property
    def apart(self) -> dict[tuple[str, str], float]:
        """(fault, other) -> share of the fault that the other leaves; of all faults that are seen."""
        return {(a, b): self.share(a, b) for a, b in itertools.permutations(self._spans, 2)}

    def size(self, name: str, other: str | None = None) -> float | None:
        """Return the size from which a fault stands out by SIGMAS, of the free parameters or of another fault too.

        At the worst of some angles; None where the size is not one parameter, or nothing stands out.
        """
        if name not in self.sizes:
            return None
        part = self.left[name][:, : self.sizes[name].columns]
        if other is not None:
            span = self._spans[other]
            part = part - span @ (span.T @ part)
        least = float(np.linalg.norm(part, axis=0).min())
        return SIGMAS * NOISE / least if least > ALIAS * self.whole[name].max() else None


def _basis(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal base of columns, each counted as long as any other."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 0] / size[size > 0]
    if not columns.size:
        return np.zeros((len(columns), 0))
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > SMALL * s[0]])


# -- runs ------------------------------------------------------------------------------------------------------------


def runs_of(diagram: Diagram, speeds: Sequence[float] = ()) -> Runs:
    """Return runs at some speeds [rad/s] with the gains as they are, and again with another set of gains.

    Default: speeds about that of the diagram. Speeds without settled motion are left out. Raises RotorsimError for
    diagrams without a parameter ``speed`` or settled motion.
    """
    model = compile_diagram(diagram)
    entries = speed_entries(model)
    if entries is None or not entries.any():
        hint = 'add "parameters": {"speed": "1500 rpm"} and let the clock follow it'
        raise RotorsimError(Problem("no diagram parameter 'speed'", diagram.name, hint=hint))
    wanted = list(speeds) or [factor * float(model.p0[entries][0]) for factor in SPEEDS]
    first = [{"speed": float(speed)} for speed in wanted if speed]
    first = [one for one in first if _stable(model, one)]
    if not first:
        raise RotorsimError(Problem("no settled motion at any of these speeds", diagram.name))
    gains = _gains(diagram)
    for factor in GAINS if gains else ():  # at every other speed: that is enough
        second = [{**one, **{name: factor * value for name, value, _ in gains}} for one in first[::2]]
        if all(_stable(model, one) for one in second):
            text = ", ".join(f"{name} = {format_quantity(factor * value, unit, 4)}" for name, value, unit in gains)
            return _runs(first, second, text)
    return _runs(first, [], "")


def _runs(first: list[dict[str, float]], second: list[dict[str, float]], gains: str) -> Runs:
    sets = np.repeat([0, 1], [len(first), len(second)])
    return Runs(np.array([one["speed"] for one in (*first, *second)]), (*first, *second), sets, gains)


def _gains(diagram: Diagram) -> list[tuple[str, float, str]]:
    """Return the gains of controllers that another set changes: name, value, unit."""
    found = []
    for block, node in diagram.nodes.items():
        if node.block.category == "controller":
            units = {k: declared.unit or "1" for k, declared in node.block.parameters.items()}
            scalars = {k: float(v) for k, v in node.values.items() if v.ndim == 0 and float(v) != 0.0}
            scalars = {k: v for k, v in scalars.items() if units[k] not in ("s", "rad/s", "1")}
            chosen = [k for k in scalars if k in ("KP", "KD")] or list(scalars)
            found += [(f"{block}.{k}", scalars[k], units[k]) for k in chosen]
    return found


def _stable(model: Model, settings: Mapping[str, float]) -> bool:
    p = model.parameter_vector(settings)
    J = np.array(model.jacobian(0.0, model.x0(p), model.z0(p), p))
    return bool((np.linalg.eigvals(J).real < 1e-6 * max(np.abs(J).max(), 1.0) ** 0.5).all())


# -- signatures ------------------------------------------------------------------------------------------------------


def signatures_of(
    diagram: Diagram,
    faults: Sequence[Insertion],
    signals: Sequence[str],
    runs: Runs,
    *,
    trust_blocks: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Signatures:
    """Return the signatures of faults in signals (flat names; "second ...": what no fault of a sensor touches).

    Free are the parameters that ``identify`` of the diagram names, and those that blocks declare with a tolerance.
    Raises RotorsimError for diagrams that are sampled, not linear, or do not follow the shaft.
    """
    folder = Path(diagram.file).parent if diagram.file else None
    document = with_uncertain(diagram)
    columns: dict[str, np.ndarray] = {}
    sizes: dict[str, Size] = {}
    skipped: dict[str, str] = {}

    def opened(document: Mapping[str, Any]) -> Diagram:
        return load(document, folder=folder, trust_blocks=trust_blocks)

    with one_thread():  # many small matrices
        base = opened(document)
        maker = _Maker(base, signals, runs, document)
        groups = _alike(faults)
        for k, items in enumerate(groups):
            try:
                for key, (found, size) in maker.columns(items, document, opened).items():
                    columns[key] = found
                    if size is not None:
                        sizes[key] = size
            except NoSignatureError as skip:
                skipped.update(dict.fromkeys((item.key for item in items), str(skip)))
            except RotorsimError as error:
                skipped.update(dict.fromkeys((item.key for item in items), error.problems[0].what))
            if progress is not None:
                progress((k + 1) / len(groups))
    columns = {item.key: columns[item.key] for item in faults if item.key in columns}
    return Signatures(
        runs,
        tuple(signals),
        maker.free,
        columns,
        sizes,
        skipped,
        maker.row_set,
        maker.row_signal,
        tuple(item.name for item in base.free),
    )


def _alike(faults: Sequence[Insertion]) -> list[list[Insertion]]:
    """Return faults in groups: forces of one declaration at several places, which at no size do not meet."""
    found: dict[tuple[str, ...], list[Insertion]] = {}
    for item in faults:
        alike = (str(item.variant),) if item.fault.enters == "force" and item.fault.free else (item.key,)
        found.setdefault((item.kind.type_name, item.physics, *alike), []).append(item)
    return list(found.values())


def _renamed(item: Insertion, name: str) -> Insertion:
    """Return an insertion whose block has another name."""

    def end(text: str) -> str:
        return name + text[len(item.name) :] if text.startswith(f"{item.name}.") else text

    return replace(item, name=name, wires=tuple((end(a), end(b)) for a, b in item.wires))


class _Maker:
    """Makes the columns of faults beside those of the free parameters of one diagram."""

    def __init__(self, diagram: Diagram, signals: Sequence[str], runs: Runs, given: Mapping[str, Any]) -> None:
        self.signals, self.runs, self.given = list(signals), runs, given
        self.responses: dict[bytes, np.ndarray] = {}
        motion = LinearMotion(diagram, signals, runs, diagram.free, self.responses)
        theta = np.array([item.value for item in diagram.free])
        if not motion.is_periodic(theta):
            raise RotorsimError(Problem("the forcing does not follow the shaft", diagram.name))
        found = motion.linear(theta)
        if found is None:
            raise RotorsimError(Problem("the diagram is not linear in its states", diagram.name))
        self.Y, slopes = found
        rms = np.sqrt((np.abs(self.Y) ** 2).sum(axis=1).max(axis=0))
        self.scale = np.where(rms > 0, rms, 1.0)
        self.free = np.concatenate([self.rows(slopes), self.rows(motion.open_means(theta))], axis=1)
        shape = self.Y.shape
        parts = runs.sets[:, None, None], np.arange(shape[2])
        self.row_set, self.row_signal = (np.tile(np.broadcast_to(part, shape).ravel(), 2) for part in parts)
        moving = 2 * np.sqrt((np.abs(self.Y[:, 1:]) ** 2).sum(axis=1))  # sqrt(2) times the rms about the mean
        self.largest = (np.abs(self.Y[:, 0]) + moving).max(axis=0)

    def rows(self, slopes: np.ndarray) -> np.ndarray:
        """Return slopes (R, K+1, c, m) as real columns (rows, m)."""
        flat = (slopes / self.scale[:, None]).reshape(self.Y.size, slopes.shape[-1])
        return np.concatenate([flat.real, flat.imag])

    def columns(
        self, items: Sequence[Insertion], document: Mapping[str, Any], opened: Callable[[Mapping[str, Any]], Diagram]
    ) -> dict[str, tuple[np.ndarray, Size | None]]:
        """Return the signatures of faults that are alike, (rows, m), and what their size is."""
        named = [_renamed(item, f"{item.name}_{k}") for k, item in enumerate(items)] if len(items) > 1 else items
        starts = []
        for item in named:
            sizes = self._sizes(item)
            starts.append(starts_of(item, sizes))
            document = item.document(document, {**fixed_of(item, sizes), **starts[-1][0]})
        placed = opened(document)
        own = [[free for free in placed.free if free.name in item.free] for item in named]
        motion = LinearMotion(placed, self.signals, self.runs, [free for some in own for free in some], self.responses)
        trials = [
            np.concatenate([_values(frees, start) for frees, start in zip(own, trial, strict=True)])
            for trial in zip(*starts, strict=True)
        ]
        if not motion.is_periodic(trials[0]):
            raise NoSignatureError("no harmonics of the shaft: it shows as a line of its own or as sidebands")
        angles = np.array([f.unit == ANGLE_UNIT and f.low == -np.inf for some in own for f in some])
        trials = _without_angles(trials, angles)
        found = self._at_nil(motion, trials, own, angles)
        if found is not None:
            return {item.key: part for item, part in zip(items, found, strict=True)}
        if len(items) > 1:
            return {key: part for item in items for key, part in self.columns([item], self.given, opened).items()}
        some = [part for part in (self._at(motion, theta) for theta in trials) if part is not None and part.size]
        if not some:
            raise NoSignatureError("at its starts it does nothing, or lets no motion settle")
        return {items[0].key: (np.concatenate(some, axis=1), None)}

    def _at_nil(
        self, motion: LinearMotion, starts: Sequence[np.ndarray], own: Sequence[Sequence[Free]], angles: np.ndarray
    ) -> list[tuple[np.ndarray, Size | None]] | None:
        """Return the slopes where the faults have no size, by the parameters that make it so; None if none do."""
        first, width = own[0], len(own[0])
        sizes = [j for j in range(width) if not angles[j] and first[j].low <= 0.0 <= first[j].high]
        turns = ANGLES if angles.any() else (0.0,)
        for which in [[j] for j in sizes] + ([sizes] if len(sizes) > 1 else []):
            every = [k * width + j for k in range(len(own)) for j in which]
            at_nil = [start.copy() for start in starts]
            for theta in at_nil:
                theta[every] = 0.0
            nil = motion.linear(at_nil[0])
            if nil is None or not self._small(nil[0] - self.Y):
                continue
            some = []
            for theta, angle in itertools.product(at_nil, turns):
                theta[angles] = angle
                found = motion.linear(theta)
                if found is not None:
                    some.append(found[1])
            if self._small(some[0][..., every] * np.abs(starts).max(axis=0)[every]):
                continue  # it grows with the square of its size
            item = first[which[0]]
            size = Size(item.name.rpartition(".")[2], item.unit, len(turns)) if len(which) == 1 else None
            parts = [[k * width + j for j in which] for k in range(len(own))]
            return [(self.rows(np.concatenate([s[..., part] for s in some], axis=-1)), size) for part in parts]
        return None

    def _small(self, change: np.ndarray) -> bool:
        """Return whether a change (R, K+1, c, ...) is nothing beside the signals."""
        axes = tuple(k for k in range(change.ndim) if k != 2)
        return bool((np.abs(change).max(axis=axes, initial=0.0) <= SAME * self.scale).all())

    def _at(self, motion: LinearMotion, theta: np.ndarray) -> np.ndarray | None:
        """Return what a fault changes at a start, and its slopes there, less what is rounding; None if unsettled."""
        found = motion.linear(theta) or motion.nonlinear(theta)
        if found is None:
            return None
        every = np.concatenate([(found[0] - self.Y)[..., None], found[1] * np.where(theta, theta, 1.0)], axis=-1)
        kept = [k for k in range(every.shape[-1]) if not self._small(every[..., k])]
        return self.rows(every[..., kept])

    def _sizes(self, item: Insertion) -> dict[str, float]:
        """Return the largest magnitude of the inputs of a fault in the motion of the diagram, and where lines are."""
        out = {LINES: ANY_LINE}
        for key, source in item.feeds.items():
            ports = [name.partition("[")[0] == source.partition("[")[0] for name in self.signals]
            exact = [name.startswith(source.rstrip("]")) for name in self.signals]
            near = self.largest[exact if any(exact) else ports]
            if near.max(initial=0.0) > 0:
                out[key] = float(near.max())
        return out


def _values(frees: Sequence[Free], start: Mapping[str, float]) -> np.ndarray:
    return np.array([start[free.name.rpartition(".")[2]] for free in frees])


def _without_angles(starts: Sequence[np.ndarray], angles: np.ndarray) -> list[np.ndarray]:
    """Return the starts that differ in more than angles."""
    found: dict[bytes, np.ndarray] = {}
    for start in starts:
        found.setdefault(np.where(angles, 0.0, start).tobytes(), start)
    return list(found.values())[:MOST_STARTS]
