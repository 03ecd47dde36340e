"""The machines: equations of motion in z = x + i y, closed by a PID-controlled magnetic bearing.

M q'' + (D - i W G) q' + K q = b_amb (k_s z_amb - k_i i) + forces
i = H(s) [K_P z_s + K_I int z_s dt + K_D z_s'],   z_s = r . q + e

q: complex displacements (and slopes du/ds), W the speed, r what the probe sees, e what it adds by itself,
H the current path (1 if nothing is wrong with it). Faults change these quantities or add forces.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.machine_fe import beam

Array = NDArray[Any]

MASS, SHAFT_STIFFNESS, SAG = 2.0, 7.6e5, 26e-6  # known to whoever has the diagram: Table 2-1
POLAR, DIAMETRAL = 0.0045, 0.0024  # Table 4-1
MASS_DAMPING, STIFFNESS_DAMPING = 0.154, 1e-5
ELEMENTS = 15  # three for each element of the diagram
NOMINAL = {"c": 76.0, "e": 24e-6, "dk": 3e5, "ks": 105210.0, "ki": 42.1}


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
class Plant:
    """A machine at rest in its bearings; see the module."""

    mass: Array
    damping: Array
    stiffness: Array
    gyroscopic: Array
    displacement: dict[int, int]  # node of the diagram -> degree of freedom
    tilt: dict[int, int]
    amb: int
    disc: int
    crack: int
    ks: float
    ki: float
    gains: tuple[float, float, float]  # K_P, K_I, K_D
    base: Array  # M r: inertia force for a unit acceleration of the base
    probes: dict[int, Array] = field(default_factory=dict)  # node -> row on q
    path: CurrentPath = field(default_factory=CurrentPath)
    opening: Callable[[Array], Array] = switching

    @property
    def size(self) -> int:
        """Degrees of freedom."""
        return len(self.mass)

    def flexibility(self, node: int) -> float:
        """Return the static displacement [m/N] of the shaft at a node, without magnetic bearing."""
        dof = self.displacement[node]
        return float(np.linalg.inv(self.stiffness)[dof, dof].real)

    def grow(self) -> int:
        """Add a degree of freedom without mass or spring; return its index."""
        for name in ("mass", "damping", "stiffness", "gyroscopic"):
            setattr(self, name, np.pad(getattr(self, name), ((0, 1), (0, 1))))
        self.base = np.pad(self.base, (0, 1))
        self.probes = {node: np.pad(row, (0, 1)) for node, row in self.probes.items()}
        return self.size - 1


def jeffcott(parameters: dict[str, float], gains: tuple[float, float, float]) -> Plant:
    """Return the disc on a massless shaft, thesis eq. (2.26): one node."""
    one = np.ones((1, 1), complex)
    return Plant(
        mass=MASS * one,
        damping=parameters["c"] * one,
        stiffness=SHAFT_STIFFNESS * one,
        gyroscopic=0 * one,
        displacement={1: 0},
        tilt={},
        amb=1,
        disc=1,
        crack=1,
        ks=parameters["ks"],
        ki=parameters["ki"],
        gains=gains,
        base=MASS * one[0],
        probes={1: np.ones(1, complex)},
    )


def fe_rigid(parameters: dict[str, float], gains: tuple[float, float, float], elements: int = ELEMENTS) -> Plant:
    """Return the beam on pins with a disc, thesis Table 4-1; six nodes of the diagram on a finer mesh.

    D = a0 M_shaft + a1 K_shaft.   `elements` is a multiple of five.
    """
    shaft_mass, shaft_stiffness = beam(elements, 0.5, 0.016, 2.1e11, 7850.0)
    keep = np.setdiff1d(np.arange(2 * (elements + 1)), [0, 2 * elements])
    where = {int(old): new for new, old in enumerate(keep)}
    step = elements // 5
    displacement = {node: where[2 * step * (node - 1)] for node in range(2, 6)}
    tilt = {node: where[2 * step * (node - 1) + 1] for node in range(1, 7)}
    mass = shaft_mass[np.ix_(keep, keep)].astype(complex)
    stiffness = shaft_stiffness[np.ix_(keep, keep)].astype(complex)
    damping = MASS_DAMPING * mass + STIFFNESS_DAMPING * stiffness
    gyroscopic = np.zeros_like(mass)
    mass[displacement[3], displacement[3]] += MASS
    mass[tilt[3], tilt[3]] += DIAMETRAL
    gyroscopic[tilt[3], tilt[3]] = POLAR
    base = (shaft_mass @ np.tile([1.0, 0.0], elements + 1))[keep].astype(complex)
    base[displacement[3]] += MASS
    probes = {node: np.eye(len(mass), dtype=complex)[dof] for node, dof in displacement.items()}
    return Plant(
        mass=mass,
        damping=damping,
        stiffness=stiffness,
        gyroscopic=gyroscopic,
        displacement=displacement,
        tilt=tilt,
        amb=3,
        disc=3,
        crack=4,
        ks=parameters["ks"],
        ki=parameters["ki"],
        gains=gains,
        base=base,
        probes=probes,
    )


MACHINES: dict[str, Callable[..., Plant]] = {"jeffcott": jeffcott, "fe_rigid": fe_rigid}


class Core:
    """The closed loop as X' = A X + B inputs, y = C X, at one speed.

    X = (q, q', int z_s, states of the current path, free integrators). Inputs by name: `f3`, `m3` force and
    moment at node 3, `e`, `edot` what the controller's probe adds and its rate, `base` acceleration of the
    base, `aux0` the rate of the first free integrator. Outputs: `z3`, `v3` displacement and velocity at
    node 3, `p3` what the probe at node 3 sees, `command` and `i` the current before and behind the path, `aux0`.
    """

    def __init__(self, plant: Plant, speed: float, integrators: int = 0) -> None:
        self.plant, n, path = plant, plant.size, plant.path
        KP, KI, KD = plant.gains
        self.size = 2 * n + 1 + len(path.poles) + integrators
        self.path_at = 2 * n + 1
        self.aux_at = self.path_at + len(path.poles)
        inverse = np.linalg.inv(plant.mass)
        probe, amb = plant.probes[plant.amb], plant.displacement[plant.amb]
        self.at_amb = inverse[:, amb]
        self.inverse = inverse
        command = np.zeros(self.size, complex)
        command[:n], command[n : 2 * n], command[2 * n] = KP * probe, KD * probe, KI
        current = path.direct * command
        current[self.path_at : self.aux_at] += path.residues
        self.command, self.current = command, current
        A = np.zeros((self.size, self.size), complex)
        A[:n, n : 2 * n] = np.eye(n)
        A[n : 2 * n, :n] = -inverse @ plant.stiffness
        A[n : 2 * n, n : 2 * n] = -inverse @ (plant.damping - 1j * speed * plant.gyroscopic)
        A[n : 2 * n, amb] += self.at_amb * plant.ks
        A[n : 2 * n] -= plant.ki * np.outer(self.at_amb, current)
        A[2 * n, :n] = probe
        for j, pole in enumerate(path.poles):
            A[self.path_at + j] = command
            A[self.path_at + j, self.path_at + j] += pole
        self.A = A

    def column(self, name: str) -> Array:
        """Return the column of B of an input."""
        b, plant, n = np.zeros(self.size, complex), self.plant, self.plant.size
        KP, _, KD = plant.gains
        if name in ("e", "edot"):
            gain = KP if name == "e" else KD
            b[n : 2 * n] = -plant.ki * plant.path.direct * gain * self.at_amb
            b[self.path_at : self.aux_at] = gain
            b[2 * n] = 1.0 if name == "e" else 0.0
        elif name == "base":
            b[n : 2 * n] = -self.inverse @ plant.base
        elif name.startswith("aux"):
            b[self.aux_at + int(name[3:])] = 1.0
        else:
            dofs = plant.displacement if name[0] == "f" else plant.tilt
            b[n : 2 * n] = self.inverse[:, dofs[int(name[1:])]]
        return b

    def row(self, name: str) -> Array:
        """Return the row of C of an output."""
        c, plant, n = np.zeros(self.size, complex), self.plant, self.plant.size
        if name == "i":
            c += self.current
        elif name == "command":
            c += self.command
        elif name.startswith("aux"):
            c[self.aux_at + int(name[3:])] = 1.0
        elif name[0] == "p":
            c[:n] = plant.probes[int(name[1:])]
        else:
            c[plant.displacement[int(name[1:])] + (n if name[0] == "v" else 0)] = 1.0
        return c
