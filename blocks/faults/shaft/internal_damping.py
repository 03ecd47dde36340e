"""Damping in the material and the joints of a turning shaft."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class InternalDamping(Block):
    """Give the force of viscous damping that turns with the shaft.

    F = -damping (q' - i W q),   q = x + i y

    Nothing on a forward circular 1X orbit, in which the shaft keeps its shape; it damps backward whirl, and drives
    forward whirl slower than the shaft: above the critical speed a rotor with little other damping is unstable.
    """

    source = "A. L. Kimball, Gen. Electr. Rev. 27 (1924) 244-251; Friswell et al. (2010), ch. 7 (rotating damping)"
    faults = (
        Fault(
            physics="internal_damping",
            enters="force",
            free={"damping": (1.0,)},
            sizes=("damping",),
            law="no force on a forward circular 1X orbit; damps backward orders, drives forward ones below 1X",
            confused_with=("seal_cross_coupling", "viscous_damping"),
            told_apart_by="the sign of its loss for orders above and below 1X, and its growth with speed",
        ),
    )

    displacement = In(shape=2, unit="m", doc="displacement [x, y]")
    velocity = In(shape=2, unit="m/s", doc="velocity [x, y]")
    speed = In(unit="rad/s", doc="shaft speed W")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    damping = Param(20.0, unit="N s/m", low=0.0, doc="damping C_i in the frame of the shaft")

    def equations(self, p, u, x, t):
        turning = u.velocity - u.speed * plane.times_i(u.displacement)
        return Equations(outputs={"force": -p.damping * turning})
