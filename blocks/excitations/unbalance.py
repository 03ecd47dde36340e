"""Unbalance force of a disc."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param, cos, sin, vec
from rotorsim.fault import Fault, Of


class Unbalance(Block):
    """Give the rotating force of a mass eccentricity.

    f = mass eccentricity (W^2 [cos a, sin a] + W' [sin a, -cos a]),   a = theta + phase        thesis eq. (2.2), (4.6)

    The term with the angular acceleration W' is there where ``acceleration`` is wired; the thesis leaves it out.
    One block for each disc.
    """

    source = "thesis eq. (2.2), (4.6)"
    faults = (
        Fault(
            physics="unbalance_elsewhere",
            enters="force",
            free={"eccentricity": (5e-6,), "phase": plane.ANGLES},
            most={
                "eccentricity": Of("displacement", 1e3)
            },  # it moves the shaft by about e (W / w_n)^2: W from w_n / 30
            sizes=("eccentricity",),
            inherits=("mass",),
            law="1X forward, grows with the square of speed",
            confused_with=("moment_unbalance", "residual_bow", "runout"),
            told_apart_by="a trial weight at the place; two probes along the shaft",
        ),
    )

    theta = In(unit="rad", doc="shaft angle")
    speed = In(unit="rad/s", doc="shaft speed W")
    acceleration = In(unit="rad/s^2", optional=True, doc="angular acceleration W' of the shaft; unwired: zero")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    mass = Param(2.0, unit="kg", low=0.0, doc="mass of the disc")
    eccentricity = Param(24e-6, unit="m", low=0.0, doc="distance of the centre of mass from the shaft centre")
    phase = Param(0.5235987755982988, unit="rad", doc="angle of the unbalance against the phase reference")

    def equations(self, p, u, x, t):
        angle = u.theta + p.phase
        force = u.speed**2 * vec(cos(angle), sin(angle))
        if u.acceleration is not None:
            force = force + u.acceleration * vec(sin(angle), -cos(angle))
        return Equations(outputs={"force": p.mass * p.eccentricity * force})
