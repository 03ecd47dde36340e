"""Response to unbalance over the speed: what unit unbalances in chosen planes make of two-axis signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram, Port
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.linear.linearisation import as_model, entry_names, flat_names, provenance
from rotorsim.linear.loop import growing_poles, systems_at
from rotorsim.linear.modes.eigenmodes import checked_speeds, require_speed
from rotorsim.model.compiled import Model

STABILITY_SPEEDS = 41  # at which poles are looked at for one that grows
FORWARD = np.array([1.0, -1j])  # x = cos, y = sin of the shaft angle


@dataclass(frozen=True, eq=False)
class UnbalanceResponse:
    """Complex amplitudes to unbalances of 1 kg m at phase zero, one plane after the other; x(t) = Re(X exp(i W t)).

    speeds (n,) [rad/s]; planes: entries of rotor forces; signals: pairs (x, y); response (n, signals, planes, 2) [m];
    stable (n,): whether the machine settles to it, by its poles at 41 of the speeds.
    """

    speeds: np.ndarray
    planes: tuple[str, ...]
    signals: tuple[str, ...]
    response: np.ndarray
    stable: np.ndarray
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def to(self, unbalances: Sequence[complex] | np.ndarray) -> np.ndarray:
        """Return amplitudes (n, signals, 2) to unbalances [kg m] in all planes at once, complex: with their phases."""
        return np.asarray(np.einsum("nspa,p->nsa", self.response, np.asarray(unbalances)))

    def major_axis(self, unbalances: Sequence[complex] | np.ndarray) -> np.ndarray:
        """Return the largest displacement along the orbit, 0-peak (n, signals) [m]: (|X + iY| + |X - iY|) / 2."""
        motion = self.to(unbalances)
        return np.asarray((np.abs(motion @ [1, 1j]) + np.abs(motion @ [1, -1j])) / 2)


def unbalance_response(
    diagram: Diagram | Model,
    planes: Sequence[str],
    signals: Sequence[str],
    *,
    speeds: Sequence[float | str] | np.ndarray,
    parameters: Mapping[str, Any] | None = None,
    stability: bool = True,
) -> UnbalanceResponse:
    """Return the settled response of two-axis signals to unbalance in each plane, about the operating point.

    f = u W^2 (1, -i) exp(i W t) in (x, y), at planes such as ``rotor.force[4]``; sampled controllers exactly, at the
    frequency of the speed. What else drives the diagram is left out. stability: False looks at no poles, and
    ``stable`` is empty.

    Raises RotorsimError as `linearise`, without a diagram parameter ``speed``, and for ports that do not exist.
    """
    drawn = diagram.diagram if isinstance(diagram, Model) else diagram
    values = checked_speeds(speeds, zero=False)
    pairs = [plane_entries(drawn, plane) for plane in planes]
    ports = tuple(dict.fromkeys(port for port, _ in pairs))
    model = as_model(diagram, ports)
    require_speed(model, "an unbalance response")
    names = [name for signal in signals for name in flat_names(model, signal)]
    known = [name for port in ports for name in entry_names(port, drawn_port(drawn, port).shape)]
    columns = [known.index(entry) for _, entries in pairs for entry in entries]
    made: list[np.ndarray] = []
    stable: list[bool] = []
    notes: tuple[str, ...] = ()
    count = min(len(values), STABILITY_SPEEDS) if stability else 0
    looked = set(np.linspace(0, len(values) - 1, count).round().astype(int).tolist())
    system_at = systems_at(model, ports, names, parameters, values)
    for k, speed in enumerate(values):
        system, notes = system_at(float(speed), k == len(values) - 1)
        system = system.with_inputs(columns)
        G = system.response(speed / (2 * np.pi))[0].reshape(len(signals), 2, len(planes), 2)
        made.append(np.einsum("sapb,b->spa", G, FORWARD) * speed**2)
        if k in looked:
            stable.append(not len(growing_poles(system)))
    return UnbalanceResponse(
        speeds=values,
        planes=tuple(planes),
        signals=tuple(signals),
        response=np.array(made),
        stable=between(values, values[sorted(looked)], np.array(stable)) if stability else np.zeros(0, bool),
        notes=notes,
        provenance=provenance(model, parameters, "unbalance_response"),
    )


def between(speeds: np.ndarray, looked: np.ndarray, stable: np.ndarray) -> np.ndarray:
    """Return whether the machine is stable at speeds, as it is at both of the nearest that were looked at."""
    above = np.minimum(np.searchsorted(looked, speeds), len(looked) - 1)
    below = np.where(looked[above] > speeds, np.maximum(above - 1, 0), above)
    return np.asarray(stable[above] & stable[below])


def drawn_port(diagram: Diagram, name: str) -> Port:
    """Return an input port of a diagram. Raises RotorsimError for one that does not exist."""
    block, _, port = name.rpartition(".")
    node = diagram.nodes.get(block)
    if node is None:
        raise RotorsimError(Problem("no such block", block or name, hint=near_miss(block or name, diagram.nodes)))
    if port not in node.inputs:
        raise RotorsimError(Problem("no such input port", name, hint=near_miss(port, node.inputs)))
    return node.inputs[port]


def plane_entries(diagram: Diagram, plane: str) -> tuple[str, tuple[str, str]]:
    """Return the port of a plane such as ``rotor.force[4]`` and its two entries, x and y.

    Raises RotorsimError for one that is not there, or is no force with two axes.
    """
    port, bracket, inside = plane.partition("[")
    declared = drawn_port(diagram, port)
    shape = declared.shape
    place = inside.rstrip("]") if bracket else ""
    numbers = [int(part) for part in place.split(",") if part.strip().isdigit()] if place else []
    fits = len(numbers) == len(shape) - 1 and all(1 <= k <= size for k, size in zip(numbers, shape, strict=False))
    if declared.unit != "N" or shape[-1:] != (2,) or not fits or len(numbers) != len(place.split(",")) * bool(place):
        size = " x ".join(map(str, shape)) or "scalar"
        hint = f"for example {port}{'[1]' if len(shape) == 2 else ''}"
        what = f"no plane of unbalance: a force [N] with two axes is one; '{port}' has shape {size}"
        raise RotorsimError(Problem(f"{what}, in {declared.unit or '1'}", plane, hint=hint))
    before = "".join(f"{k}," for k in numbers)
    return port, (f"{port}[{before}1]", f"{port}[{before}2]")


def planes_of(diagram: Diagram) -> tuple[str, ...]:
    """Return the planes in which the diagram has unbalance: rotor forces that blocks of this type feed."""
    found: dict[str, None] = {}
    for wire in diagram.wires:
        source, end = diagram.nodes[wire.source.block], wire.target
        if source.block.type_name == "unbalance" and diagram.nodes[end.block].block.category == "rotor":
            found[str(end)] = None
    return tuple(found)
