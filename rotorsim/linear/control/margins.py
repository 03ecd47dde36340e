"""Stability margins of magnetic-bearing loops after ISO 14839-3: sensitivity, open and closed loop, gain and phase."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from rotorsim._shown import Shown
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.eigen import unfolded
from rotorsim.linear.linearisation import provenance, speed_of
from rotorsim.linear.loop import Loop, growing_poles, injections, open_loop_of, sensor_ports
from rotorsim.linear.sampled_data import SampledData
from rotorsim.linear.state_space import frequencies_near
from rotorsim.model.compiled import Model

STANDARD = "ISO 14839-3:2006"
ZONES = ((3.0, "A"), (4.0, "B"), (5.0, "C"))  # ISO 14839-3:2006, table 1: 9.5 dB, 12 dB, 14 dB
LARGEST_FREQUENCY = 2000.0  # Hz; ISO 14839-3 looks up to three times the rated speed or 2 kHz, the larger
LOWEST_FREQUENCY = 0.01  # Hz
LARGEST_GAIN = 1e4  # factor of the loop gain up to which a limit of stability is looked for, and down to its inverse
NEAR_LIMIT = (1e-3, 1e-10)  # a limit of the gain is found to, first where G_o says it exactly, then by itself
GAIN_STEP = 1.1  # from one factor tried to the next; 0.8 dB
WELL_ABOVE = 10.0  # times the largest pole, where every loop has fallen


@dataclass(frozen=True)
class Axis:
    """Margins of one axis, the loops of the others closed.

    peak of |S_jj|, at frequency [Hz], zone. gain_up, gain_down: factors of the loop gain, above and below 1, that bring
    the loop to the limit of stability (inf, 0: none within 10^4); phase [deg] and delay [s]: the least change of phase,
    and the least lag as a delay, that do so (nan where |G_o| is nowhere 1); with the frequencies [Hz] of the motion at
    that limit. All numbers are nan for a loop that is not stable.
    """

    name: str
    peak: float
    frequency: float
    zone: str
    gain_up: float = np.nan
    gain_up_frequency: float = np.nan
    gain_down: float = np.nan
    gain_down_frequency: float = np.nan
    phase: float = np.nan
    phase_frequency: float = np.nan
    delay: float = np.nan
    delay_frequency: float = np.nan


@dataclass(frozen=True, repr=False)
class Margins(Shown):
    """Sensitivity and margins of all bearing axes of a diagram.

    frequencies (n,) [Hz]; sensitivity (n, m, m): S, V1 = S E where E is added to a signal V2 and V1 is what goes on.
    singular (n,): largest singular value of S, nan where axes have several units; singular_peak: the largest of all.
    stable: of the closed loop; one that is not has no margins and is zone "D". sampled: it has sampled blocks.
    """

    frequencies: np.ndarray
    sensitivity: np.ndarray
    axes: tuple[Axis, ...]
    singular: np.ndarray
    singular_peak: float
    singular_peak_frequency: float
    stable: bool
    sampled: bool
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.margins:margins_figure"

    def __repr__(self) -> str:
        return f"Margins({self.statement})"

    @property
    def worst(self) -> Axis:
        """The axis with the largest peak, which the standard judges; the first of those that are alike to rounding."""
        if not self.stable:
            return self.axes[0]
        largest = max(axis.peak for axis in self.axes)
        return next(axis for axis in self.axes if axis.peak >= largest * (1 - 1e-9))

    @property
    def peak(self) -> float:
        """Largest |S_jj| of all axes."""
        return self.worst.peak

    @property
    def zone(self) -> str:
        """Zone of the worst axis: "A", "B", "C" or "D"."""
        return self.worst.zone

    @property
    def statement(self) -> str:
        """Peak and zone in words."""
        if not self.stable:
            return f"the closed loop is unstable: a sensitivity cannot be measured, zone D ({STANDARD})"
        axis = self.worst
        size = f"{axis.peak:.3g} ({20 * np.log10(max(axis.peak, 1e-300)):.1f} dB) at {axis.frequency:.4g} Hz"
        return f"peak sensitivity {size}, {axis.name}: zone {axis.zone} ({STANDARD})"

    def open_loop(self) -> np.ndarray:
        """Return G_o = 1 / S_jj - 1 of every axis, the other loops closed, shape (n, m): V2 = -G_o V1."""
        return np.asarray(open_loop_of(np.diagonal(self.sensitivity, axis1=1, axis2=2)))

    def open_loop_matrix(self) -> np.ndarray:
        """Return G_o = S^-1 - I, shape (n, m, m)."""
        return np.asarray(np.linalg.inv(self.sensitivity) - np.eye(self.sensitivity.shape[1]))

    def closed_loop(self) -> np.ndarray:
        """Return G_c = I - S, shape (n, m, m): V2 = -G_c E."""
        return np.asarray(np.eye(self.sensitivity.shape[1]) - self.sensitivity)


def zone_of(peak: float) -> str:
    """Return the zone of a peak sensitivity: A below 3 (9.5 dB), B below 4 (12 dB), C below 5 (14 dB), else D.

    Source: ISO 14839-3:2006, Evaluation of stability margin, table 1.
    """
    return next((zone for limit, zone in ZONES if peak < limit), "D")


def margins(
    diagram: Diagram | Model,
    ports: Sequence[str] | str = (),
    *,
    parameters: Mapping[str, Any] | None = None,
    frequencies: Sequence[float] | np.ndarray | None = None,
    at: np.ndarray | None = None,
    limits: bool = True,
) -> Margins:
    """Return sensitivity, open and closed loop and margins of every bearing axis, after ISO 14839-3.

    A signal E is added to V2, V1 = V2 + E goes on: S = V1/E, G_o = -V2/V1 = 1/S - 1, G_c = -V2/E = 1 - S. Each axis is
    judged by |S_jj| with the other axes closed, as measured on a machine, from 0.01 Hz to the larger of 2 kHz and three
    times the speed, as the standard asks. ports: inputs (``controller.displacement``, default: of every controller), or
    outputs (``controller.current``). With the displacement of a controller its wired velocity is disturbed by dE/dt, as
    of a rate that is made of the sensor's signal. frequencies [Hz]: those of the curves; default: a grid that misses no
    peak. at: operating point, see `linearise`. limits: False leaves gain, phase and delay margins out. A loop with
    sampled blocks has its exact response at the frequency injected.

    Raises RotorsimError for ports that do not exist or that no loop passes through, and as `linearise`.
    Source: ISO 14839-3:2006, Evaluation of stability margin.
    """
    drawn = diagram.diagram if isinstance(diagram, Model) else diagram
    named = [ports] if isinstance(ports, str) else list(dict.fromkeys(ports))
    loop = Loop(diagram, injections(drawn, named or sensor_ports(drawn)), parameters, at)
    speed = speed_of(loop.model, loop.model.parameter_vector(parameters)) or 0.0
    top = max(LARGEST_FREQUENCY, 3 * abs(speed) / (2 * np.pi))
    hz, S = _judged(loop, top, limits)
    diagonal = np.diagonal(S, axis1=1, axis2=2)
    if dead := np.flatnonzero(np.abs(diagonal - 1).max(axis=0) < 1e-12).tolist():
        live = [axis.name for k, axis in enumerate(loop.axes) if k not in dead]
        if live and not named:
            found = margins(diagram, live, parameters=parameters, frequencies=frequencies, at=at, limits=limits)
            left = [f"'{loop.axes[k].name}': no loop passes there, it is left out" for k in dead]
            return replace(found, notes=(*left, *found.notes))
        hint = "name a port of the loop: the sensor's signal of a controller, or its output"
        raise RotorsimError(*(Problem("no loop passes through this port", loop.axes[k].name, hint=hint) for k in dead))
    axes = tuple(_axis(loop, k, hz, diagonal[:, k], top, limits) for k in range(len(loop.axes)))
    within = hz <= top
    singular_peak = np.nan, np.nan
    if loop.one_unit and loop.is_stable():
        singular_peak = _peak(hz[within], _largest(S[within]), lambda f: float(_largest(loop.sensitivity(f))[0]))
    shown, values = (hz[within], S[within]) if frequencies is None else _curves(loop, frequencies)
    return Margins(
        frequencies=shown,
        sensitivity=values,
        axes=axes,
        singular=_largest(values) if loop.one_unit else np.full(len(shown), np.nan),
        singular_peak=singular_peak[1],
        singular_peak_frequency=singular_peak[0],
        stable=loop.is_stable(),
        sampled=loop.is_sampled,
        notes=(*loop.notes(top), *_beyond(axes, hz, diagonal, top)),
        provenance=provenance(loop.model, parameters, "margins"),
    )


def _beyond(axes: Sequence[Axis], hz: np.ndarray, S: np.ndarray, top: float) -> list[str]:
    """Return the axes whose |S| is in a worse zone above the frequencies that the standard judges."""
    said = []
    for axis, values in zip(axes, np.abs(S[hz > top]).T, strict=True):
        if len(values) and np.isfinite(axis.peak) and zone_of(float(values.max())) > axis.zone:
            where = hz[hz > top][int(np.argmax(values))]
            beyond = f"above the {top:.4g} Hz that ISO 14839-3 judges"
            said.append(f"'{axis.name}': |S| is {values.max():.3g} at {where:.4g} Hz, {beyond}")
    return said


def _curves(loop: Loop, frequencies: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    hz = np.atleast_1d(np.asarray(frequencies, float)).ravel()
    if not (len(hz) and np.isfinite(hz).all() and (hz > 0).all()):
        raise RotorsimError(Problem(what="frequencies must be positive and finite [Hz]", subject="frequencies"))
    return hz, loop.sensitivity(hz)


def _judged(loop: Loop, top: float, limits: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies [Hz] that miss no peak and no crossing, logarithmic and clustered at every pole, and S there.

    They reach beyond what the standard judges: a loop may have its margins there.
    """
    if not limits:  # peaks up to the frequencies judged stand at poles of the closed loop
        hz = np.union1d(frequencies_near(loop.closed_poles(), LOWEST_FREQUENCY, top), top)
        return hz, loop.sensitivity(hz)
    poles = loop.poles()
    highest = max(top, WELL_ABOVE * float(np.abs(poles).max(initial=0.0)) / (2 * np.pi))
    if loop.is_sampled:  # above half of the fastest rate the response at one frequency tells no margin
        highest = max(top, loop.fastest_rate / 2)
    hz = np.union1d(frequencies_near(poles, LOWEST_FREQUENCY, highest), top)
    return hz, loop.sensitivity(hz)


