"""Frequency response between ports, and its peaks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from rotorsim._shown import Shown, xarray_module
from rotorsim.diagram.diagram import Diagram, wrong_port
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import entry_names, flat_names, given_units, provenance, units_of
from rotorsim.linear.loop import RATE, SENSOR, disturbed, growing_poles, linear_system, undisturbed_rates
from rotorsim.linear.sampled_data import SampledData
from rotorsim.linear.state_space import StateSpace, frequencies_near
from rotorsim.model.compiled import Model

DEFAULT_RANGE = (0.1, 2000.0)  # Hz
ZERO_PART = 1e-9  # of the largest response: rounding


@dataclass(frozen=True)
class ResponsePeak:
    """A maximum of the size of a response: frequency [Hz], value, output per input."""

    output: str
    input: str
    frequency: float
    value: complex


@dataclass(frozen=True, repr=False)
class FrequencyResponse(Shown):
    """Complex response: value[k] (outputs, inputs) at frequencies[k] [Hz].

    outputs, inputs: flat names; units: text of output unit per input unit, same shape as value[k]. peaks: maxima of the
    size of each entry.
    """

    frequencies: np.ndarray
    value: np.ndarray
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    units: tuple[tuple[str, ...], ...]
    stable: bool
    peaks: tuple[ResponsePeak, ...] = ()
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


def frequency_response(
    diagram: Diagram | Model,
    input: str,
    output: str,
    *,
    frequencies: Sequence[float] | np.ndarray | None = None,
    span: tuple[float, float] = DEFAULT_RANGE,
    parameters: Mapping[str, Any] | None = None,
    at: np.ndarray | None = None,
    open_loop: bool = False,
) -> FrequencyResponse:
    """Return the response of a signal to a disturbance added at a port, loops closed, and its peaks.

    G(f) = C (i 2 pi f I - A)^-1 B + D at frequencies [Hz] (default: over a span [Hz], dense at every pole). input:
    a port such as ``controller.current``, or a part of one, ``rotor.force[3,1]``; with open_loop the loop is opened
    there, the operating point being that of the closed loop. output: a signal or a part of one.
    With sampled blocks it is the component of the output at the frequency of the input, exactly. Peaks are looked for
    between the lowest and the highest frequency.

    Raises RotorsimError as `linearise`, for sampled blocks in a diagram that is not linear, and for frequencies that
    are not finite.
    """
    model, port, places = disturbed(diagram, input)
    if open_loop and port not in model.signals:
        raise RotorsimError(wrong_port(model.diagram, port, inputs=False))
    outputs, given = flat_names(model, output), model.trace.external[port]
    inputs = [entry_names(port, given.shape)[k] for k in places]
    signals = (*inputs, output) if open_loop else (output,)
    whole, notes = linear_system(model, (port,), signals, parameters, at)
    system = whole.with_inputs(places)
    if open_loop:
        system = system.opened().with_outputs(range(len(inputs), len(inputs) + len(outputs)))
    hz = frequencies_near(system.poles(), *span) if frequencies is None else np.asarray(frequencies, float)
    hz = np.atleast_1d(hz).ravel()
    if not np.isfinite(hz).all():
        raise RotorsimError(Problem(what="frequencies must be finite [Hz]", subject="frequencies"))
    block, _, name = port.rpartition(".")
    if name == SENSOR and f"{block}.{RATE}" in {f"{end.target.block}.{end.target.port}" for end in model.diagram.wires}:
        notes = (
            *notes,
            f"'{port}' is disturbed, and '{block}.{RATE}' is not: `margins` disturbs both, as one sensor does",
        )
    notes = (*notes, *undisturbed_rates(model.diagram, {port}))
    above, below = units_of(model, (output,)), [given_units(model, given)[k] for k in places]
    found = FrequencyResponse(
        frequencies=hz,
        value=system.response(hz),
        outputs=tuple(outputs),
        inputs=tuple(inputs),
        units=tuple(tuple(_ratio(y, u) for u in below) for y in above),
        stable=not len(growing_poles(system)),
        notes=notes,
        provenance=provenance(model, parameters, "frequency_response"),
    )
    return replace(found, peaks=tuple(_peaks(system, found)))


def _peaks(system: StateSpace | SampledData, found: FrequencyResponse) -> Iterator[ResponsePeak]:
    """Yield the maxima of every entry, the poles of the system looked at closely; pair by pair, ascending."""
    if len(found.frequencies) < 2 or not 0 < (low := float(found.frequencies.min())) < (
        high := found.frequencies.max()
    ):
        return
    hz = np.union1d(found.frequencies, frequencies_near(system.poles(), low, float(high)))
    size = np.abs(system.response(hz))
    for o, i in np.ndindex(size.shape[1:]):
        values = size[:, o, i]
        for k in np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])) + 1:
            if values[k] > ZERO_PART * size.max():

                def smaller(f: float, o: int = o, i: int = i) -> float:
                    return -float(np.abs(system.response(f)[0, o, i]))

                best = minimize_scalar(
                    smaller, bounds=(hz[k - 1], hz[k + 1]), method="bounded", options={"xatol": 1e-9 * hz[k]}
                )
                yield ResponsePeak(
                    found.outputs[o], found.inputs[i], float(best.x), complex(system.response(best.x)[0, o, i])
                )


def _ratio(above: str, below: str) -> str:
    if below == "1":
        return above
    if above == below:
        return "1"
    return f"{above}/({below})" if any(c in below for c in " /*.") else f"{above}/{below}"
