"""Step response: what a signal does after a unit step at a port, with rise, overshoot and settling."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import expm

from rotorsim._shown import Shown
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import entry_names, flat_names, given_units, provenance, units_of
from rotorsim.linear.loop import disturbed, growing_poles, linear_system
from rotorsim.linear.modes.eigenmodes import RESONANT
from rotorsim.linear.sampled_data import SampledData
from rotorsim.linear.state_space import StateSpace
from rotorsim.model.compiled import Model

POINTS_OF_STEP = 2001  # at least
MOST_TIMES = 100_000
POINTS_OF_PERIOD = 20.0  # of the fastest oscillation that may resonate, up to 2 kHz
FASTEST, LONGEST = 2000.0, 1000.0  # Hz; s
SLOWEST_DECAYS = 6.0  # time constants of the slowest oscillation: default length
TIME_DOUBLINGS = 80  # of the time, within which a response has come to rest or never does
UNDAMPED = 1e-9  # damping ratio of an oscillation that does not end
COME_TO_REST = 1e-9  # of the largest: change of the response while the time is doubled, four times one after the other
SETTLED_BAND = 0.02  # of the final value, or of the largest where that is nearly zero, within which it has settled
NEARLY_NOTHING = 0.01  # of the largest value: a final value that integral action makes zero


@dataclass(frozen=True)
class StepNumbers:
    """Of one entry: final value, largest deviation from zero and its time [s], overshoot, rise and settling [s].

    overshoot: of the final value; rise: from 10 to 90 % of it; both NaN where it is nearly zero. settling: time from
    which on it stays within 2 % of the final value, or of the largest; NaN where it has not by the end.
    """

    output: str
    input: str
    final: float
    largest: float
    at: float
    overshoot: float
    rise: float
    settling: float


@dataclass(frozen=True, repr=False)
class StepResponse(Shown):
    """Response (n, outputs, inputs) over time (n,) [s] to a step of 1 SI at each input alone; numbers of each pair."""

    time: np.ndarray
    value: np.ndarray
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    units: tuple[tuple[str, str], ...]
    stable: bool
    numbers: tuple[StepNumbers, ...]
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.linear:step_response_figure"

    def __repr__(self) -> str:
        pairs = ", ".join(f"{one.output} / {one.input}" for one in self.numbers[:4])
        return f"StepResponse({self.provenance.get('diagram', '')}: {pairs}, {self.time[-1]:.4g} s)"


def step_response(
    diagram: Diagram | Model,
    input: str,
    output: str,
    *,
    stop: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    at: np.ndarray | None = None,
) -> StepResponse:
    """Return the response of a signal to a unit step added at a port, loops closed, linear about the operating point.

    y(t) = C A^-1 (exp(A t) - I) B + D in equal steps, exactly; sampled blocks hit at t = 0 and see the step then. What
    else drives the diagram is left out. stop [s]: default six time constants of the slowest oscillation. The final
    value is that at which the response comes to rest, NaN where it never does: a free body, an undamped oscillation.

    Raises RotorsimError as `frequency_response`, for a stop that is not positive, and for too many hits of samplers.
    """
    if stop is not None and not (np.isfinite(stop) and stop > 0):
        raise RotorsimError(Problem("must be positive and finite [s]", "stop"))
    model, port, places = disturbed(diagram, input)
    whole, notes = linear_system(model, (port,), (output,), parameters, at)
    system = whole.with_inputs(places)
    stable = not len(growing_poles(system))
    flow = system.flow if isinstance(system, SampledData) else system
    poles = system.poles() if isinstance(system, SampledData) else flow.connected().poles()
    end = _length(poles) if stop is None else float(stop)
    step = min(end / (POINTS_OF_STEP - 1), 1 / (POINTS_OF_PERIOD * _fastest(poles)))
    notes = (*notes, *_said(poles, end, step))
    step = max(step, end / (MOST_TIMES - 1))
    time, value = _sampled(system, end) if isinstance(system, SampledData) else _continuous(system, end, step)
    given = model.trace.external[port]
    outputs, inputs = tuple(flat_names(model, output)), tuple(entry_names(port, given.shape)[k] for k in places)
    rings_on = (np.abs(poles.imag) > 0) & (-poles.real <= UNDAMPED * np.abs(poles))
    rests = stable and not rings_on.any()
    final = _final(system, step) if rests else np.full(value.shape[1:], np.nan)
    numbers = [
        _numbers(outputs[o], inputs[i], time, value[:, o, i], float(final[o, i]))
        for o, i in np.ndindex(*value.shape[1:])
    ]
    units = [given_units(model, given)[k] for k in places]
    pairs = tuple((above, below) for above in units_of(model, (output,)) for below in units)
    return StepResponse(
        time,
        value,
        outputs,
        inputs,
        pairs,
        stable,
        tuple(numbers),
        notes,
        provenance(model, parameters, "step_response"),
    )


def _resonant(poles: np.ndarray) -> np.ndarray:
    """Return the poles that oscillate and may resonate, up to 2 kHz."""
    return np.asarray(
        poles[(poles.imag > 0) & (-poles.real < RESONANT * np.abs(poles)) & (poles.imag <= 2 * np.pi * FASTEST)]
    )


def _length(poles: np.ndarray) -> float:
    """Return how long a response is worth looking at [s]."""
    swinging = _resonant(poles)
    rates = np.abs(swinging.real if len(swinging) else poles.real)
    moving = rates[rates > 0]
    return float(min(SLOWEST_DECAYS / moving.min(), LONGEST)) if len(moving) else 1.0


def _fastest(poles: np.ndarray) -> float:
    """Return the highest frequency [Hz] of poles that may resonate; 0 for none."""
    return float(_resonant(poles).imag.max(initial=1e-9) / (2 * np.pi))


def _said(poles: np.ndarray, end: float, step: float) -> list[str]:
    """Return what the reader must know: poles slower than what is shown, and points too few for the fastest."""
    said = []
    slow = -poles.real[(poles.real < 0) & (-poles.real * end < 1.0)]
    if len(slow):
        said.append(f"a pole at {-slow.min():.3g} 1/s is slower than the {end:.3g} s that are shown: --stop")
    if step < end / (MOST_TIMES - 1) * (1 - 1e-9):
        said.append(
            f"points {end / (MOST_TIMES - 1):.3g} s apart are too few for {_fastest(poles):.4g} Hz: a shorter --stop"
        )
    return said


def _propagator(flow: StateSpace, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return exp(A h) and the integral of exp(A t) B over h."""
    n, m = flow.B.shape
    whole = expm(np.block([[flow.A, flow.B], [np.zeros((m, n + m))]]) * length)
    return whole[:n, :n], whole[:n, n:]


