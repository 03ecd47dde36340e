"""Rub of the rotor against the stator."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param, maximum, sign, vec
from rotorsim.fault import Fault, Of


class Rub(Block):
    """Give the force of a stator ring that the rotor touches beyond a gap.

    F = -(1 + i friction sgn v_t) stiffness (rho - gap)_+ q / rho,   q = x + i y - centre,   rho = |q|
    v_t = Im(conj(q) q') / rho + radius W        speed of the rotor's surface along that of the stator

    (a)_+ = a for a > 0, else 0. The stiffness jumps at contact, which is an event.
    """

    source = "F. F. Ehrich, Handbook of Rotordynamics (1992); Muszynska, Rotordynamics (2005), ch. 5"
    faults = (
        Fault(
            physics="rub",
            enters="force",
            free={
                "gap": (Of("displacement", 0.9), Of("displacement", 0.7), Of("displacement", 0.4)),
                "stiffness": (1e4, 3e5),
                "friction": (0.1,),
            },
            simpler={"friction": (0.0, "clearance")},
            law="none below a threshold in amplitude; above it every order and a mean force",
            confused_with=("clearance", "cubic_stiffness"),
            told_apart_by="amplitude: change the unbalance or the gains at one speed, and watch the threshold",
            told_apart_at_rest_by="amplitude: drive it harder and more softly, and watch the threshold",
        ),
    )

    displacement = In(shape=2, unit="m", doc="displacement [x, y] at the stator")
    velocity = In(shape=2, unit="m/s", doc="velocity [x, y] at the stator")
    speed = In(unit="rad/s", doc="shaft speed W")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    gap = Param(2e-5, unit="m", low=0.0, doc="gap c between rotor and stator")
    stiffness = Param(4e5, unit="N/m", low=0.0, doc="stiffness k_r of the stator")
    friction = Param(0.1, low=0.0, high=2.0, doc="coefficient of friction mu")
    radius = Param(8e-3, unit="m", low=0.0, doc="radius of the rotor at the stator")
    centre_x = Param(0.0, unit="m", doc="centre of the stator ring, x")
    centre_y = Param(0.0, unit="m", doc="centre of the stator ring, y")

    def equations(self, p, u, x, t):
        q = u.displacement - vec(p.centre_x, p.centre_y)
        rho = plane.length(q)
        normal = q / rho
        tangent = plane.times_i(normal)
        sliding = plane.along(u.velocity, tangent) + p.radius * u.speed
        press = p.stiffness * maximum(rho - p.gap, 0.0)
        return Equations(
            outputs={"force": -press * (normal + p.friction * sign(sliding) * tangent)},
            events={"contact": rho - p.gap, "sliding": sliding},
        )
