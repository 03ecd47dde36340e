"""Jeffcott rotor."""

from rotorsim.block import Block, Equations, In, Out, Param, State


class Rotor2dof(Block):
    """Move a disc in the middle of a massless elastic shaft (Jeffcott rotor).

    mass u'' + viscous_damping u' + stiffness u = force,   u = [x, y]        thesis eq. (2.26)

    Displacements are counted from the static deflection, so that weight does not appear.
    """

    type_name = "rotor_2dof"
    source = "thesis eq. (2.21), (2.26)"

    force = In(shape=2, unit="N", additive=True, conjugate="displacement", doc="sum of the forces on the disc [x, y]")
    displacement = Out(shape=2, unit="m", doc="displacement [x, y]")
    velocity_port = Out(name="velocity", shape=2, unit="m/s", doc="velocity [x, y]")
    mass = Param(2.0, unit="kg", above=0.0, doc="mass of the disc")
    stiffness = Param(7.6e5, unit="N/m", doc="stiffness of the shaft")
    viscous_damping = Param(76.0, unit="N s/m", doc="viscous damping")
    initial_displacement = Param([0.0, 0.0], shape=2, unit="m", doc="displacement at t = 0")
    initial_velocity = Param([0.0, 0.0], shape=2, unit="m/s", doc="velocity at t = 0")
    position = State(shape=2, unit="m", init="initial_displacement", doc="displacement")
    velocity = State(shape=2, unit="m/s", init="initial_velocity", doc="velocity")

    def equations(self, p, u, x, t):
        acceleration = (u.force - p.viscous_damping * x.velocity - p.stiffness * x.position) / p.mass
        return Equations(
            outputs={"displacement": x.position, "velocity": x.velocity},
            derivatives={"position": x.velocity, "velocity": acceleration},
        )