def _continuous(system: StateSpace, end: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    time = np.linspace(0.0, end, math.ceil(end / step - 1e-9) + 1)
    P, Q = _propagator(system, time[1])
    x, values = np.zeros_like(system.B), np.empty((len(time), *system.D.shape))
    for k in range(len(time)):
        values[k] = system.C @ x + system.D
        x = P @ x + Q
    return time, values


def _sampled(system: SampledData, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the response at every hit, and in the middle between hits."""
    hits = math.ceil(end / system.period) * len(system.jumps)
    if hits > MOST_TIMES:
        hint = f"--stop '{MOST_TIMES * system.period / len(system.jumps):.2g} s' at most"
        raise RotorsimError(Problem(f"{hits} hits of samplers, at most {MOST_TIMES}", "stop", hint=hint))
    flow, halves = system.flow, {}
    x, values, times = np.zeros_like(flow.B), [], []
    start = 0.0
    while start <= end:
        for k, (J, K) in enumerate(system.jumps):
            length = float(system.lengths[k])
            if length not in halves:
                halves[length] = _propagator(flow, length / 2)
            P, Q = halves[length]
            x = J @ x + K
            for part in (0.0, 0.5):
                times.append(start + system.times[k] + part * length)
                values.append(flow.C @ x + flow.D)
                x = P @ x + Q
        start += system.period
    time = np.array(times)
    shown = time <= end * (1 + 1e-9)
    return time[shown], np.array(values)[shown]


def _final(system: StateSpace | SampledData, step: float) -> np.ndarray:
    """Return where the response comes to rest, (outputs, inputs), NaN where it does not; of sampled loops at a hit.

    s := M s + g of a step is composed with itself, so that the time doubles, until the response changes no more.
    """
    if isinstance(system, SampledData):
        M, g = np.eye(len(system.flow.A)), np.zeros_like(system.flow.B)
        for k, (J, K) in enumerate(system.jumps):
            P, Q = _propagator(system.flow, float(system.lengths[k]))
            M, g = P @ J @ M, P @ (J @ g + K) + Q
        C = system.flow.C @ system.jumps[0][0]
        D = system.flow.C @ system.jumps[0][1] + system.flow.D
    else:
        reduced = system.connected()
        (M, g), C, D = _propagator(reduced, step), reduced.C, reduced.D
    before, largest = D, np.abs(D)
    still = np.zeros(D.shape, int)
    found = np.full(D.shape, np.nan)
    with np.errstate(all="ignore"):
        for _ in range(TIME_DOUBLINGS):
            M, g = M @ M, M @ g + g
            now = C @ g + D
            largest = np.maximum(largest, np.abs(now))
            still = np.where(np.abs(now - before) <= COME_TO_REST * largest, still + 1, 0)
            found = np.where((still >= 4) & np.isnan(found), now, found)
            before = now
            if not np.isfinite(g).all():
                break
    return np.where(still >= 4, found, np.nan)


def _numbers(output: str, input: str, time: np.ndarray, value: np.ndarray, final: float) -> StepNumbers:
    top = int(np.argmax(np.abs(value)))
    largest = float(value[top])
    if not np.isfinite(final) or not largest:
        return StepNumbers(output, input, final, largest, float(time[top]), np.nan, np.nan, np.nan)
    counts = abs(final) > NEARLY_NOTHING * abs(largest)
    overshoot = max(float((value / final).max()) - 1, 0.0) if counts else np.nan
    outside = np.abs(value - final) > SETTLED_BAND * (abs(final) if counts else abs(largest))
    last = int(np.flatnonzero(outside)[-1]) + 1 if outside.any() else 0
    settling = float(time[last]) if last < len(time) else np.nan
    rise = np.nan
    if counts:
        share = value / final
        low, high = (int(np.argmax(share >= part)) if (share >= part).any() else -1 for part in (0.1, 0.9))
        rise = float(time[high] - time[low]) if high >= 0 else np.nan
    return StepNumbers(output, input, float(final), largest, float(time[top]), overshoot, rise, settling)
