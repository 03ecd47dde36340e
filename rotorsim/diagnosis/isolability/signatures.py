"""Which faults their laws isolate: signatures in harmonics over speeds and gains, free parameters aside.

The signature of a fault is the span of dY/dsize where its size is nil (exact, from the traced equations), or of what
it changes at its declared starts where it has no nil. With P the projection off the sensitivities to the free
parameters,

    share(a, b) = max over signatures s of a of |P_b P s| / |P s|,

P_b off those of b: what b and the free parameters leave of a. Zero: b explains all that a does.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import LINES, Insertion, fixed_of, sizes_at, starts_of
from rotorsim.diagnosis.evidence.base_fit import with_uncertain
from rotorsim.diagnosis.isolability.motion import LinearMotion
from rotorsim.diagnosis.isolability.runs import Runs
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT
from rotorsim.jobs.threads import one_thread
from rotorsim.model.load import load

ANY_LINE = 100.0  # rad/s: asynchronous
ALIAS = 1e-6  # share below which a fault is not isolable from another
HARDLY = 0.03  # share below which only a strong fault is isolable
ZERO_COLUMN = 1e-9  # of columns as long as one another: what is less is rounding
RELATIVE_NOISE = 1e-3  # of a signal's rms, in the real and the imaginary part of every harmonic
SIGMAS = 5.0
MOST_STARTS = 3
PROBE_ANGLES = (0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4)
NO_EFFECT = 1e-7  # of the largest harmonic: a fault of this size is none


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

    def shares(self, signals: Sequence[str], *, both: bool, only: Collection[str] | None = None) -> Shares:
        """Return what signals (flat names) isolate, with the first set of gains or with both.

        only: faults that matter (default: all).
        """
        rows = np.isin(self.row_signal, [self.signals.index(name) for name in signals])
        rows &= (self.row_set == 0) | both
        names = [name for name in self.columns if only is None or name in only]
        with one_thread():
            return Shares(self.free[rows], {name: self.columns[name][rows] for name in names}, self.sizes)


class Shares:
    """What the columns of faults (rows, m) leave of one another beside those of the free parameters (rows, f)."""

    def __init__(self, free: np.ndarray, columns: Mapping[str, np.ndarray], sizes: Mapping[str, Size]) -> None:
        self.names, self.sizes = list(columns), sizes
        whole = np.concatenate([free, *columns.values()], axis=1)
        scale = np.linalg.norm(whole, axis=0)
        few = np.linalg.qr(whole / np.where(scale > 0, scale, 1.0), mode="r") * scale  # as many rows as columns
        ends = np.cumsum([free.shape[1], *(part.shape[1] for part in columns.values())])[:-1]
        base = _basis(few[:, : free.shape[1]])
        self._residuals = dict(zip(self.names, np.split(few - base @ (base.T @ few), ends, axis=1)[1:], strict=True))
        self._norms = dict(zip(self.names, np.split(np.linalg.norm(few, axis=0), ends)[1:], strict=True))
        self._spans: dict[str, np.ndarray] = {}
        for name, residual in self._residuals.items():
            span = _basis(residual[:, np.linalg.norm(residual, axis=0) > ALIAS * self._norms[name]])
            if span.shape[1]:
                self._spans[name] = span

    @property
    def detectable(self) -> frozenset[str]:
        """Faults that the free parameters cannot imitate."""
        return frozenset(self._spans)

    @property
    def undetectable(self) -> tuple[str, ...]:
        """Faults that the free parameters imitate."""
        return tuple(name for name in self.names if name not in self._spans)

    def detectable_share(self, name: str) -> float:
        """Return the largest share of a signature that the free parameters cannot imitate."""
        residual, norm = np.linalg.norm(self._residuals[name], axis=0), self._norms[name]
        return float((residual[norm > 0] / norm[norm > 0]).max(initial=0.0))

    def share(self, name: str, other: str) -> float:
        """Return the share of a fault that another leaves; both are detectable."""
        common = self._spans[other].T @ self._spans[name]
        beside = np.eye(common.shape[1]) - common.T @ common
        return float(np.sqrt(max(np.linalg.eigvalsh(beside)[-1], 0.0)))

    @cached_property
    def isolable_shares(self) -> dict[tuple[str, str], float]:
        """(fault, other) -> share of the fault that the other leaves; of all faults that are detectable."""
        return {(a, b): self.share(a, b) for a, b in itertools.permutations(self._spans, 2)}

    @cached_property
    def not_isolable_from(self) -> dict[str, frozenset[str]]:
        """Detectable fault -> others that explain all that it does."""
        others: dict[str, set[str]] = {name: set() for name in self._spans}
        for (a, b), share in self.isolable_shares.items():
            if share <= ALIAS:
                others[a].add(b)
        return {name: frozenset(some) for name, some in others.items()}

    def size(self, name: str, other: str | None = None) -> float | None:
        """Return the size from which a fault stands out by SIGMAS, of the free parameters or of another fault too.

        At the worst of some angles; None where the size is not one parameter, or nothing stands out.
        """
        if name not in self.sizes:
            return None
        part = self._residuals[name][:, : self.sizes[name].columns]
        if other is not None:
            span = self._spans[other]
            part = part - span @ (span.T @ part)
        least = float(np.linalg.norm(part, axis=0).min())
        return SIGMAS * RELATIVE_NOISE / least if least > ALIAS * self._norms[name].max() else None


def _basis(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal base of columns, each counted as long as any other."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 0] / size[size > 0]
    if not columns.size:
        return np.zeros((len(columns), 0))
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > ZERO_COLUMN * s[0]])


# -- signatures ------------------------------------------------------------------------------------------------------


def signatures_of(
    diagram: Diagram,
    faults: Sequence[Insertion],
    signals: Sequence[str],
    runs: Runs,
    *,
    progress: Callable[[float], None] | None = None,
) -> Signatures:
    """Return the signatures of faults in signals (flat names; "second ...": what no fault of a sensor touches).

    Free are the parameters that ``identify`` of the diagram names, and those that blocks declare with a tolerance.
    Raises RotorsimError for diagrams that are sampled, not linear, or do not follow the shaft.
    """
    folder = diagram.folder

    def opened(document: Mapping[str, Any]) -> Diagram:
        return load(document, folder=folder, trust_blocks=diagram.trusted)

    made: dict[str, tuple[np.ndarray, Size | None]] = {}
    skipped: dict[str, str] = {}
    with one_thread():  # many small matrices
        maker = _Maker(with_uncertain(diagram), opened, signals, runs)
        groups = _alike(faults)
        for k, items in enumerate(groups):
            try:
                made |= maker.columns(items)
            except RotorsimError as error:
                skipped |= dict.fromkeys((item.key for item in items), error.problems[0].what)
            if progress is not None:
                progress((k + 1) / len(groups))
    return Signatures(
        runs,
        tuple(signals),
        free=maker.free,
        columns={item.key: made[item.key][0] for item in faults if item.key in made},
        sizes={key: size for key, (_, size) in made.items() if size is not None},
        skipped=skipped,
        row_set=maker.labelled(runs.sets[:, None, None]),
        row_signal=maker.labelled(np.arange(len(signals))),
        parameters=tuple(item.name for item in maker.diagram.free),
    )


def _alike(faults: Sequence[Insertion]) -> list[list[Insertion]]:
    """Return faults in groups: forces of one declaration at several places, which at no size do not meet."""
    groups: dict[tuple[str, ...], list[Insertion]] = {}
    for item in faults:
        alike = (str(item.variant),) if item.fault.enters == "force" and item.fault.free else (item.key,)
        groups.setdefault((item.kind.type_name, item.physics, *alike), []).append(item)
    return list(groups.values())


def _renamed(item: Insertion, name: str) -> Insertion:
    """Return an insertion whose block has another name."""

    def end(text: str) -> str:
        return name + text[len(item.name) :] if text.startswith(f"{item.name}.") else text

    return replace(item, name=name, wires=tuple((end(a), end(b)) for a, b in item.wires))


class _Maker:
    """Makes the columns of faults beside those of the free parameters of one diagram."""

    def __init__(
        self,
        document: Mapping[str, Any],
        opened: Callable[[Mapping[str, Any]], Diagram],
        signals: Sequence[str],
        runs: Runs,
    ) -> None:
        self.document, self.opened, self.signals, self.runs = document, opened, list(signals), runs
        self.diagram, self.resolvents = opened(document), dict[bytes, np.ndarray]()
        motion = self._motion(self.diagram, self.diagram.free)
        theta = np.array([item.value for item in self.diagram.free])
        if not motion.is_periodic(theta):
            raise RotorsimError(Problem("the forcing does not follow the shaft", self.diagram.name))
        settled = motion.linear(theta)
        if settled is None:
            raise RotorsimError(Problem("the diagram is not linear in its states", self.diagram.name))
        self.Y, dY = settled
        rms = np.sqrt((np.abs(self.Y) ** 2).sum(axis=1).max(axis=0))
        self.scale = np.where(rms > 0, rms, 1.0)
        self.free = np.concatenate([self.rows(dY), self.rows(motion.open_means(theta))], axis=1)
        moving = 2 * np.sqrt((np.abs(self.Y[:, 1:]) ** 2).sum(axis=1))  # sqrt(2) times the rms about the mean
        largest = (np.abs(self.Y[:, 0]) + moving).max(axis=0)
        self.largest = {LINES: ANY_LINE} | {n: float(v) for n, v in zip(signals, largest, strict=True) if v > 0}

    def _motion(self, diagram: Diagram, free: Sequence[Free]) -> LinearMotion:
        return LinearMotion(diagram, self.signals, self.runs, free, self.resolvents)

    def rows(self, dY: np.ndarray) -> np.ndarray:
        """Return changes of the harmonics (R, K+1, c, m) as real columns (rows, m)."""
        flat = (dY / self.scale[:, None]).reshape(self.Y.size, dY.shape[-1])
        return np.concatenate([flat.real, flat.imag])

    def labelled(self, label: np.ndarray) -> np.ndarray:
        """Return a label of the harmonics, as it broadcasts to (R, K+1, c), for every row (rows,)."""
        return np.tile(np.broadcast_to(label, self.Y.shape).ravel(), 2)

    def columns(self, items: Sequence[Insertion]) -> dict[str, tuple[np.ndarray, Size | None]]:
        """Return the signatures of faults that are alike, (rows, m), and what their size is.

        Raises RotorsimError where they have none.
        """
        named = [_renamed(item, f"{item.name}_{k}") for k, item in enumerate(items)] if len(items) > 1 else items
        document, starts = self.document, []
        for item in named:
            sizes = sizes_at(item, self.largest)
            starts.append(starts_of(item, sizes))
            document = item.document(document, {**fixed_of(item, sizes), **starts[-1][0]})
        placed = self.opened(document)
        own = [[free for free in placed.free if free.name in item.free] for item in named]
        motion = self._motion(placed, [free for some in own for free in some])
        angles = np.array([f.unit == ANGLE_UNIT and f.low == -np.inf for some in own for f in some])
        trials: dict[bytes, np.ndarray] = {}  # the starts that differ in more than angles
        for trial in zip(*starts, strict=True):
            pairs = zip(own, trial, strict=True)
            theta = np.array([start[free.name.rpartition(".")[2]] for some, start in pairs for free in some])
            trials.setdefault(np.where(angles, 0.0, theta).tobytes(), theta)
        tried = list(trials.values())[:MOST_STARTS]
        if not motion.is_periodic(tried[0]):
            what = "no harmonics of the shaft: it shows as a line of its own or as sidebands"
            raise RotorsimError(Problem(what, self.diagram.name))
        at_nil = self._at_nil(motion, np.array(tried), own, angles)
        if at_nil is not None:
            return {item.key: part for item, part in zip(items, at_nil, strict=True)}
        if len(items) > 1:
            return {key: part for item in items for key, part in self.columns([item]).items()}
        changes = [change for theta in tried if (change := self._at(motion, theta)) is not None and change.size]
        if not changes:
            raise RotorsimError(Problem("at its starts it does nothing, or lets no motion settle", self.diagram.name))
        return {items[0].key: (np.concatenate(changes, axis=1), None)}

    def _at_nil(
        self, motion: LinearMotion, starts: np.ndarray, own: Sequence[Sequence[Free]], angles: np.ndarray
    ) -> list[tuple[np.ndarray, Size | None]] | None:
        """Return the sensitivities where the faults have no size, by the parameters that make it so; None if none do.

        starts (T, m): values of the parameters of all faults, one after another.
        """
        first, width = own[0], len(own[0])
        sizes = [j for j in range(width) if not angles[j] and first[j].low <= 0.0 <= first[j].high]
        turns = PROBE_ANGLES if angles.any() else (0.0,)
        for which in [[j] for j in sizes] + ([sizes] if len(sizes) > 1 else []):
            parts = width * np.arange(len(own))[:, None] + which  # of each fault
            every = parts.ravel()
            nils = starts.copy()
            nils[:, every] = 0.0
            settled = motion.linear(nils[0])
            if settled is None or not self._is_small(settled[0] - self.Y):
                continue
            motions = [motion.linear(np.where(angles, turn, nil)) for nil, turn in itertools.product(nils, turns)]
            dY = [settled[1] for settled in motions if settled is not None]
            if self._is_small(dY[0][..., every] * np.abs(starts).max(axis=0)[every]):
                continue  # it grows with the square of its size
            size = first[which[0]]
            one = Size(size.name.rpartition(".")[2], size.unit, len(turns)) if len(which) == 1 else None
            return [(self.rows(np.concatenate([some[..., part] for some in dY], axis=-1)), one) for part in parts]
        return None

    def _is_small(self, change: np.ndarray) -> bool:
        """Return whether a change (R, K+1, c, ...) is nothing beside the signals."""
        axes = tuple(k for k in range(change.ndim) if k != 2)
        return bool((np.abs(change).max(axis=axes, initial=0.0) <= NO_EFFECT * self.scale).all())

    def _at(self, motion: LinearMotion, theta: np.ndarray) -> np.ndarray | None:
        """Return what a fault and its parameters change at a start, less what is rounding; None if unsettled."""
        settled = motion.linear(theta) or motion.nonlinear(theta)
        if settled is None:
            return None
        Y, dY = settled
        every = np.concatenate([(Y - self.Y)[..., None], dY * np.where(theta, theta, 1.0)], axis=-1)
        return self.rows(every[..., [k for k in range(every.shape[-1]) if not self._is_small(every[..., k])]])
