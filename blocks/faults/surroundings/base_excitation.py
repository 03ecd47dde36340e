"""Shaking of the ground."""

from math import pi

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, Out, Param, cos
from rotorsim.fault import Fault, Lines


class BaseExcitation(Block):
    """Give the inertia force of a mass on ground that shakes at a frequency of its own.

    F = -mass acceleration cos(frequency t + phase) [cos direction, sin direction]

    The motion is then that against the ground, as sensors on the stator see it.
    """

    source = "Friswell et al. (2010), ch. 6 (base movement)"
    faults = (
        Fault(
            physics="base_excitation",
            enters="force",
            free={"acceleration": (0.1,), "direction": (0.7,)},
            sizes=("acceleration",),
            fixed={"frequency": Lines()},
            inherits=("mass",),
            law="a line at a frequency that does not follow speed",
            confused_with=("speed_fluctuation", "foundation_mode"),
            told_apart_by="the rotor at rest; an accelerometer on the ground; beating dies with the neighbour machine",
        ),
    )

    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    mass = Param(2.0, unit="kg", low=0.0, doc="mass M r that the ground carries along")
    acceleration = Param(0.1, unit="m/s^2", low=0.0, doc="amplitude of the acceleration a_b of the ground")
    frequency = Param(2 * pi * 50, unit="rad/s", above=0.0, doc="frequency of the shaking")
    phase = Param(0.0, unit="rad", doc="phase at t = 0")
    direction = Param(0.0, unit="rad", doc="angle of the motion of the ground from the x axis")

    def equations(self, p, u, x, t):
        shaking = p.acceleration * cos(p.frequency * t + p.phase)
        return Equations(outputs={"force": -p.mass * shaking * plane.unit(p.direction)})
