"""Angular misalignment of a coupling."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class AngularMisalignment(Block):
    """Give the moment of a coupling whose shafts meet at an angle.

    M = M_1 e^{i theta} + M_2 e^{2 i theta},   M_k = amplitude_k e^{i phase_k}        constant in speed
    """

    source = "Sekhar & Prabhu, J. Sound Vib. 185 (1995) 655-671"
    faults = Fault(
        physics="angular_misalignment",
        enters="force",
        free={"amplitude2": (0.02,), "phase2": plane.ANGLES},
        sizes=("amplitude2",),
        law="2X forward on the tilt, moment constant in speed",
        confused_with=("parallel_misalignment", "moment_unbalance", "breathing_crack"),
        told_apart_by="the ratio of tilt to displacement: two probes along the shaft",
    ).variants(
        {
            "free": {"amplitude1": (0.02,), "phase1": plane.ANGLES, "amplitude2": (0.02,), "phase2": plane.ANGLES},
            "sizes": ("amplitude1", "amplitude2"),
            "law": "1X and 2X forward on the tilt, moments constant in speed",
        }
    )

    theta = In(unit="rad", doc="shaft angle")
    moment = Out(shape=2, unit="N m", doc="moment on the rotor, in the planes of x and y")
    amplitude1 = Param(0.0, unit="N m", low=0.0, doc="|M_1|")
    phase1 = Param(0.0, unit="rad", doc="angle of M_1")
    amplitude2 = Param(0.05, unit="N m", low=0.0, doc="|M_2|")
    phase2 = Param(0.0, unit="rad", doc="angle of M_2")

    def equations(self, p, u, x, t):
        first = p.amplitude1 * plane.unit(u.theta + p.phase1)
        return Equations(outputs={"moment": first + p.amplitude2 * plane.unit(2 * u.theta + p.phase2)})
