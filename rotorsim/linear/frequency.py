"""Frequency response between ports, and the sensitivity of a magnetic-bearing loop after ISO 14839-3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from rotorsim._shown import Shown, xarray_module
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.linear.linearisation import LinearSystem, as_model, linearise, speed_of
from rotorsim.model.compiled import Model

ZONES = ((3.0, "A"), (4.0, "B"), (5.0, "C"))  # ISO 14839-3:2006, table 1: 9.5 dB, 12 dB, 14 dB
LARGEST_FREQUENCY = 2000.0  # Hz; ISO 14839-3 looks up to three times the rated speed or 2 kHz, the larger


@dataclass(frozen=True, repr=False)
class FrequencyResponse(Shown):
    """Complex response: value[k] (outputs, inputs) at frequencies[k] [Hz].

    outputs, inputs: flat names; units: text of output unit per input unit, same shape as value[k].
    """

    frequencies: np.ndarray
    value: np.ndarray
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    units: tuple[tuple[str, ...], ...]
    stable: bool
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.linear:frequency_response_figure"

    def __repr__(self) -> str:
        span = f"{self.frequencies[0]:g}..{self.frequencies[-1]:g} Hz" if len(self.frequencies) else "no frequencies"
        state = "" if self.stable else ", not stable"
        return f"FrequencyResponse({', '.join(self.outputs)} / {', '.join(self.inputs)}: {span}{state})"

    def to_xarray(self) -> Any:
        """Return an xarray.DataArray over frequency [Hz], output and input; needs the optional package xarray."""
        coordinates = {
            "frequency": ("frequency", self.frequencies, {"units": "Hz"}),
            "output": list(self.outputs),
            "input": list(self.inputs),
            "unit": (("output", "input"), np.array(self.units, dtype=object)),
        }
        attributes = {name: str(value) for name, value in self.provenance.items()}
        return xarray_module().DataArray(self.value, coordinates, ("frequency", "output", "input"), attrs=attributes)


@dataclass(frozen=True, repr=False)
class Sensitivity(Shown):
    """Sensitivity S = (I - L)^-1 at a controller's output, with the closed loop intact.

    frequencies (n,) [Hz]; axes (n, m): |S_jj| of every axis; singular (n,): largest singular value of S.
    peaks (m,), peak_frequencies (m,) [Hz] and zones per axis; peak, peak_frequency, zone: of the worst axis, as
    ISO 14839-3 judges. singular_peak: largest singular value over all frequencies (coupled axes included).
    An unstable loop has zone "D" and says so in ``statement``.
    """

    frequencies: np.ndarray
    axes: np.ndarray
    singular: np.ndarray
    names: tuple[str, ...]
    peaks: np.ndarray
    peak_frequencies: np.ndarray
    zones: tuple[str, ...]
    singular_peak: float
    singular_peak_frequency: float
    stable: bool
    statement: str
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.linear:sensitivity_figure"

    def __repr__(self) -> str:
        return f"Sensitivity({self.statement})"

    @property
    def worst(self) -> int:
        """Number of the axis with the largest peak (from 0)."""
        return int(np.argmax(self.peaks))

    @property
    def peak(self) -> float:
        """Largest |S_jj| of all axes."""
        return float(self.peaks[self.worst])

    @property
    def peak_frequency(self) -> float:
        """Frequency of ``peak`` [Hz]."""
        return float(self.peak_frequencies[self.worst])

    @property
    def zone(self) -> str:
        """Zone of the worst axis: "A", "B", "C" or "D"."""
        return self.zones[self.worst] if self.stable else "D"


def zone_of(peak: float) -> str:
    """Return the zone of a peak sensitivity: A below 3 (9.5 dB), B below 4 (12 dB), C below 5 (14 dB), else D.

    Source: ISO 14839-3:2006, Evaluation of stability margin, table 1.
    """
    return next((zone for limit, zone in ZONES if peak < limit), "D")


def frequency_response(
    diagram: Diagram | Model,
    input: str,
    output: str,
    *,
    frequencies: Sequence[float] | np.ndarray,
    parameters: Mapping[str, Any] | None = None,
    at: np.ndarray | None = None,
    open_loop: bool = False,
) -> FrequencyResponse:
    """Return the response of a signal to a disturbance added at an output port, loops closed.

    G(f) = C (i 2 pi f I - A)^-1 B + D at frequencies [Hz]. input: an output port such as
    ``controller.current``; with open_loop the loop is opened there. output: a signal or a part of one.

    Raises RotorsimError as `linearise`, and for frequencies that are not finite.
    """
    hz = np.atleast_1d(np.asarray(frequencies, float)).ravel()
    if not np.isfinite(hz).all():
        raise RotorsimError(Problem(what="frequencies must be finite [Hz]", subject="frequencies"))
    model = as_model(diagram, *(((), (input,)) if open_loop else ((input,), ())))
    system = linearise(model, parameters=parameters, inputs=(input,), outputs=(output,), at=at, open_loop=open_loop)
    return FrequencyResponse(
        frequencies=hz,
        value=system.response(hz),
        outputs=system.outputs,
        inputs=system.inputs,
        units=tuple(tuple(_ratio(y, u) for u in system.input_units) for y in system.output_units),
        stable=_stable(system),
        notes=system.notes,
        provenance={**system.provenance, "analysis": "frequency_response"},
    )


def _ratio(above: str, below: str) -> str:
    if below == "1":
        return above
    if above == below:
        return "1"
    return f"{above}/({below})" if any(c in below for c in " /*.") else f"{above}/{below}"


def _stable(system: LinearSystem) -> bool:
    return bool((system.poles().real <= 1e-12 * np.abs(system.A).max(initial=0.0) ** 0.5).all())


def sensitivity(
    diagram: Diagram | Model,
    controller: str = "controller",
    *,
    parameters: Mapping[str, Any] | None = None,
    frequencies: Sequence[float] | np.ndarray | None = None,
    at: np.ndarray | None = None,
) -> Sensitivity:
    """Return the sensitivity of the loop through a controller, and its zone after ISO 14839-3.

    A disturbance d is added to the controller's output u; the bearing sees u + d = S d, S = (I - L)^-1, with L
    the gain once round the loop. Each axis is judged by |S_jj| with the other axes closed, as measured on a
    machine. frequencies [Hz]: default from 0.01 Hz to the larger of 2 kHz and three times the speed, as the
    standard asks; peaks between them are found by minimisation.

    Raises RotorsimError as `linearise`. Source: ISO 14839-3:2006, Evaluation of stability margin.
    """
    port = controller_output(diagram, controller)
    model = as_model(diagram, inject=(port,))
    speed = speed_of(model, model.parameter_vector(parameters)) or 0.0
    system = linearise(model, parameters=parameters, inputs=(port,), outputs=(port,), at=at)
    if not np.any(system.D) and not np.any(system.response([1.0, 10.0, 100.0])):
        hint = "name the block whose output the bearing takes"
        raise RotorsimError(Problem(what="no loop passes through this port", subject=port, hint=hint))
    hz = _grid(system, speed) if frequencies is None else np.atleast_1d(np.asarray(frequencies, float)).ravel()
    m = len(system.inputs)

    def at_frequency(f: Any) -> np.ndarray:
        return np.asarray(np.eye(m) + system.response(f))

    values = at_frequency(hz)
    axes = np.abs(np.diagonal(values, axis1=1, axis2=2))
    singular = np.linalg.norm(values, 2, axis=(1, 2))
    found = [peak_between(hz, axes[:, j], lambda f, j=j: abs(at_frequency(f)[0, j, j])) for j in range(m)]
    largest = peak_between(hz, singular, lambda f: float(np.linalg.norm(at_frequency(f)[0], 2)))
    stable = _stable(system)
    zones = tuple(zone_of(peak) if stable else "D" for _, peak in found)
    worst = max(range(m), key=lambda j: found[j][1])
    where, peak = found[worst]
    statement = (
        f"peak sensitivity {peak:.3g} ({20 * np.log10(max(peak, 1e-300)):.1f} dB) at {where:.4g} Hz, "
        f"{system.inputs[worst]}: zone {zones[worst]} (ISO 14839-3:2006)"
        if stable
        else "the closed loop is unstable: a sensitivity cannot be measured, zone D (ISO 14839-3:2006)"
    )
    return Sensitivity(
        frequencies=hz,
        axes=axes,
        singular=singular,
        names=system.inputs,
        peaks=np.array([peak for _, peak in found]),
        peak_frequencies=np.array([f for f, _ in found]),
        zones=zones,
        singular_peak=largest[1],
        singular_peak_frequency=largest[0],
        stable=stable,
        statement=statement,
        provenance={**system.provenance, "analysis": "sensitivity"},
    )


def controller_output(diagram: Diagram | Model, controller: str) -> str:
    """Return the output port of a controller block: ``current`` if it has one, else its only output.

    Raises RotorsimError for an unknown block and for several outputs.
    """
    nodes = diagram.diagram.nodes if isinstance(diagram, Model) else diagram.nodes
    if controller not in nodes:
        raise RotorsimError(Problem(what="no such block", subject=controller, hint=near_miss(controller, nodes)))
    ports = list(nodes[controller].outputs)
    if "current" in ports:
        return f"{controller}.current"
    if len(ports) != 1:
        what = f"a controller has an output 'current' or a single one; this block has {', '.join(ports) or 'none'}"
        raise RotorsimError(Problem(what=what, subject=controller))
    return f"{controller}.{ports[0]}"


def _grid(system: LinearSystem, speed: float) -> np.ndarray:
    """Return frequencies [Hz] that miss no peak: logarithmic, and clustered at every pole's frequency."""
    poles = system.poles()
    top = max(LARGEST_FREQUENCY, 3 * speed / (2 * np.pi))
    width = np.abs(poles.real) / (2 * np.pi)
    near = (np.abs(poles.imag) / (2 * np.pi))[:, None] + width[:, None] * np.linspace(-3, 3, 13)
    hz = np.unique(np.concatenate([np.geomspace(1e-2, top, 600), near.ravel()]))
    return np.asarray(hz[(hz >= 1e-2) & (hz <= top)])


def peak_between(hz: np.ndarray, values: np.ndarray, function: Any) -> tuple[float, float]:
    """Return the frequency and height of the largest value, refined between its neighbours on the grid."""
    k = int(np.argmax(values))
    low, high = hz[max(k - 1, 0)], hz[min(k + 1, len(hz) - 1)]
    if high <= low:
        return float(hz[k]), float(values[k])
    options = {"xatol": 1e-9 * high}
    found = minimize_scalar(lambda f: -function(f), bounds=(low, high), method="bounded", options=options)
    best = (float(found.x), float(-found.fun))
    return best if best[1] >= values[k] else (float(hz[k]), float(values[k]))
