"""Mass between a bearing and its foundation."""

from rotorsim.block import Block, Equations, In, Out, Param, State, vec


class SupportMass(Block):
    """Move the mass of a bearing housing or pedestal, which only forces hold: wire bearings on both of its sides.

    m_x u_x'' = sum f_x,   m_y u_y'' = sum f_y
    """

    source = "Friswell et al. (2010), sec. 5.5.4 (flexible bearing supports)"

    force = In(shape=2, unit="N", additive=True, conjugate="displacement", doc="sum of the forces on the mass [x, y]")
    displacement = Out(shape=2, unit="m", doc="displacement [x, y]")
    velocity_port = Out(name="velocity", shape=2, unit="m/s", doc="velocity [x, y]")
    mass = Param([10.0, 10.0], shape=2, unit="kg", above=0.0, doc="mass that moves in x and in y")
    position = State(shape=2, unit="m", doc="displacement")
    velocity = State(shape=2, unit="m/s", doc="velocity")

    def equations(self, p, u, x, t):
        acceleration = vec(u.force[0] / p.mass[0], u.force[1] / p.mass[1])
        return Equations(
            outputs={"displacement": x.position, "velocity": x.velocity},
            derivatives={"position": x.velocity, "velocity": acceleration},
        )
