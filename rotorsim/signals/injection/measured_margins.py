"""Stability margins of bearing loops as they were measured, after ISO 14839-3, with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from math import pi
from typing import Any

import numpy as np
from scipy.stats import t as student

from rotorsim._shown import Shown
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.loop import open_loop_of
from rotorsim.linear.margins import LARGEST_FREQUENCY, STANDARD, ZONES, Axis, zone_of
from rotorsim.recordings.injection import AFTER, BEFORE, TEST, InjectionRecording
from rotorsim.recordings.recording import Run
from rotorsim.signals.injection.local_polynomial import Response, Spectra, response
from rotorsim.signals.injection.steady_lines import SteadyLine, without_lines, without_shapes
from rotorsim.signals.shaft_angle import ShaftAngle, refuse_run_up, shaft_angle

GRID_RATIO = 1.002  # from one frequency to the next
POINTS_BETWEEN = 20  # frequencies between two of the grid, beside the largest peaks
PEAKS = 5
IDLE = 0.1  # of the rms of the largest test signal of a run: an axis with less is not injected at
DOUBTFUL = 0.3  # half width of the 90 % interval of |S|, of its value, from which on it is not measured
EXACT = 2e-3  # of |S|: a standard deviation below that is not believed, since windows bias it by as much
GAP = 0.02  # of a frequency, over which nothing was measured: a peak of amplification factor 50 would fit
LEAST_PERIODS = 12.0  # in a record: what drifts within it leaks into fewer
LINES_OF_PEAK = 30.0  # lines of the spectrum, the least half-power bandwidth of a peak that comes out right to 1 %
NARROW = 1.0  # Hz: a gap that is none
WELL_BELOW = 0.9  # of half of the sample rate: above, filters of converters are not alike
MOST_ORDERS_OUT = 20  # of the shaft, that are taken out by its angle
EVEN = 1e-3  # of a sample period
LEAST_RECORD = 1000
ONE_CONDITION = 0.01  # of a speed: runs closer are of one condition
SCALED = 0.1  # standard deviation of (V1 - V2) / E, of its size: above, E is no test signal there
OF_BEST = ("smooth", "freedom", "coherence", "scale")  # of several runs of an axis, those of the best at a frequency
CLEAR_OF_ZERO = (
    4.0  # standard deviations on both sides of a crossing: at some of thousands of frequencies noise makes three
)
BESIDE_A_GAP = 2.0  # |S| beside what was not measured, from which on a peak of zone B, 3, may be in it
AGREES = 0.05  # by which V1 - V2 may differ from the test signal before it is said


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
        low, high = (zone_of(end) for end in self.interval90["peak"])
        every = [zone for _, zone in ZONES] + ["D"]
        return " or ".join(every[every.index(low) : every.index(high) + 1])

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
    def statement(self) -> str:
        """Peak and zone in words."""
        axis = self.worst
        low, high = axis.interval90["peak"]
        size = f"{axis.best.peak:.3g} ({low:.3g} to {high:.3g}) at {axis.best.frequency:.4g} Hz"
        return f"peak sensitivity {size}, {axis.name}: zone {axis.zones} ({STANDARD})"

    @property
    def singular(self) -> np.ndarray:
        """Largest singular value of S (n,); NaN where not all of it was measured."""
        told = np.isfinite(self.matrix).all(axis=(1, 2))
        values = np.linalg.norm(np.where(told[:, None, None], self.matrix, 0), 2, axis=(1, 2))
        return np.where(told, values, np.nan)


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
    found: list[_OfRun] = []
    for run in chosen:
        try:
            found.append(_of_run(recording, run))
        except RotorsimError as error:
            problems += error.problems
    if problems:
        raise RotorsimError(*problems, exit_code=1)
    groups: list[list[_OfRun]] = []
    for one in found:
        own = next((group for group in groups if _alike(group[0], one)), None)
        groups.append([one]) if own is None else own.append(one)
    return tuple(_together(recording, group) for group in groups)


@dataclass(frozen=True, eq=False)
class _OfRun:
    """Spectra of a run, cleaned: inputs are the test signals of axes, outputs V1 of those measured, and their V2."""

    run: Run
    speed: float | None
    axes: tuple[str, ...]  # that are injected at
    outputs: Mapping[tuple[str, str], int]  # axis, AFTER or BEFORE -> column
    spectra: Spectra
    highest: float
    lines: tuple[SteadyLine, ...]


def _alike(one: _OfRun, other: _OfRun) -> bool:
    if one.run.settings != other.run.settings or (one.speed is None) != (other.speed is None):
        return False
    return one.speed is None or abs(one.speed - (other.speed or 0.0)) <= ONE_CONDITION * max(abs(one.speed), 1e-9)


def _of_run(recording: InjectionRecording, run: Run) -> _OfRun:
    """Return the spectra of a run without steady lines. Raises RotorsimError for one that tells nothing."""
    subject, time = f"run {run.id}", run.time
    n = len(time)
    if n < LEAST_RECORD:
        raise RotorsimError(Problem(f"{n} samples, {LEAST_RECORD} are needed", subject, run.place))
    period = float(time[-1] - time[0]) / (n - 1)
    if not period > 0 or np.abs(np.diff(time) / period - 1).max() > max(EVEN, 1e-9 * np.abs(time).max() / period):
        hint = "dropped samples? a constant rate is needed"
        raise RotorsimError(Problem("its samples are not evenly spaced", subject, run.place, hint))
    signals = _signals(recording, run)
    power = {name: float(np.std(own[TEST])) for name, own in signals.items()}
    axes = tuple(name for name, size in power.items() if size > 0 and size >= IDLE * max(power.values()))
    if not axes:
        hint = "the test signal is constant, or no axis has two channels in this run"
        raise RotorsimError(Problem("nothing is injected", subject, run.place, hint))
    outputs = {(name, AFTER): k for k, name in enumerate(signals)}
    outputs |= {(name, BEFORE): len(signals) + k for k, name in enumerate(axes)}
    columns = np.stack([signals[name][role] for name, role in outputs], axis=1)
    spectra = Spectra.of(np.stack([signals[name][TEST] for name in axes], axis=1), columns, 1 / period)
    angle = _angle(recording, run)
    speed = run.speed if run.speed is not None else None if angle is None else angle.speed
    judged = max(LARGEST_FREQUENCY, 3 * abs(speed or 0.0) / (2 * pi))
    highest = min(judged, WELL_BELOW / 2 / period)
    if angle is not None and angle.phase_known:
        turns = abs(angle.speed) / (2 * pi)
        orders = range(1, min(int(highest / turns), MOST_ORDERS_OUT) + 1) if turns > 0 else ()
        shapes = [np.fft.rfft(np.cos(k * angle.theta)) / np.sqrt(n) for k in orders]
        spectra = without_shapes(spectra, shapes)
    spectra, lines = without_lines(spectra, highest)
    return _OfRun(run, speed, axes, outputs, spectra, highest, tuple(lines))


def _signals(recording: InjectionRecording, run: Run) -> dict[str, dict[str, np.ndarray]]:
    """Return axis -> "test", "before", "after" -> samples (n,), the third as the difference of two."""
    found = {}
    for name, columns in recording.loops.items():
        own = {role: run.values[column] for role, column in columns.items() if column in run.values}
        if bad := [columns[role] for role, values in own.items() if not np.isfinite(values).all()]:
            raise RotorsimError(Problem("samples are missing or not finite", f"run {run.id}, {bad[0]}", run.place))
        if len(own) < 2:
            continue
        if TEST not in own:
            own[TEST] = own[AFTER] - own[BEFORE]
        elif BEFORE not in own:
            own[BEFORE] = own[AFTER] - own[TEST]
        elif AFTER not in own:
            own[AFTER] = own[BEFORE] + own[TEST]
        found[name] = own
    return found


def _angle(recording: InjectionRecording, run: Run) -> ShaftAngle | None:
    """Return the shaft angle of a run; None for one that says nothing of it. Raises RotorsimError for a run-up."""
    try:
        angle = shaft_angle(recording, run)
    except RotorsimError:
        return None
    if angle.phase_known:
        refuse_run_up(f"run {run.id}", run.place, run.time, angle.theta)
    return angle


def _together(recording: InjectionRecording, group: Sequence[_OfRun]) -> MeasuredMargins:
    """Return the margins of the axes that runs of one condition inject at."""
    names = tuple(name for name in recording.loops if any(name in one.axes for one in group))
    speed = next((one.speed for one in group if one.speed is not None), None)
    judged = max(LARGEST_FREQUENCY, 3 * abs(speed or 0.0) / (2 * pi))
    step, highest = min(one.spectra.step for one in group), max(one.highest for one in group)
    hz = _grid(LEAST_PERIODS * step, highest, step)
    columns = {name: _column(group, name, names, hz) for name in names}
    matrix = np.stack([columns[name].S for name in names], axis=2)
    axes = tuple(_axis(group, name, names, hz, columns[name]) for name in names)
    notes = [*_scales(columns, hz), *_unmeasured(axes, judged), *_narrow(axes, step), *_lines_said(group)]
    return MeasuredMargins(
        recording=recording.name,
        runs=tuple(one.run.id for one in group),
        speed=speed,
        settings=dict(group[0].run.settings),
        axes=axes,
        highest=judged,
        frequencies=hz,
        matrix=matrix,
        lines=tuple(line for one in group for line in one.lines),
        notes=tuple(notes),
        provenance={"recording": recording.name, "source": recording.source},
    )


def _grid(low: float, high: float, step: float) -> np.ndarray:
    """Return frequencies [Hz] by GRID_RATIO, but not nearer to each other than the lines of the spectrum."""
    hz = np.geomspace(low, high, max(int(np.log(high / low) / np.log(GRID_RATIO)), 2))
    coarse = hz * (GRID_RATIO - 1) < step
    return np.concatenate([np.arange(low, hz[coarse][-1], step) if coarse.any() else [], hz[~coarse]])


@dataclass(frozen=True, eq=False)
class _Column:
    """S (n, m) of all axes to the test signal of one, std (n, m), freedom, coherence (n,); scale: (V1 - V2) / E.

    smooth (n,): |S| of its own axis with less noise, see `Response`.
    """

    S: np.ndarray
    std: np.ndarray
    smooth: np.ndarray
    freedom: np.ndarray
    coherence: np.ndarray
    scale: np.ndarray


def _column(group: Sequence[_OfRun], name: str, names: Sequence[str], hz: np.ndarray) -> _Column:
    """Return the column of an axis, of several runs their mean, weighed by their variances."""
    every = [_column_of(one, name, names, hz) for one in group if name in one.axes]
    if len(every) == 1:
        return every[0]
    weights = np.stack([np.where(np.isfinite(one.S) & (one.std > 0), 1 / one.std**2, 0.0) for one in every])
    total = weights.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        S = sum(w * np.nan_to_num(one.S) for w, one in zip(weights, every, strict=True)) / total
        best = np.argmax(weights[:, :, names.index(name)], axis=0)
    at = np.arange(len(hz))
    of_best = {key: np.stack([getattr(one, key) for one in every])[best, at] for key in OF_BEST}
    return _Column(np.where(total > 0, S, np.nan), np.where(total > 0, total, np.nan) ** -0.5, **of_best)


def _column_of(one: _OfRun, name: str, names: Sequence[str], hz: np.ndarray) -> _Column:
    """Return the column of an axis from one run: S_i = R1_i / (R1_j - R2_j)."""
    found: Response = response(one.spectra, hz)
    j, v1, v2 = one.axes.index(name), one.outputs[name, AFTER], one.outputs[name, BEFORE]
    R, C = found.S[:, :, j], found.covariance[:, j]
    scale = R[:, v1] - R[:, v2]
    to_scale = np.zeros(R.shape[1])
    to_scale[v1], to_scale[v2] = 1, -1
    lines = np.minimum(np.round(hz / one.spectra.step).astype(int), len(one.spectra.U) - 1)
    with np.errstate(invalid="ignore"):
        of_scale = np.sqrt(np.maximum((to_scale @ C @ to_scale).real, 0.0))
        told = (hz <= one.highest) & one.spectra.excited()[lines, j] & (of_scale < SCALED * np.abs(scale))
    S, std = (np.full((len(hz), len(names)), np.nan, kind) for kind in (complex, float))
    for i, other in enumerate(names):
        k = one.outputs.get((other, AFTER))
        if k is None:
            continue
        with np.errstate(invalid="ignore", divide="ignore"):
            S[:, i] = R[:, k] / scale
            g = np.zeros(R.shape, complex)
            g[:, k] += 1
            g[:, v1] -= S[:, i]
            g[:, v2] += S[:, i]
            variance = np.einsum("na,nab,nb->n", g, C, g.conj()).real / np.abs(scale) ** 2
            wider = found.smooth[:, k, j] / (found.smooth[:, v1, j] - found.smooth[:, v2, j])
        doubt = np.where(found.alone, np.abs(wider - S[:, i]), 0.0)
        std[:, i] = np.hypot(np.maximum(np.sqrt(np.maximum(variance, 0.0)), EXACT * np.abs(S[:, i])), doubt)
        S[~told, i], std[~told, i] = np.nan, np.nan
    with np.errstate(invalid="ignore", divide="ignore"):
        wider = found.smooth[:, v1, j] / (found.smooth[:, v1, j] - found.smooth[:, v2, j])
    smooth = np.abs(np.where(found.alone, S[:, names.index(name)], wider))
    return _Column(S, std, smooth, found.freedom, found.coherence[:, v1, j], scale)


def _merged(hz: np.ndarray, column: _Column, more_hz: np.ndarray, more: _Column) -> tuple[np.ndarray, _Column]:
    """Return two parts of a column in the order of their frequencies."""
    order = np.argsort(both := np.concatenate([hz, more_hz]))
    parts = ((getattr(column, item.name), getattr(more, item.name)) for item in fields(_Column))
    return both[order], _Column(*(np.concatenate(pair)[order] for pair in parts))


def _half_width(column: _Column, i: int) -> np.ndarray:
    """Return the half width (n,) of the 90 % interval of |S_i|: half of the variance of S is along it."""
    with np.errstate(invalid="ignore"):
        return np.asarray(student.ppf(0.95, 2 * column.freedom) * column.std[:, i] / np.sqrt(2))


def _axis(group: Sequence[_OfRun], name: str, names: Sequence[str], hz: np.ndarray, column: _Column) -> MeasuredAxis:
    """Return an axis with its margins, more closely looked at beside its largest peaks."""
    i = names.index(name)
    top = _peaks(column, i)
    if top:
        between = [np.linspace(hz[k - 1], hz[k + 1], 2 * POINTS_BETWEEN + 1)[1:-1] for k in top if 0 < k < len(hz) - 1]
        more_hz = np.setdiff1d(np.concatenate([*between, []]), hz)
        hz, column = _merged(hz, column, more_hz, _column(group, name, names, more_hz))
        top = _peaks(column, i)
    if not top:
        runs = ", ".join(one.run.id for one in group)
        what = f"'{name}': nowhere is |S| told to {100 * DOUBTFUL:.0f} %"
        hint = "a larger test signal, a longer sweep, or are the channels those of this axis?"
        raise RotorsimError(Problem(what, f"run {runs}", group[0].run.place, hint), exit_code=1)
    S, half = column.S[:, i], _half_width(column, i)
    measured = _is_measured(column, i)
    k = top[0]
    interval = {"peak": (float(np.abs(S[k]) - half[k]), float((np.abs(S) + half)[top].max()))}
    best = Axis(name, float(np.abs(S[k])), float(hz[k]), zone_of(float(np.abs(S[k]))))
    best, more = _limits(best, hz, S, column, i, measured)
    top_of_band = max(one.highest for one in group)
    hidden = tuple(_hidden(hz, np.where(measured, np.abs(S), np.nan), best.peak, top_of_band))
    if hidden:
        interval["peak"] = (interval["peak"][0], np.inf)
    return MeasuredAxis(hz, S, column.std[:, i], half, column.coherence, measured, best, {**interval, **more}, hidden)


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


def _is_measured(column: _Column, i: int) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return np.asarray(_half_width(column, i) < DOUBTFUL * np.abs(column.S[:, i]))


def _peaks(column: _Column, i: int) -> list[int]:
    """Return where |S| is largest, and the next largest maxima: of the smooth estimate, lest noise be chosen."""
    size = np.where(_is_measured(column, i), column.smooth, 0.0)
    around = np.concatenate([[0.0], size, [0.0]])
    inner = np.flatnonzero((size > 0) & (size >= around[:-2]) & (size >= around[2:]))
    return list(inner[np.argsort(size[inner])[::-1][:PEAKS]].tolist())


def _limits(
    best: Axis, hz: np.ndarray, S: np.ndarray, column: _Column, i: int, measured: np.ndarray
) -> tuple[Axis, dict[str, tuple[float, float]]]:
    """Return gain, phase and delay margins where G_o, between frequencies measured, is -1 / gain or of size 1."""
    with np.errstate(invalid="ignore", divide="ignore"):
        G = np.asarray(open_loop_of(np.where(measured, S, np.nan)))
        std = column.std[:, i] / np.abs(S) ** 2 / np.sqrt(2)  # of G_o, along any direction
        quantile = student.ppf(0.95, 2 * column.freedom)
        relative = quantile * std / np.abs(G)
        size = np.log(np.abs(G))
    best = replace(best, gain_up=np.inf, gain_down=0.0)
    interval: dict[str, tuple[float, float]] = {}
    for f, value, half in _crossings(hz, G.imag, std, G, relative):
        gain = -1 / value.real
        ends = gain * (1 - half), gain * (1 + half)
        if 1 < gain < best.gain_up:
            best, interval["gain_up"] = replace(best, gain_up=gain, gain_up_frequency=f), ends
        elif best.gain_down < gain < 1:
            best, interval["gain_down"] = replace(best, gain_down=gain, gain_down_frequency=f), ends
    for f, value, half in _crossings(hz, size, std / np.abs(G), G, relative):
        lag, spread = float(np.degrees(np.angle(-value))), float(np.degrees(half))
        if not abs(lag) >= best.phase:  # which is nan before the first
            best = replace(best, phase=abs(lag), phase_frequency=f)
            interval["phase"] = abs(lag) - spread, abs(lag) + spread
        delay = lag % 360 / 360 / f
        if not delay >= best.delay:
            best = replace(best, delay=delay, delay_frequency=f)
            interval["delay"] = delay - spread / 360 / f, delay + spread / 360 / f
    return best, interval


def _crossings(
    hz: np.ndarray, values: np.ndarray, std: np.ndarray, G: np.ndarray, relative: np.ndarray
) -> Iterator[tuple[float, complex, float]]:
    """Yield frequency [Hz], G_o and its relative half width where values pass zero, clear of it on both sides."""
    with np.errstate(invalid="ignore"):
        clear = np.flatnonzero(np.abs(values) > CLEAR_OF_ZERO * std)
    for a, b in pairwise(clear.tolist()):
        between = values[a : b + 1]
        if values[a] * values[b] > 0 or not np.isfinite(between).all():
            continue
        changes = a + np.flatnonzero(between[:-1] * between[1:] <= 0)
        k = int(changes[len(changes) // 2])
        part = float(values[k] / (values[k] - values[k + 1]))
        yield float(hz[k] + part * (hz[k + 1] - hz[k])), complex(G[k] + part * (G[k + 1] - G[k])), float(relative[k])


def _scales(columns: Mapping[str, _Column], hz: np.ndarray) -> list[str]:
    """Return where V1 - V2 is not the test signal. Raises RotorsimError where it is its opposite."""
    said = []
    for name, column in columns.items():
        told = np.isfinite(column.scale) & np.isfinite(column.S).any(axis=1)
        scale = complex(np.median(column.scale[told].real), np.median(column.scale[told].imag)) if told.any() else 1.0
        shown = f"'after' - 'before' at {name} is {scale.real:.3g} times the test signal"
        if scale.real < 0:
            hint = "'before' is without the test signal, 'after' is the sum; if its sign differs, leave 'test' out"
            raise RotorsimError(Problem(shown, hint=hint), exit_code=1)
        if abs(scale - 1) > AGREES:
            said.append(f"{shown}: S is from 'before' and 'after' alone")
    return said


def _unmeasured(axes: Sequence[MeasuredAxis], judged: float) -> list[str]:
    """Return the frequencies at which an axis was not measured, within its band and up to what the standard judges."""
    said = []
    for axis in axes:
        high, hz = axis.band[1], axis.frequencies[axis.measured].tolist()
        gaps = [(a, b) for a, b in pairwise(hz) if b > a * (1 + GAP) and b - a > NARROW]
        if high < judged * (1 - GAP):
            gaps.append((high, judged))
        for a, b in axis.hidden:
            said.append(f"'{axis.name}': the peak may lie between {a:.5g} and {b:.5g} Hz, where |S| could not be told")
        if gaps:
            words = ", ".join(f"{a:.4g} to {b:.4g} Hz" for a, b in gaps)
            said.append(f"'{axis.name}': not measured, and not judged: {words}")
    return said


def _narrow(axes: Sequence[MeasuredAxis], step: float) -> list[str]:
    """Return the peaks that are too narrow for a record."""
    said = []
    for axis in axes:
        size = np.where(axis.measured, np.abs(axis.sensitivity), np.nan)
        beside = axis.frequencies[size < axis.best.peak / np.sqrt(2)]
        f = axis.best.frequency
        width = min(beside[beside > f], default=np.inf) - max(beside[beside < f], default=-np.inf)
        if width < LINES_OF_PEAK * step:
            what = f"'{axis.name}': the peak at {f:.5g} Hz is {width:.2g} Hz wide, and higher than it was measured"
            said.append(f"{what}: that takes {LINES_OF_PEAK / width:.3g} s")
    return said


def _lines_said(group: Sequence[_OfRun]) -> list[str]:
    """Return the steady lines that were taken out, the largest of each run."""
    said = []
    for one in group:
        if one.lines:
            words = ", ".join(f"{line.frequency:.5g}" for line in one.lines[:PEAKS])
            more = f" and {len(one.lines) - PEAKS} more" if len(one.lines) > PEAKS else ""
            said.append(f"{one.run.id}: steady lines that the test signal does not make, taken out: {words}{more} Hz")
    return said
