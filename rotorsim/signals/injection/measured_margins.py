"""Stability margins of bearing loops as they were measured, after ISO 14839-3, with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from rotorsim._shown import Shown
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.control.margins import STANDARD, ZONES, Axis, zone_of
from rotorsim.linear.loop import open_loop_of
from rotorsim.recordings.injection import InjectionRecording
from rotorsim.signals.injection.columns import DOUBTFUL, Column, column, merged
from rotorsim.signals.injection.consistency import apart, exchanged, scaled
from rotorsim.signals.injection.limits import with_limits
from rotorsim.signals.injection.run_spectra import RunSpectra, judged_up_to, run_spectra
from rotorsim.signals.injection.steady_lines import SteadyLine

GRID_RATIO = 1.002  # from one frequency to the next
POINTS_BETWEEN = 20  # frequencies between two of the grid, beside the largest peaks
PEAKS = 8
GAP = 0.02  # of a frequency, over which nothing was measured: a peak of amplification factor 50 would fit
LINES_OF_PEAK = 30.0  # lines of the spectrum, the least half-power bandwidth of a peak that comes out right to 1 %
LEAST_PERIODS = 12.0  # in a record: what drifts within it leaks into fewer
NARROW = 1.0  # Hz: a gap that is none
ONE_CONDITION = 0.01  # of a speed: runs closer are of one condition
BESIDE_A_GAP = 1.5  # |S| beside what was not measured, from which on a peak of zone B, 3, may be in it
SHOWN_LINES = 5
NEARLY_LARGEST = 0.7  # of the largest peak: one that may be larger


@dataclass(frozen=True, repr=False)
class MeasuredAxis:
    """One axis, the loops of the others closed, as it was measured.

    frequencies (n,) [Hz]; sensitivity (n,): S, V1 = S E; std (n,): of S, complex; coherence (n,): of V1 with E.
    measured (n,): where the 90 % interval of |S| is narrower than +-30 %. best: numbers of the estimate,
    see `Axis`; its gains are 0 and inf where no limit lies within what was measured. interval90: of these. hidden:
    frequencies [Hz] that were not measured and may hold the peak; its interval is open then.
    """

    frequencies: np.ndarray
    sensitivity: np.ndarray
    std: np.ndarray
    half_width: np.ndarray
    coherence: np.ndarray
    measured: np.ndarray
    best: Axis
    interval90: Mapping[str, tuple[float, float]]
    hidden: tuple[tuple[float, float], ...] = ()

    @property
    def name(self) -> str:
        """Entry of the port at which it was injected."""
        return self.best.name

    @property
    def zones(self) -> str:
        """The zones within the interval of the peak: "B", "B or C"."""
        return _zones(*self.interval90["peak"])

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency [Hz] at which it was measured."""
        there = self.frequencies[self.measured]
        return float(there[0]), float(there[-1])

    def open_loop(self) -> np.ndarray:
        """Return G_o = 1 / S - 1 (n,), NaN where S does not tell it to 30 %, as where S is nearly 1."""
        with np.errstate(invalid="ignore", divide="ignore"):
            G = open_loop_of(self.sensitivity)
            told = self.measured & (self.half_width / np.abs(self.sensitivity) ** 2 < DOUBTFUL * np.abs(G))
        return np.where(told, G, np.nan)


@dataclass(frozen=True, repr=False)
class MeasuredMargins(Shown):
    """Margins of all axes that were injected at under one condition: a speed [rad/s] (None: unknown) and settings.

    highest: frequency [Hz] up to which the standard judges. frequencies (n,) [Hz], matrix (n, m, m): S of all axes
    together, NaN where an axis was not injected at. lines: steady motion that was taken out.
    """

    recording: str
    runs: tuple[str, ...]
    speed: float | None
    settings: Mapping[str, Any]
    axes: tuple[MeasuredAxis, ...]
    highest: float
    frequencies: np.ndarray
    matrix: np.ndarray
    lines: tuple[SteadyLine, ...]
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.margins:measured_margins_figure"

    def __repr__(self) -> str:
        return f"MeasuredMargins({self.statement})"

    @property
    def worst(self) -> MeasuredAxis:
        """The axis with the largest peak."""
        return max(self.axes, key=lambda axis: axis.best.peak)

    @property
    def zones(self) -> str:
        """The zones that the machine may be in: that of its worst axis, whichever it is within all intervals."""
        ends = np.array([axis.interval90["peak"] for axis in self.axes])
        return _zones(*ends.max(axis=0).tolist())

    @property
    def statement(self) -> str:
        """Peak and zone in words."""
        axis = self.worst
        low, high = axis.interval90["peak"]
        size = f"{axis.best.peak:.3g} ({low:.3g} to {high:.3g}) at {axis.best.frequency:.4g} Hz"
        return f"peak sensitivity {size}, {axis.name}: zone {self.zones} ({STANDARD})"

    @property
    def singular(self) -> np.ndarray:
        """Largest singular value of S (n,); NaN where not all of it was measured."""
        told = np.isfinite(self.matrix).all(axis=(1, 2))
        values = np.linalg.norm(np.where(told[:, None, None], self.matrix, 0), 2, axis=(1, 2))
        return np.where(told, values, np.nan)