def _axis(loop: Loop, k: int, hz: np.ndarray, S: np.ndarray, top: float, limits: bool) -> Axis:
    """Return peak and margins of one axis from S_kk on a grid, and in between."""
    if not loop.is_stable():
        return Axis(loop.axes[k].name, np.nan, np.nan, "D")
    within = hz <= top
    frequency, peak = _peak(hz[within], np.abs(S[within]), lambda f: float(abs(loop.sensitivity(f)[0, k, k])))
    if not limits:
        return Axis(loop.axes[k].name, peak, frequency, zone_of(peak))
    open_loop = open_loop_of(S)

    def excess(f: float) -> float:
        return float(np.log(abs(open_loop_of(loop.sensitivity(f)[0, k, k]))))

    with np.errstate(divide="ignore"):
        unity = _roots(hz, np.log(np.abs(open_loop)), excess)
    lags = [(float(np.degrees(np.angle(-open_loop_of(loop.sensitivity(f)[0, k, k])))), f) for f in unity]
    phase = min(((abs(lag), f) for lag, f in lags), default=(np.nan, np.nan))
    delay = min(((lag % 360 / 360 / f, f) for lag, f in lags), default=(np.nan, np.nan))
    up, down = _gain_limit(loop, k, GAIN_STEP), _gain_limit(loop, k, 1 / GAIN_STEP)
    return Axis(loop.axes[k].name, peak, frequency, zone_of(peak), *up, *down, *phase, *delay)


