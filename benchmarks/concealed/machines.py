"""The machines, with the numbers that whoever has the diagrams knows, and their free parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.machine_fe import beam
from benchmarks.concealed.plant import Bearing, Crack, Gains, Plant, Unbalance

Array = NDArray[Any]
Parameters = dict[str, float]

MASS, SHAFT_STIFFNESS, SAG = 2.0, 7.6e5, 26e-6  # Table 2-1
POLAR, DIAMETRAL = 0.0045, 0.0024  # Table 4-1
MASS_DAMPING, STIFFNESS_DAMPING = 0.154, 1e-5
YOUNG, DENSITY = 2.1e11, 7850.0
PARTS = 3  # beams for each element of a diagram
SUPPORT_DAMPING = 500.0

FREE: dict[str, dict[str, float | None]] = {  # nominal values; None: any angle
    "jeffcott": {"c": 76.0, "e": 24e-6, "dk": 3e5, "ks": 105210.0, "ki": 42.1, "beta": None, "crack_phase": None},
    "fe_flexible": {
        "crack_stiffness": 3e5,
        "crack_phase": None,
        "eccentricity1": 24e-6,
        "unbalance_phase1": None,
        "eccentricity2": 58e-6,
        "unbalance_phase2": None,
        "force_displacement_factor": 105210.0,
        "force_current_factor": 42.1,
        "support_left.stiffness[1]": 495.82e6,
        "support_left.stiffness[2]": 950.13e6,
        "support_right.stiffness[1]": 355.82e6,
        "support_right.stiffness[2]": 805.82e6,
    },
    "two_amb_rotor": {
        "crack_stiffness": 3e5,
        "crack_phase": None,
        "eccentricity1": 12e-6,
        "unbalance_phase1": None,
        "eccentricity2": 18e-6,
        "unbalance_phase2": None,
        "force_displacement_factor_a": 105210.0,
        "force_current_factor_a": 42.1,
        "force_displacement_factor_b": 84000.0,
        "force_current_factor_b": 36.0,
    },
}
PLAIN: Gains = (12200.0, 2000.0, 3.0)  # Table 2-1
GAINS: dict[str, tuple[Gains, ...]] = {  # of each bearing, as the diagrams have them
    "jeffcott": (PLAIN,),
    "fe_rigid": (PLAIN,),
    "fe_flexible": (PLAIN,),
    "two_amb_rotor": ((12200.0, 2000.0, 6.0),) * 2,
}
DRAWN = FREE | {"fe_rigid": FREE["jeffcott"]}  # with c, which the beam does not have
FREE["fe_rigid"] = {name: value for name, value in FREE["jeffcott"].items() if name != "c"}


def jeffcott(parameters: Parameters, gains: tuple[Gains, ...]) -> Plant:
    """Return the disc on a massless shaft, thesis eq. (2.26): one node."""
    one = np.ones((1, 1), complex)
    return Plant(
        mass=MASS * one,
        damping=parameters["c"] * one,
        stiffness=SHAFT_STIFFNESS * one,
        gyroscopic=0 * one,
        displacement={1: 0},
        tilt={},
        bearings=[Bearing(1, 1, parameters["ks"], parameters["ki"], gains[0])],
        unbalances=[Unbalance(1, MASS, parameters["e"], parameters["beta"])],
        crack=Crack(1, parameters["dk"], parameters["crack_phase"], SAG),
        base=MASS * one[0],
        probes={1: np.ones(1, complex)},
    )


@dataclass(frozen=True)
class Disc:
    """A rigid disc at a node."""

    node: int
    mass: float
    polar: float
    diametral: float


@dataclass(frozen=True)
class Shaft:
    """A shaft of beam elements with discs, pins, and probes at nodes."""

    lengths: tuple[float, ...]
    outer: tuple[float, ...]
    inner: tuple[float, ...]
    discs: tuple[Disc, ...]
    probes: tuple[int, ...]
    pins: tuple[int, ...] = ()

    def assembled(self, parts: int) -> dict[str, Any]:
        """Return matrices, nodes and probes of a plant; each element is made of `parts` beams.

        D = a0 M_shaft + a1 K_shaft
        """
        shaft_mass, shaft_stiffness = beam(self.lengths, self.outer, self.inner, YOUNG, DENSITY, parts)
        place = {node: 2 * parts * (node - 1) for node in range(1, len(self.lengths) + 2)}
        keep = np.setdiff1d(np.arange(len(shaft_mass)), [place[node] for node in self.pins])
        where = {int(old): new for new, old in enumerate(keep)}
        displacement = {node: where[at] for node, at in place.items() if node not in self.pins}
        tilt = {node: where[at + 1] for node, at in place.items()}
        mass = shaft_mass[np.ix_(keep, keep)].astype(complex)
        stiffness = shaft_stiffness[np.ix_(keep, keep)].astype(complex)
        damping = MASS_DAMPING * mass + STIFFNESS_DAMPING * stiffness
        gyroscopic = np.zeros_like(mass)
        base = (shaft_mass @ np.tile([1.0, 0.0], len(shaft_mass) // 2))[keep].astype(complex)
        for disc in self.discs:
            mass[displacement[disc.node], displacement[disc.node]] += disc.mass
            mass[tilt[disc.node], tilt[disc.node]] += disc.diametral
            gyroscopic[tilt[disc.node], tilt[disc.node]] = disc.polar
            base[displacement[disc.node]] += disc.mass
        return {
            "mass": mass,
            "damping": damping,
            "stiffness": stiffness,
            "gyroscopic": gyroscopic,
            "displacement": displacement,
            "tilt": tilt,
            "base": base,
            "probes": {node: np.eye(len(mass), dtype=complex)[displacement[node]] for node in self.probes},
        }


RIGID = Shaft((0.1,) * 5, (0.016,) * 5, (0.0,) * 5, (Disc(3, MASS, POLAR, DIAMETRAL),), (2, 3, 4, 5), (1, 6))
FLEXIBLE = replace(RIGID, discs=(Disc(2, MASS, POLAR, DIAMETRAL), Disc(5, 1.5, 0.0034, 0.0018)), pins=())
STEPPED = Shaft(
    lengths=(0.06, 0.015, 0.125, 0.15, 0.14, 0.12, 0.015, 0.075),
    outer=(0.02, 0.024, 0.024, 0.028, 0.028, 0.024, 0.024, 0.02),
    inner=(0.0, 0.0, 0.0, 0.016, 0.016, 0.0, 0.0, 0.0),
    discs=(Disc(4, MASS, POLAR, DIAMETRAL), Disc(6, 1.5, 0.0034, 0.0018)),
    probes=(3, 4, 5, 6, 7),
)


def fe_rigid(parameters: Parameters, gains: tuple[Gains, ...], parts: int = PARTS) -> Plant:
    """Return the beam on pins with a disc, thesis Table 4-1; six nodes of the diagram on a finer mesh."""
    return Plant(
        bearings=[Bearing(3, 3, parameters["ks"], parameters["ki"], gains[0])],
        unbalances=[Unbalance(3, MASS, parameters["e"], parameters["beta"])],
        crack=Crack(4, parameters["dk"], parameters["crack_phase"], SAG),
        **RIGID.assembled(parts),
    )


def _two_discs(p: Parameters, shaft: Shaft) -> list[Unbalance]:
    """Return the unbalances of the discs of a shaft."""
    return [
        Unbalance(disc.node, disc.mass, p[f"eccentricity{k}"], p[f"unbalance_phase{k}"], f"unbalance{k}")
        for k, disc in enumerate(shaft.discs, 1)
    ]


def fe_flexible(parameters: Parameters, gains: tuple[Gains, ...], parts: int = PARTS) -> Plant:
    """Return the beam with two discs on supports that differ in x and y, thesis Table 5-1.

    f = -[k_x x, k_y y] = -(k_x + k_y) / 2 q - (k_x - k_y) / 2 conj(q), and the same of the damping
    """
    p = parameters
    plant = Plant(
        bearings=[Bearing(3, 3, p["force_displacement_factor"], p["force_current_factor"], gains[0])],
        unbalances=_two_discs(p, FLEXIBLE),
        crack=Crack(4, p["crack_stiffness"], p["crack_phase"], 31e-6),
        stiff=True,
        supports=(1, 6),
        **FLEXIBLE.assembled(parts),
    )
    plant.stiffness_conj, plant.damping_conj = np.zeros_like(plant.stiffness), np.zeros_like(plant.damping)
    for node, side in zip(plant.supports, ("left", "right"), strict=True):
        dof = plant.displacement[node]
        kx, ky = (p[f"support_{side}.stiffness[{axis}]"] for axis in (1, 2))
        plant.stiffness[dof, dof] += (kx + ky) / 2
        plant.stiffness_conj[dof, dof] += (kx - ky) / 2
        plant.damping[dof, dof] += SUPPORT_DAMPING
    return plant


def two_amb_rotor(parameters: Parameters, gains: tuple[Gains, ...], parts: int = PARTS) -> Plant:
    """Return the stepped shaft, hollow in the middle, that floats in two bearings with probes 15 mm inside of them."""
    p = parameters
    bearings = [
        Bearing(
            node,
            probe,
            p[f"force_displacement_factor_{end}"],
            p[f"force_current_factor_{end}"],
            own,
            mark=mark,
            amb=f"amb_{end}",
            controller=f"controller_{end}",
        )
        for node, probe, own, end, mark in zip((2, 8), (3, 7), gains, "ab", ("", "2"), strict=True)
    ]
    return Plant(
        bearings=bearings,
        unbalances=_two_discs(p, STEPPED),
        crack=Crack(5, p["crack_stiffness"], p["crack_phase"], 23e-6),
        stiff=True,
        floating=True,
        **STEPPED.assembled(parts),
    )


MACHINES: dict[str, Callable[..., Plant]] = {
    "jeffcott": jeffcott,
    "fe_rigid": fe_rigid,
    "fe_flexible": fe_flexible,
    "two_amb_rotor": two_amb_rotor,
}


def nominal_parameters(machine: str) -> Parameters:
    """Return the nominal numbers of a machine, all angles zero."""
    return {name: value or 0.0 for name, value in DRAWN[machine].items()}


def nominal(machine: str) -> Plant:
    """Return a machine with nominal numbers and the gains of the diagram."""
    return MACHINES[machine](nominal_parameters(machine), GAINS[machine])