def _zones(low: float, high: float) -> str:
    """Return the zones of peaks between two."""
    every = [zone for _, zone in ZONES] + ["D"]
    return " or ".join(every[every.index(zone_of(low)) : every.index(zone_of(high)) + 1])


def measured_margins(recording: InjectionRecording, runs: Sequence[str] = ()) -> tuple[MeasuredMargins, ...]:
    """Return the margins of bearing loops from runs with an injected test signal, a result for each condition.

    V1 and V2 are estimated from the test signal E, which noise and unbalance do not drive: V1 = R1 E, V2 = R2 E, and
    S = R1 / (R1 - R2), in which scale and delay of the recorded E cancel. Any excitation will do: a sweep, stepped
    sines, noise, several axes at once or one a run. Orders of the shaft, hum and other steady lines are taken out
    first. The 90 % intervals are from what local polynomials leave; that of the peak holds all frequencies that may be
    higher.

    Raises RotorsimError for runs that are too short, uneven, speed up, or inject nothing.
    Source: ISO 14839-3:2006; R. Pintelon and J. Schoukens, System Identification (2nd ed., 2012), sec. 2.7 and 7.2.
    """
    chosen = [run for run in recording.runs if not runs or run.id in runs]
    problems: list[Problem] = []
    found: list[RunSpectra] = []
    for run in chosen:
        try:
            found.append(run_spectra(recording, run))
        except RotorsimError as error:
            problems += error.problems
    if problems:
        raise RotorsimError(*problems, exit_code=1)
    groups: list[list[RunSpectra]] = []
    for one in found:
        own = next((group for group in groups if _alike(group[0], one)), None)
        groups.append([one]) if own is None else own.append(one)
    return tuple(_together(recording, group) for group in groups)


def _alike(one: RunSpectra, other: RunSpectra) -> bool:
    if one.run.settings != other.run.settings or (one.speed is None) != (other.speed is None):
        return False
    return one.speed is None or abs(one.speed - (other.speed or 0.0)) <= ONE_CONDITION * max(abs(one.speed), 1e-9)


def _together(recording: InjectionRecording, group: Sequence[RunSpectra]) -> MeasuredMargins:
    """Return the margins of the axes that runs of one condition inject at."""
    names = tuple(name for name in recording.loops if any(name in one.axes for one in group))
    speed = next((one.speed for one in group if one.speed is not None), None)
    judged = judged_up_to(speed)
    step, highest = min(one.spectra.step for one in group), max(one.highest for one in group)
    hz = _grid(LEAST_PERIODS * step, highest, step)
    axes, notes, matrix = [], [], np.full((len(hz), len(names), len(names)), np.nan, complex)
    for j, name in enumerate(names):
        own = column(group, name, names, hz)
        matrix[:, :, j] = np.where(own.measured(j)[:, None], own.S, np.nan)
        axis, said = _axis(group, name, names, hz, own)
        axes.append(axis)
        notes += [*said, *_unmeasured(axis, judged), *_narrow(axis, step)]
    return MeasuredMargins(
        recording=recording.name,
        runs=tuple(one.run.id for one in group),
        speed=speed,
        settings=dict(group[0].run.settings),
        axes=tuple(axes),
        highest=judged,
        frequencies=hz,
        matrix=matrix,
        lines=tuple(line for one in group for line in one.lines),
        notes=(*notes, *_lines_said(group)),
        provenance={"recording": recording.name, "source": recording.source},
    )


def _grid(low: float, high: float, step: float) -> np.ndarray:
    """Return frequencies [Hz] by GRID_RATIO, but not nearer to each other than the lines of the spectrum."""
    hz = np.geomspace(low, high, max(int(np.log(high / low) / np.log(GRID_RATIO)), 2))
    coarse = hz * (GRID_RATIO - 1) < step
    return np.concatenate([np.arange(low, hz[coarse][-1], step) if coarse.any() else [], hz[~coarse]])


