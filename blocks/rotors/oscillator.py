"""Oscillator of one degree of freedom."""

from rotorsim.block import Block, Equations, In, Out, Param, State


class Oscillator(Block):
    """Move a mass on a spring and a damper along one line, in any consistent units.

    mass q'' + damping q' + stiffness q = force

    Units are those that are wired or recorded: m and N of a machine, V of its electric analogue.
    """

    source = "S. Timoshenko, Vibration Problems in Engineering (1928), art. 1-9"

    force = In(unit=None, additive=True, conjugate="displacement", doc="sum of the forces on the mass")
    displacement = Out(unit=None, doc="displacement q of the mass")
    velocity_port = Out(name="velocity", unit=None, doc="velocity q' of the mass")
    mass = Param(1.0, unit=None, above=0.0, doc="mass")
    damping = Param(0.0, unit=None, low=0.0, doc="viscous damping")
    stiffness = Param(1.0, unit=None, low=0.0, doc="stiffness of the spring")
    position = State(unit=None, doc="displacement")
    velocity = State(unit=None, doc="velocity")

    def equations(self, p, u, x, t):
        acceleration = (u.force - p.damping * x.velocity - p.stiffness * x.position) / p.mass
        return Equations(
            outputs={"displacement": x.position, "velocity": x.velocity},
            derivatives={"position": x.velocity, "velocity": acceleration},
        )
