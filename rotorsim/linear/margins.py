"""Stability margins of magnetic-bearing loops after ISO 14839-3: sensitivity, open and closed loop, gain and phase."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import factorial
from typing import Any

import numpy as np
from scipy.optimize import brentq

from rotorsim._shown import Shown
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.linear.frequency import LARGEST_FREQUENCY, peak_between, zone_of
from rotorsim.linear.held import HeldSystem
from rotorsim.linear.linearisation import (
    LinearSystem,
    as_model,
    entry_names,
    linearise,
    linearise_held,
    provenance,
    speed_of,
)
from rotorsim.linear.stability import growing
from rotorsim.model.compiled import Model

LOWEST_FREQUENCY = 0.01  # Hz
SENSOR, RATE = "displacement", "velocity"  # input ports of a controller: one sensor signal, and what is made of it
STANDARD = "ISO 14839-3:2006"


@dataclass(frozen=True)
class Axis:
    """Margins of one axis, the loops of the others closed.

    peak of |S_jj|, at frequency [Hz], zone. gain_up, gain_down: factors of the loop gain, above and below 1, that bring
    it to the limit of stability (inf, 0: none does); phase [deg] and delay [s] likewise, nan without |G_o| = 1; with
    the frequencies [Hz] of these crossings.
    """

    name: str
    peak: float
    frequency: float
    zone: str
    gain_up: float
    gain_up_frequency: float
    gain_down: float
    gain_down_frequency: float
    phase: float
    phase_frequency: float
    delay: float
    delay_frequency: float


@dataclass(frozen=True, repr=False)
class Margins(Shown):
    """Sensitivity and margins of all bearing axes of a diagram.

    frequencies (n,) [Hz]; sensitivity (n, m, m): S, V1 = S E where E is added to a signal V2 and V1 is what goes on.
    singular (n,): largest singular value of S, nan where axes have several units; singular_peak: the largest of all.
    stable: of the closed loop; an unstable one has no margins and is zone "D".
    """

    frequencies: np.ndarray
    sensitivity: np.ndarray
    axes: tuple[Axis, ...]
    singular: np.ndarray
    singular_peak: float
    singular_peak_frequency: float
    highest_frequency: float
    stable: bool
    sampled: bool
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.linear:margins_figure"

    def __repr__(self) -> str:
        return f"Margins({self.statement})"

    @property
    def worst(self) -> Axis:
        """The axis with the largest peak, which the standard judges."""
        return max(self.axes, key=lambda axis: axis.peak)

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
        return np.asarray(1 / np.diagonal(self.sensitivity, axis1=1, axis2=2) - 1)

    def open_loop_matrix(self) -> np.ndarray:
        """Return G_o = S^-1 - I, shape (n, m, m)."""
        return np.asarray(np.linalg.inv(self.sensitivity) - np.eye(self.sensitivity.shape[1]))

    def closed_loop(self) -> np.ndarray:
        """Return G_c = I - S, shape (n, m, m): V2 = -G_c E."""
        return np.asarray(np.eye(self.sensitivity.shape[1]) - self.sensitivity)


def margins(
    diagram: Diagram | Model,
    at: Sequence[str] | str = (),
    *,
    parameters: Mapping[str, Any] | None = None,
    frequencies: Sequence[float] | np.ndarray | None = None,
) -> Margins:
    """Return sensitivity, open and closed loop and margins of every bearing axis, after ISO 14839-3.

    A signal E is added to V2, V1 = V2 + E goes on: S = V1/E, G_o = -V2/V1 = 1/S - 1, G_c = -V2/E = 1 - S. Each axis is
    judged by |S_jj| with the other axes closed, as measured on a machine. at: input ports (``controller.displacement``,
    default: of every controller), or output ports (``controller.current``). With the displacement of a controller its
    wired velocity is disturbed by dE/dt, as of a rate that is made of the sensor's signal. frequencies [Hz]: default
    from 0.01 Hz to the larger of 2 kHz and three times the speed, as the standard asks. A loop with sampled blocks has
    its exact response at the frequency injected (`linear.held`), and gains at which its multipliers reach 1.

    Raises RotorsimError for ports that do not exist or that no loop passes through, and as `linearise`.
    Source: ISO 14839-3:2006, Evaluation of stability margin.
    """
    drawn = diagram.diagram if isinstance(diagram, Model) else diagram
    ports = [at] if isinstance(at, str) else list(at)
    taps = [tap for port in ports or sensor_ports(drawn) for tap in _taps(drawn, port)]
    injected = [port for port, _, _ in taps]
    outputs = [signal for _, signals, _ in taps for signal in signals]
    sizes = [len(signals) for _, signals, _ in taps]
    model = as_model(diagram, inject=injected)
    speed = speed_of(model, model.parameter_vector(parameters)) or 0.0
    system: LinearSystem | HeldSystem
    notes: tuple[str, ...] = ()
    if model.n_z:
        system = linearise_held(model, parameters=parameters, inputs=injected, outputs=outputs)
        stable = bool((np.abs(system.multipliers()) <= 1 + 1e-9).all())
        flow = system.flow.poles()
    else:
        system = linearise(model, parameters=parameters, inputs=injected, outputs=outputs)
        stable, flow, notes = not growing(system.A), system.poles(), system.notes
    column = np.cumsum([0, *sizes])
    is_rate = np.repeat([rate for _, _, rate in taps], sizes)
    place = np.flatnonzero(~is_rate)  # of each axis among inputs and outputs
    pairs = _rates(taps, column)  # of a rate -> of its axis

    def sensitivity(f: Any) -> np.ndarray:
        f = np.atleast_1d(np.asarray(f, float))
        found = system.response(f)
        drive = np.repeat(np.eye(int(column[-1]))[None, :, place].astype(complex), len(f), 0)
        for rate, displacement in pairs.items():
            drive[:, rate, int(np.searchsorted(place, displacement))] = 2j * np.pi * f
        return np.asarray((found @ drive)[:, place] + np.eye(len(place)))

    top = max(LARGEST_FREQUENCY, 3 * abs(speed) / (2 * np.pi))
    hz = _grid(np.concatenate([system.poles(), flow]), top) if frequencies is None else _checked(frequencies)
    S = sensitivity(hz)
    diagonal = np.abs(np.diagonal(S, axis1=1, axis2=2))
    dead = [k for k in range(len(place)) if np.abs(diagonal[:, k] - 1).max(initial=0.0) < 1e-12]
    names = [name for port, _, rate in taps if not rate for name in _names(model, port)]
    if dead:
        hint = "name a port of the loop with --at: a controller's sensor signal, or its output"
        raise RotorsimError(*(Problem("no loop passes through this port", names[k], hint=hint) for k in dead))

    def entry(k: int) -> Callable[[float], complex]:
        return lambda f: complex(sensitivity(f)[0, k, k])

    axes = tuple(_axis(name, hz, S[:, k, k], entry(k), stable) for k, name in enumerate(names))
    if isinstance(system, HeldSystem) and stable:
        with_rates = [[int(place[k]), *(r for r, d in pairs.items() if d == place[k])] for k in range(len(place))]
        axes = tuple(_exact_gains(axis, system, wires) for axis, wires in zip(axes, with_rates, strict=True))
    alike = len({model.trace.external[port].unit for port, _, rate in taps if not rate}) == 1
    singular = np.linalg.norm(S, 2, axis=(1, 2)) if alike else np.full(len(hz), np.nan)
    largest = (
        peak_between(hz, singular, lambda f: float(np.linalg.norm(sensitivity(f)[0], 2))) if alike else (np.nan, np.nan)
    )
    return Margins(
        frequencies=hz,
        sensitivity=S,
        axes=axes,
        singular=singular,
        singular_peak=largest[1],
        singular_peak_frequency=largest[0],
        highest_frequency=top,
        stable=stable,
        sampled=bool(model.n_z),
        notes=(*notes, *_approximations(drawn, top)),
        provenance=provenance(model, parameters, "margins"),
    )


def sensor_ports(diagram: Diagram) -> list[str]:
    """Return the sensor signals of all controllers: their input ports ``displacement`` that something feeds."""
    fed = {(wire.target.block, wire.target.port) for wire in diagram.wires}
    blocks = [name for name, node in diagram.nodes.items() if node.block.category == "controller"]
    found = [f"{name}.{SENSOR}" for name in blocks if (name, SENSOR) in fed]
    if not found:
        hint = "name the ports of its bearing loops with --at: a sensor signal (gain.input) or an output (gain.output)"
        raise RotorsimError(Problem("no controller with a wired input 'displacement'", diagram.name, hint=hint))
    return found


def _taps(diagram: Diagram, port: str) -> list[tuple[str, list[str], bool]]:
    """Return what is injected for a port: (port, names of the entries that arrive there, whether it is a rate)."""
    block, _, name = port.rpartition(".")
    node = diagram.nodes.get(block)
    if node is None:
        hint = near_miss(block, diagram.nodes)
        raise RotorsimError(Problem("no such block", block or port, hint=hint))
    if name in node.outputs:
        return [(port, [port] if not node.outputs[name].shape else entry_names(port, node.outputs[name].shape), False)]
    if name not in node.inputs:
        hint = near_miss(name, [*node.inputs, *node.outputs])
        raise RotorsimError(Problem("no such port", port, hint=hint))
    signals = _arriving(diagram, block, name)
    if signals is None:
        hint = "every entry needs one wire; or name the output port that feeds it"
        raise RotorsimError(Problem("not every entry of this input is a signal of its own", port, hint=hint))
    taps = [(port, signals, False)]
    rate = _arriving(diagram, block, RATE) if name == SENSOR and RATE in node.inputs else None
    if rate is not None:
        taps.append((f"{block}.{RATE}", rate, True))
    return taps


def _arriving(diagram: Diagram, block: str, port: str) -> list[str] | None:
    """Return the name of the signal that arrives at each entry of an input port; None where one has none or several."""
    shape = diagram.nodes[block].inputs[port].shape
    entries = np.empty(shape or (1,), object)
    for wire in diagram.wires:
        if (wire.target.block, wire.target.port) != (block, port):
            continue
        source = diagram.nodes[wire.source.block].outputs[wire.source.port]
        whole = np.array(entry_names(f"{wire.source.block}.{wire.source.port}", source.shape), object)
        names = whole.reshape(source.shape or (1,))[wire.source.index]
        part = entries[wire.target.index] if shape else entries
        if np.any(part != None):  # noqa: E711 (entry by entry)
            return None
        entries[wire.target.index if shape else ...] = names
    flat = entries.ravel().tolist()
    return None if None in flat else flat


def _rates(taps: Sequence[tuple[str, list[str], bool]], column: np.ndarray) -> dict[int, int]:
    """Return the entry of each rate among all inputs -> that of its displacement, which stands right before it."""
    pairs: dict[int, int] = {}
    for k, (_, signals, rate) in enumerate(taps):
        if rate:
            pairs |= {int(column[k]) + j: int(column[k - 1]) + j for j in range(len(signals))}
    return pairs


def _names(model: Model, port: str) -> list[str]:
    return entry_names(port, model.trace.external[port].shape)


def _checked(frequencies: Sequence[float] | np.ndarray) -> np.ndarray:
    hz = np.unique(np.asarray(frequencies, float).ravel())
    if not (len(hz) and np.isfinite(hz).all() and (hz > 0).all()):
        raise RotorsimError(Problem(what="frequencies must be positive and finite [Hz]", subject="frequencies"))
    return hz


def _approximations(diagram: Diagram, top: float) -> tuple[str, ...]:
    """Return what is said of delays whose Pade approximation is off by more than 1 % of the signal at a frequency.

    |H - exp(-j w T)| = (n!)^2 / ((2n)! (2n + 1)!) (w T)^(2n + 1), of the block ``delay``.
    """

    said = []
    for name, node in diagram.nodes.items():
        if "delay" in node.values and hasattr(node.block.option, "order"):
            n, angle = int(node.block.option.order), 2 * np.pi * top * float(np.max(node.values["delay"]))
            error = min(factorial(n) ** 2 / (factorial(2 * n) * factorial(2 * n + 1)) * angle ** (2 * n + 1), 2.0)
            if error > 0.01:
                said.append(f"'{name}': its Pade approximation is off by {error:.2g} of the signal at {top:.0f} Hz")
    return tuple(said)


def _axis(name: str, hz: np.ndarray, S: np.ndarray, function: Callable[[float], complex], stable: bool) -> Axis:
    """Return peak and margins of one axis from S on a grid and S(f) in between."""
    frequency, peak = peak_between(hz, np.abs(S), lambda f: abs(function(f)))
    nan = float("nan")
    if not stable:
        return Axis(name, peak, frequency, "D", nan, nan, nan, nan, nan, nan, nan, nan)
    G = 1 / S - 1
    real = _roots(hz, G.imag, lambda f: (1 / function(f) - 1).imag)
    factors = [(-1 / (1 / function(f) - 1).real, f) for f in real if (1 / function(f) - 1).real < -1e-9]
    up = min((pair for pair in factors if pair[0] > 1), default=(np.inf, nan))
    down = max((pair for pair in factors if pair[0] < 1), default=(0.0, nan))
    unity = _roots(hz, np.log(np.abs(G)), lambda f: float(np.log(abs(1 / function(f) - 1))))
    angles = [(float(np.degrees(np.angle(-(1 / function(f) - 1)))), f) for f in unity]  # beyond -180 degrees
    phase = min(((abs(angle), f) for angle, f in angles), default=(nan, nan))
    delay = min(((angle % 360 / 360 / f, f) for angle, f in angles), default=(nan, nan))
    return Axis(name, peak, frequency, zone_of(peak), *up, *down, *phase, *delay)


def _roots(hz: np.ndarray, values: np.ndarray, function: Callable[[float], float]) -> list[float]:
    """Return where a function vanishes between points of a grid at which its sign changes."""
    usable = np.isfinite(values)
    hz, values = hz[usable], values[usable]
    found = []
    for k in np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0):
        found.append(float(brentq(function, hz[k], hz[k + 1], xtol=1e-12 * hz[k], rtol=1e-14)))
    return [*found, *hz[values == 0].tolist()]


def _exact_gains(axis: Axis, system: HeldSystem, wires: list[int]) -> Axis:
    """Return an axis with the gains at which a multiplier reaches 1, next to those of the response.

    What a hit reads holds images of the signal, too: a loop gain at one frequency does not tell the limit exactly.
    """

    def growth(gain: float) -> float:
        return float(np.abs(system.with_gain(gain, wires).multipliers()).max()) - 1 - 1e-9

    up, down = _limit(growth, axis.gain_up), _limit(growth, axis.gain_down)
    return replace(axis, gain_up=up, gain_down=down)


def _limit(growth: Callable[[float], float], near: float) -> float:
    """Return the gain nearest to 1 at which a loop that is stable at 1 is no longer, beginning at an estimate."""
    if not 0 < near < np.inf:
        return near
    inside, step = 1.0, near ** (1 / 16)  # sixteenths of the way, and as many beyond
    for k in range(1, 33):
        if growth(step**k) > 0:
            return float(brentq(growth, inside, step**k, rtol=1e-12))
        inside = step**k
    return np.inf if near > 1 else 0.0


def _grid(poles: np.ndarray, top: float) -> np.ndarray:
    """Return frequencies [Hz] that miss no peak: logarithmic, and clustered at every pole's frequency."""
    width = np.abs(poles.real) / (2 * np.pi)
    near = (np.abs(poles.imag) / (2 * np.pi))[:, None] + width[:, None] * np.linspace(-3, 3, 13)
    hz = np.unique(np.concatenate([np.geomspace(LOWEST_FREQUENCY, top, 600), near.ravel()]))
    return np.asarray(hz[(hz >= LOWEST_FREQUENCY) & (hz <= top)])