def _axis(
    group: Sequence[RunSpectra], name: str, names: Sequence[str], hz: np.ndarray, own: Column
) -> tuple[MeasuredAxis, list[str]]:
    """Return an axis with its margins, looked at more closely beside its largest peaks, and what is to be said."""
    i, highest = names.index(name), max(one.highest for one in group)
    if top := _peaks(own, i):
        between = [np.linspace(hz[k - 1], hz[k + 1], 2 * POINTS_BETWEEN + 1)[1:-1] for k in top if 0 < k < len(hz) - 1]
        more_hz = np.setdiff1d(np.concatenate([*between, []]), hz)
        hz, own = merged(hz, own, more_hz, column(group, name, names, more_hz))
    said, doubt = scaled(name, own, hz)
    own = replace(own, std=np.hypot(own.std, doubt[:, None] * np.abs(own.S)))
    if not (top := _peaks(own, i)):
        runs = ", ".join(one.run.id for one in group)
        what = f"'{name}': nowhere is |S| told to {100 * DOUBTFUL:.0f} %"
        hint = "a larger test signal, a longer sweep, or are the channels those of this axis?"
        raise RotorsimError(Problem(what, f"run {runs}", group[0].run.place, hint), exit_code=1)
    swapped = exchanged(name, own, i, hz, judged_up_to(group[0].speed))
    said += [*swapped, *apart(name, own, hz)]
    S, half, measured, k = own.S[:, i], own.half_width(i), own.measured(i), top[0]
    interval = {"peak": (float(np.abs(S[k]) - half[k]), float((np.abs(S) + half)[top].max()))}
    best = Axis(name, float(np.abs(S[k])), float(hz[k]), zone_of(float(np.abs(S[k]))))
    best, more = with_limits(best, hz, S, own, i, measured)
    hidden = tuple(_hidden(hz, np.where(measured, np.abs(S), np.nan), best.peak, highest))
    if hidden or swapped:
        interval["peak"] = (0.0 if swapped else interval["peak"][0], np.inf)
    intervals = {**interval, **more}
    return MeasuredAxis(hz, S, own.std[:, i], half, own.coherence, measured, best, intervals, hidden), said


def _hidden(hz: np.ndarray, size: np.ndarray, peak: float, highest: float) -> Iterator[tuple[float, float]]:
    """Yield frequencies [Hz] that were not measured, beside which |S| is so large that its peak may be there."""
    limit = max(peak / np.sqrt(2), BESIDE_A_GAP)
    there = np.flatnonzero(np.isfinite(size))
    for a, b in pairwise(there.tolist()):
        if b > a + 1 and max(size[a], size[b]) > limit:
            yield float(hz[a]), float(hz[b])
    if size[there[0]] > limit:
        yield 0.0, float(hz[there[0]])
    if size[there[-1]] > limit and hz[there[-1]] < highest * (1 - GAP):
        yield float(hz[there[-1]]), highest


def _peaks(own: Column, i: int) -> list[int]:
    """Return where |S| is largest, and the next largest maxima: of the smooth estimate, lest noise be chosen."""
    size = np.where(own.measured(i), own.smooth, 0.0)
    around = np.concatenate([[0.0], size, [0.0]])
    inner = np.flatnonzero((size > 0) & (size >= around[:-2]) & (size >= around[2:]))
    return list(inner[np.argsort(size[inner])[::-1][:PEAKS]].tolist())


def _unmeasured(axis: MeasuredAxis, judged: float) -> list[str]:
    """Return the frequencies at which an axis was not measured, within its band and up to what the standard judges."""
    high, hz = axis.band[1], axis.frequencies[axis.measured].tolist()
    gaps = [(a, b) for a, b in pairwise(hz) if b > a * (1 + GAP) and b - a > NARROW]
    if high < judged * (1 - GAP):
        gaps.append((high, judged))
    where = "where |S| could not be told"
    said = [f"'{axis.name}': the peak may lie between {a:.5g} and {b:.5g} Hz, {where}" for a, b in axis.hidden]
    if gaps:
        words = ", ".join(f"{a:.4g} to {b:.4g} Hz" for a, b in gaps)
        said.append(f"'{axis.name}': not measured, and not judged: {words}")
    return said


def _narrow(axis: MeasuredAxis, step: float) -> list[str]:
    """Return that a peak, the largest or nearly, is too narrow for the record."""
    size = np.where(axis.measured, np.abs(axis.sensitivity), 0.0)
    inner = np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:])) + 1
    narrowest = np.inf, np.nan
    for k in inner[size[inner] > NEARLY_LARGEST * axis.best.peak]:
        beside, f = axis.frequencies[(size > 0) & (size < size[k] / np.sqrt(2))], axis.frequencies[k]
        width = min(beside[beside > f], default=np.inf) - max(beside[beside < f], default=-np.inf)
        narrowest = min(narrowest, (float(width), float(f)))
    width, f = narrowest
    if width >= LINES_OF_PEAK * step:
        return []
    what = f"'{axis.name}': the peak at {f:.5g} Hz is {width:.2g} Hz wide, and higher than it was measured"
    return [f"{what}: that takes {LINES_OF_PEAK / width:.3g} s"]


def _lines_said(group: Sequence[RunSpectra]) -> list[str]:
    """Return the steady lines that were taken out, the largest of each run."""
    said = []
    for one in group:
        if one.lines:
            words = ", ".join(f"{line.frequency:.5g}" for line in one.lines[:SHOWN_LINES])
            more = f" and {len(one.lines) - SHOWN_LINES} more" if len(one.lines) > SHOWN_LINES else ""
            said.append(f"{one.run.id}: steady lines that the test signal does not make, taken out: {words}{more} Hz")
    return said
