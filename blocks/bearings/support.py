"""Flexible support bearing."""

from rotorsim.block import Block, Equations, In, Out, Param


class Support(Block):
    """Give the force of a support bearing on the rotor, with its own stiffness and damping in x and y.

    f = -[k_x u_x + c_x u_x', k_y u_y + c_y u_y']        minus thesis eq. (5.1)
    """

    source = "thesis eq. (5.1), Table 5-1"

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] at the support")
    velocity = In(shape=2, unit="m/s", doc="rotor velocity [x, y] at the support")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    stiffness = Param([5e8, 5e8], shape=2, unit="N/m", low=0.0, series=True, doc="stiffness [x, y]")
    damping = Param([0.0, 0.0], shape=2, unit="N s/m", doc="viscous damping [x, y]")

    def equations(self, p, u, x, t):
        return Equations(outputs={"force": -(p.stiffness * u.displacement + p.damping * u.velocity)})
