"""Where probes and magnets stand on the mode shapes of the rotor: in phase, in opposite phase, or at a node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.linear.linearisation import as_model, entry_names, flat_names
from rotorsim.linear.loop import SENSOR, arriving
from rotorsim.linear.modes.free_rotor import Bearing, FreeRotor, RotorMode, bearings_of, downstream, free_rotor
from rotorsim.model.compiled import Model

AT_A_NODE = 0.05  # of the largest displacement of a mode: a probe or a magnet that hardly sees or moves it


@dataclass(frozen=True)
class Collocation:
    """One mode of the free rotor at one bearing: displacements in parts of the largest of the mode.

    mode: from 1; frequency [Hz]. sensor, actuator: of the probe's and of the magnet's plane, the magnet's positive.
    probe, magnet: the signals in x that the controller and the bearing see.
    """

    controller: str
    bearing: str
    probe: str
    magnet: str
    mode: int
    frequency: float
    sensor: float
    actuator: float

    @property
    def product(self) -> float:
        """Sensor times actuator: negative where a controller that damps by phase lead drives the mode."""
        return self.sensor * self.actuator

    @property
    def verdict(self) -> str:
        """Either "in phase", "opposite phase", or "node" where the probe or the magnet is near one."""
        if min(abs(self.sensor), abs(self.actuator)) < AT_A_NODE:
            return "node"
        return "in phase" if self.product > 0 else "opposite phase"


@dataclass(frozen=True, eq=False)
class ModeShape:
    """A mode of the free rotor: frequency [Hz], displacement of every plane (n,) in x, the largest one.

    slope (n,) [1/m]: of the shaft there; empty where the rotor does not tell it.
    """

    number: int
    frequency: float
    shape: np.ndarray
    slope: np.ndarray


@dataclass(frozen=True, eq=False)
class FreeModes:
    """The bent modes of the free rotor, and how every probe and its magnet stand in them."""

    shapes: tuple[ModeShape, ...]
    pairs: tuple[Collocation, ...]


def collocation(
    diagram: Diagram | Model, *, parameters: Mapping[str, Any] | None = None, highest: float = 2000.0
) -> FreeModes:
    """Return how probes and magnets stand in the bent modes of the rotor without its bearings, up to a frequency [Hz].

    The transfer function from the force of a magnet to its probe is the sum over the modes of R / (s^2 + w^2); the sign
    of R is that of the mode shape at the probe times that at the magnet. In the plane of x, at rest. Modes of the rigid
    body are left out: both move alike.

    Raises RotorsimError as `free_rotor`. Source: Schweitzer & Maslen, Magnetic Bearings (2009), 7.4.2, 10.3;
    ISO 14839-4:2012, 8.4.
    """
    drawn = diagram.diagram if isinstance(diagram, Model) else diagram
    model = as_model(diagram)
    planes = [name for name in model.signals if _is_rotor_displacement(drawn, name)]
    pairs = controlled(drawn)
    seen = [name for _, signals, _ in pairs for name in signals]
    tilts = [name for name in (plane.replace(".displacement", ".tilt") for plane in planes) if name in model.signals]
    rotor = free_rotor(drawn, signals=[*planes, *tilts, *seen], parameters=parameters)
    along_x, sloped = (
        rotor.rows([name for one in signals for name in flat_names(model, one)][0::2]) for signals in (planes, tilts)
    )
    shapes: list[ModeShape] = []
    found: list[Collocation] = []
    bent = [mode for mode in rotor.modes() if not mode.rigid and mode.frequency <= 2 * np.pi * highest]
    for mode in bent:
        vector = _in_x(mode, along_x)
        if vector is None:
            continue
        largest = (along_x @ vector)[np.argmax(np.abs(along_x @ vector))]
        vector = vector / largest
        number, hz = len(shapes) + 1, mode.frequency / (2 * np.pi)
        shapes.append(ModeShape(number, hz, along_x @ vector, sloped @ vector))
        for controller, signals, bearing in pairs:
            found.append(_at_bearing(rotor, mode, vector, controller, signals[0], bearing, number))
    return FreeModes(tuple(shapes), tuple(found))


def _in_x(mode: RotorMode, along_x: np.ndarray) -> np.ndarray | None:
    """Return the vector of a mode that moves most in x; None for one that does not: its twin in the plane of y."""
    _, sizes, right = np.linalg.svd(along_x @ mode.V)
    if not len(sizes) or sizes[0] <= AT_A_NODE * np.linalg.norm(mode.V) / np.sqrt(len(mode.V)):
        return None
    return np.asarray(mode.V @ right[0])


def _at_bearing(
    rotor: FreeRotor, mode: RotorMode, vector: np.ndarray, controller: str, sensor: str, bearing: Bearing, number: int
) -> Collocation:
    force = rotor.column(entry_names(bearing.force, (2,))[0])
    seen = float(rotor.rows([sensor])[0] @ vector)
    magnet = float(rotor.rows([bearing.seen[0]])[0] @ vector)
    sign = np.sign(mode.residue(rotor.rows([sensor])[0], force)) or 1.0
    return Collocation(
        controller,
        bearing.name,
        sensor,
        bearing.seen[0],
        number,
        mode.frequency / (2 * np.pi),
        float(sign) * abs(seen),
        abs(magnet),
    )


def _is_rotor_displacement(diagram: Diagram, name: str) -> bool:
    block, _, port = name.rpartition(".")
    node = diagram.nodes.get(block)
    return node is not None and node.block.category == "rotor" and port == "displacement" and port in node.outputs


def controlled(diagram: Diagram) -> tuple[tuple[str, tuple[str, str], Bearing], ...]:
    """Return (controller, its signals x and y, bearing) of every bearing that a controller drives.

    A controller of several bearings has their probes in the order of the parts of its outputs that reach them.
    """
    made = []
    bearings = {bearing.name: bearing for bearing in bearings_of(diagram)}
    for name, node in diagram.nodes.items():
        if node.block.category != "controller" or SENSOR not in node.inputs:
            continue
        signals = arriving(diagram, name, SENSOR)
        driven = [bearings[other] for other in downstream(diagram, name) if other in bearings]
        if signals is None or len(signals) != 2 * len(driven):
            continue
        for k, bearing in enumerate(driven):
            made.append((name, (signals[2 * k], signals[2 * k + 1]), bearing))
    return tuple(made)
