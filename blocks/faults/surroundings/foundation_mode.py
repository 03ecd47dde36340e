"""Foundation that moves under a bearing."""

from math import pi

from rotorsim.block import Block, Equations, In, Out, Param, State
from rotorsim.fault import Fault


class FoundationMode(Block):
    """Give the force of a bearing on a mass, spring and damper, less that of the same bearing on rigid ground.

    mass w'' + 2 damping_ratio frequency mass w' + frequency^2 mass w = bearing_stiffness (q - w)
    F = -bearing_stiffness (q - w) + bearing_stiffness q = bearing_stiffness w

    w: displacement of the foundation, entry by entry. The model has the bearing -bearing_stiffness q already. The rotor
    sees an extra peak near sqrt(frequency^2 + bearing_stiffness / mass); only bearing_stiffness^2 / mass is found, not
    both.
    """

    source = "Friswell et al. (2010), ch. 6 (foundations); ISO 10814"
    faults = (
        Fault(
            physics="foundation_mode",
            enters="force",
            free={
                "mass": (20.0, 3000.0),
                "frequency": (2 * pi * 20, 2 * pi * 35, 2 * pi * 60, 2 * pi * 100, 2 * pi * 150),
                "damping_ratio": (0.03,),
            },
            law="an extra peak in a band of speed, at every order that passes it",
            confused_with=("breathing_crack", "support_stiffness"),
            told_apart_by="a probe or an accelerometer on the foundation; a run-up through the band",
        ),
    )

    displacement = In(shape="signal", unit="m", doc="displacement of the rotor at the bearing")
    force = Out(shape="signal", unit="N", doc="force on the rotor")
    bearing_stiffness = Param(4e5, unit="N/m", above=0.0, doc="stiffness k_b between rotor and foundation")
    mass = Param(20.0, unit="kg", above=0.0, doc="mass of the foundation")
    frequency = Param(2 * pi * 60, unit="rad/s", above=0.0, doc="natural frequency of the foundation alone")
    damping_ratio = Param(0.03, low=0.0, high=1.0, doc="damping ratio of the foundation alone")
    position = State(shape="signal", unit="m", doc="displacement w of the foundation")
    velocity = State(shape="signal", unit="m/s", doc="its rate")

    def equations(self, p, u, x, t):
        push = p.bearing_stiffness * (u.displacement - x.position)
        own = 2 * p.damping_ratio * p.frequency * x.velocity + p.frequency**2 * x.position
        return Equations(
            outputs={"force": p.bearing_stiffness * x.position},
            derivatives={"position": x.velocity, "velocity": push / p.mass - own},
        )