def _gain_limit(loop: Loop, k: int, step: float) -> tuple[float, float]:
    """Return the gain nearest to 1 beyond which the loop is unstable, and the frequency [Hz] of what grows there.

    From eigenvalues of the closed loop with this gain, which also hold where sampling makes images of the signal.
    """
    inside = 1.0
    for gain in step ** np.arange(1, int(np.log(LARGEST_GAIN) / abs(np.log(step))) + 1):
        if not loop.is_stable(float(gain), k):
            outside = float(gain)
            for near in NEAR_LIMIT:
                while abs(outside / inside - 1) > near:
                    middle = float(np.sqrt(inside * outside))
                    inside, outside = (middle, outside) if loop.is_stable(middle, k) else (inside, middle)
                frequency = _growing_frequency(loop, outside, k)
                if (exact := _exact_limit(loop, k, outside, frequency)) is not None:
                    return exact
            return outside, frequency
        inside = float(gain)
    return (np.inf if step > 1 else 0.0), np.nan


def _growing_frequency(loop: Loop, gain: float, k: int) -> float:
    """Return the frequency [Hz] of what grows; with samples at the image that shows most in the signals of the loop."""
    system = loop.amplified(gain, k)
    pole = complex(growing_poles(system)[0])
    return unfolded(system, pole)[0] if isinstance(system, SampledData) else float(abs(pole.imag) / (2 * np.pi))


