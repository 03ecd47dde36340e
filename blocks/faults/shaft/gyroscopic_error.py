"""Error of the gyroscopic moment."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class GyroscopicError(Block):
    """Give the gyroscopic moment of a polar inertia that a model leaves out.

    M = i W inertia a',   a = a_1 + i a_2 the tilt in the planes of x and y
    """

    source = "Friswell et al. (2010), sec. 3.6 (sign: forward modes rise)"
    faults = (
        Fault(
            physics="gyroscopic_error",
            enters="force",
            free={"inertia": (1e-4,)},
            sizes=("inertia",),
            law="splits forward and backward whirl, in proportion to speed",
            confused_with=("moment_unbalance", "seal_cross_coupling"),
            told_apart_by="modes against speed (Campbell diagram)",
        ),
    )

    tilt_velocity = In(shape=2, unit="rad/s", doc="rate of tilt in the planes of x and y")
    speed = In(unit="rad/s", doc="shaft speed W")
    moment = Out(shape=2, unit="N m", doc="moment on the rotor, in the planes of x and y")
    inertia = Param(5e-4, unit="kg m^2", doc="dG, polar inertia beyond that of the model")

    def equations(self, p, u, x, t):
        return Equations(outputs={"moment": u.speed * p.inertia * plane.times_i(u.tilt_velocity)})
