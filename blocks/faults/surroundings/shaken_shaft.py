"""Shaking of the ground under a whole shaft."""

from math import pi
from typing import Any

from rotorsim.blocks.common import beam, plane

from rotorsim.block import Block, Equations, Option, Out, Param, cos, matrix
from rotorsim.fault import Fault, Lines


def _nodes(option: Any) -> tuple[int, int]:
    return option.elements + 1, 2


class ShakenShaft(Block):
    """Give the inertia forces of a beam with discs on ground that shakes at a frequency of its own.

    f = -M r acceleration cos(frequency t + phase) [cos direction, sin direction]

    M: consistent mass of the beam (Euler-Bernoulli) and of its discs, r: one for every displacement. The motion is then
    that against the ground, as sensors on the stator see it.
    """

    source = "Friswell et al. (2010), ch. 6 (base movement)"
    faults = (
        Fault(
            physics="base_excitation",
            enters="shaft",
            free={"acceleration": (0.1,), "direction": (0.7,)},
            sizes=("acceleration",),
            fixed={"frequency": Lines()},
            inherits=(
                "elements",
                "disc_nodes",
                "element_length",
                "outer_diameter",
                "inner_diameter",
                "density",
                "disc_mass",
            ),
            law="a line at a frequency that does not follow speed, of forces as the mass is distributed",
            confused_with=("speed_fluctuation", "foundation_mode"),
            told_apart_by="the rotor at rest; an accelerometer on the ground; beating dies with the neighbour machine",
        ),
    )

    force = Out(shape=_nodes, unit="N", doc="forces on the rotor [node, xy]")
    moment = Out(shape=_nodes, unit="N m", doc="moments on the rotor, in the planes of x and y [node, xy]")
    elements = Option(5, kind=int, low=1, high=2000, doc="number of elements of the rotor")
    disc_nodes = Option([3], kind=int, low=1, doc="nodes that carry a disc")
    element_length = Param(0.1, shape=("elements",), unit="m", above=0.0, doc="length of each element, or of all")
    outer_diameter = Param(0.016, shape=("elements",), unit="m", above=0.0, doc="outer diameter of each element")
    inner_diameter = Param(0.0, shape=("elements",), unit="m", low=0.0, doc="inner diameter of each element")
    density = Param(7850.0, shape=("elements",), unit="kg/m^3", above=0.0, doc="density of the shaft")
    disc_mass = Param(2.0, shape=("disc_nodes",), unit="kg", low=0.0, doc="mass of each disc")
    acceleration = Param(0.1, unit="m/s^2", low=0.0, doc="amplitude of the acceleration of the ground")
    frequency = Param(2 * pi * 50, unit="rad/s", above=0.0, doc="frequency of the shaking")
    phase = Param(0.0, unit="rad", doc="phase at t = 0")
    direction = Param(0.0, unit="rad", doc="angle of the motion of the ground from the x axis")

    def equations(self, p, u, x, t):
        count = self.option.elements
        carried: list[Any] = [0.0] * (2 * count + 2)  # M r, node by node: mass, and its moment
        for e in range(count):
            length = beam.entry(p.element_length, e)
            outer, inner = (beam.entry(v, e) for v in (p.outer_diameter, p.inner_diameter))
            mass = beam.entry(p.density, e) * pi / 4 * (outer**2 - inner**2) * length
            for i, row in enumerate(beam.translation_mass(mass, length, 0.0)):
                carried[2 * e + i] += row[0] + row[2]
        for k, node in enumerate(self.option.disc_nodes):
            carried[2 * node - 2] += beam.entry(p.disc_mass, k)
        shaking = -p.acceleration * cos(p.frequency * t + p.phase) * plane.unit(p.direction)
        forces = [[load * shaking[axis] for axis in (0, 1)] for load in carried]
        return Equations(outputs={"force": matrix(forces[0::2]), "moment": matrix(forces[1::2])})