def _exact_limit(loop: Loop, k: int, gain: float, frequency: float) -> tuple[float, float] | None:
    """Return a limit of the gain, and its frequency, at which G_o is real: G_o = -1 / gain; None where that is none.

    Growth is told from rounding only a little beyond the limit. Not where samples make images, or nothing oscillates.
    """
    if loop.is_sampled or frequency == 0.0:
        return None

    def open_loop(f: float) -> complex:
        return complex(open_loop_of(loop.sensitivity(f)[0, k, k]))

    ends = frequency / 1.1, frequency * 1.1
    if open_loop(ends[0]).imag * open_loop(ends[1]).imag >= 0:
        return None
    exact = float(brentq(lambda f: open_loop(f).imag, *ends, rtol=1e-14))
    refined = -1 / open_loop(exact).real
    return (refined, exact) if abs(refined / gain - 1) < 0.01 else None


def _roots(hz: np.ndarray, values: np.ndarray, function: Callable[[float], float]) -> list[float]:
    """Return where a function vanishes between points of a grid at which its sign changes."""
    usable = np.isfinite(values)
    hz, values = hz[usable], values[usable]
    crossed = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
    found = [float(brentq(function, hz[k], hz[k + 1], xtol=1e-12 * hz[k], rtol=1e-14)) for k in crossed]
    return [*found, *hz[values == 0].tolist()]


def _largest(S: np.ndarray) -> np.ndarray:
    """Return the largest singular values of matrices (n, m, m)."""
    return np.asarray(np.linalg.norm(S, 2, axis=(1, 2)))


def _peak(hz: np.ndarray, values: np.ndarray, function: Callable[[float], float]) -> tuple[float, float]:
    """Return the frequency and height of the largest value, refined between its neighbours on the grid."""
    k = int(np.argmax(values))
    low, high = hz[max(k - 1, 0)], hz[min(k + 1, len(hz) - 1)]
    if high <= low:
        return float(hz[k]), float(values[k])
    options = {"xatol": 1e-9 * high}
    found = minimize_scalar(lambda f: -function(f), bounds=(low, high), method="bounded", options=options)
    best = (float(found.x), float(-found.fun))
    return best if best[1] >= values[k] else (float(hz[k]), float(values[k]))
