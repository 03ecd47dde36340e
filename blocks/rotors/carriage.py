"""Carriage on a guide."""

from rotorsim.block import Block, Equations, In, Out, Param, State


class Carriage(Block):
    """Move a carriage along a guide; nothing but its drive returns it.

    mass q'' + viscous_friction q' = force
    """

    source = "Janot, Gautier & Brunot, EMPS, Workshop on Nonlinear System Identification Benchmarks (2019)"

    force = In(unit="N", additive=True, conjugate="displacement", doc="sum of the forces on the carriage")
    displacement = Out(unit="m", doc="position q of the carriage")
    velocity_port = Out(name="velocity", unit="m/s", doc="velocity q' of the carriage")
    mass = Param(100.0, unit="kg", above=0.0, doc="mass, with what turns in the drive (motor, screw) reduced to it")
    viscous_friction = Param(0.0, unit="N s/m", low=0.0, doc="friction proportional to velocity")
    position = State(unit="m", doc="position")
    velocity = State(unit="m/s", doc="velocity")

    def equations(self, p, u, x, t):
        return Equations(
            outputs={"displacement": x.position, "velocity": x.velocity},
            derivatives={"position": x.velocity, "velocity": (u.force - p.viscous_friction * x.velocity) / p.mass},
        )
