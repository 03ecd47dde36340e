"""A machine: its equations of motion in z = x + i y, closed by PID-controlled magnetic bearings.

M q'' + (D - i W G) q' + K q + D' conj(q') + K' conj(q) = sum_b b (k_s z_b - k_i i_b) + forces
i_b = H(s) [K_P z_s + K_I int z_s dt + K_D z_s'],   z_s = r . q + e

q: complex displacements (and slopes du/ds), W the speed, r what the probe of bearing b sees, e what it adds by itself,
H the current path (1 if nothing is wrong with it). K', D' are there where supports differ in x and y. Faults change
these quantities or add forces.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Gains = tuple[float, float, float]  # K_P, K_I, K_D

MATRICES = ("mass", "damping", "stiffness", "gyroscopic")
OF_CONJUGATE = ("stiffness_conj", "damping_conj")


def switching(angle: Array) -> Array:
    """Return the opening of a switching crack as five cosines, eq. (2.11)."""
    series = sum((-1) ** j / (2 * j + 1) * np.cos((2 * j + 1) * angle) for j in range(5))
    return np.asarray(0.5 + 2 / np.pi * series)


@dataclass
class CurrentPath:
    """Current path H(s) = direct + sum residue / (s - pole)."""

    direct: complex = 1.0
    poles: tuple[complex, ...] = ()
    residues: tuple[complex, ...] = ()
    recorded: bool = False  # the recorded current is behind the path (True) or before it


@dataclass
class Bearing:
    """A magnetic bearing with its controller, which reads one probe."""

    node: int  # where its force acts
    probe: int  # the node of the probe
    ks: float
    ki: float
    gains: Gains
    path: CurrentPath = field(default_factory=CurrentPath)
    mark: str = ""  # in names of inputs and outputs: "" of the first, "2" of the second
    amb: str = "amb"  # blocks of the diagram
    controller: str = "controller"


@dataclass
class Unbalance:
    """Unbalance of a disc."""

    node: int
    mass: float
    eccentricity: float
    phase: float
    block: str = "unbalance"


@dataclass
class Crack:
    """Crack whose force rests on the static deflection `sag`."""

    node: int
    stiffness: float
    phase: float
    sag: float
    opening: Callable[[Array], Array] = switching


@dataclass
class Plant:
    """A machine at rest in its bearings; see the module."""

    mass: Array
    damping: Array
    stiffness: Array
    gyroscopic: Array
    displacement: dict[int, int]  # node of the diagram -> degree of freedom
    tilt: dict[int, int]
    bearings: list[Bearing]
    unbalances: list[Unbalance]
    crack: Crack
    base: Array  # M r: inertia force for a unit acceleration of the base
    probes: dict[int, Array]  # node -> row on q
    stiffness_conj: Array | None = None  # K', D'
    damping_conj: Array | None = None
    stiff: bool = False  # elements or supports far stiffer than what moves
    supports: tuple[int, ...] = ()  # nodes
    floating: bool = False  # nothing but the magnetic bearings holds the shaft

    @property
    def size(self) -> int:
        """Degrees of freedom."""
        return len(self.mass)

    @property
    def anisotropic(self) -> bool:
        """Whether the equations hold conj(q)."""
        return self.stiffness_conj is not None

    def flexibility(self, node: int) -> float:
        """Return the static displacement [m/N] of the shaft at a node, without magnetic bearing.

        A floating shaft is held by its bearings, without their integral action.
        """
        held = self.stiffness.copy()
        for bearing in self.bearings if self.floating else ():
            held[self.displacement[bearing.node]] += bearing.ki * bearing.gains[0] * self.probes[bearing.probe]
            held[self.displacement[bearing.node], self.displacement[bearing.node]] -= bearing.ks
        dof = self.displacement[node]
        return float(np.linalg.inv(held)[dof, dof].real)

    def grow(self) -> int:
        """Add a degree of freedom without mass or spring; return its index."""
        for name in (*MATRICES, *(OF_CONJUGATE if self.anisotropic else ())):
            setattr(self, name, np.pad(getattr(self, name), ((0, 1), (0, 1))))
        self.base = np.pad(self.base, (0, 1))
        self.probes = {node: np.pad(row, (0, 1)) for node, row in self.probes.items()}
        return self.size - 1
