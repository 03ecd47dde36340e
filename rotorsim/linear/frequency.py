"""Frequency response between ports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim._shown import Shown, xarray_module
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import as_model, linearise
from rotorsim.linear.stability import growing
from rotorsim.model.compiled import Model


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
        stable=not growing(system.A),
        notes=system.notes,
        provenance={**system.provenance, "analysis": "frequency_response"},
    )


def _ratio(above: str, below: str) -> str:
    if below == "1":
        return above
    if above == below:
        return "1"
    return f"{above}/({below})" if any(c in below for c in " /*.") else f"{above}/{below}"
