"""Bow that a shaft has at rest."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault, Of


class ResidualBow(Block):
    """Give the force of a shaft that is bent when it is at rest.

    F = stiffness amplitude e^{i (theta + phase)},   z = x + i y

    The elastic force -K (q - b) of a shaft whose unloaded shape b turns with it, less the part -K q that the rotor has.
    Constant in speed, so it is there at slow roll, where the shaft runs out by `amplitude`.
    """

    source = "Nicholas, Gunter & Allaire, J. Eng. Power 98 (1976) 171-181; Friswell et al. (2010), ch. 6"
    faults = (
        Fault(
            physics="residual_bow",
            enters="force",
            free={"amplitude": (1e-6,), "phase": plane.ANGLES},
            most={"amplitude": Of("displacement", 1e3)},  # it moves the shaft by b / |1 - (W / w_n)^2|: W up to 30 w_n
            sizes=("amplitude",),
            inherits=("stiffness",),
            law="1X forward, force constant in speed, present at slow roll",
            confused_with=("runout", "parallel_misalignment", "thermal_bow"),
            told_apart_by="a probe at the disc, another set of gains, slow roll",
        ),
    )

    theta = In(unit="rad", doc="shaft angle")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    stiffness = Param(7.6e5, unit="N/m", low=0.0, doc="stiffness K of the shaft at the place")
    amplitude = Param(1e-6, unit="m", low=0.0, doc="size of the bow |b|")
    phase = Param(0.0, unit="rad", doc="angle of the bow against the phase reference")

    def equations(self, p, u, x, t):
        return Equations(outputs={"force": p.stiffness * p.amplitude * plane.unit(u.theta + p.phase)})
