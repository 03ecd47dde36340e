"""Parallel misalignment of a coupling."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class ParallelMisalignment(Block):
    """Give the force of a coupling whose shafts are parallel but not in line.

    F = F_1 e^{i theta} + F_2 e^{2 i theta} + F_-2 e^{-2 i theta} + F_0,   z = x + i y
    F_k = amplitude_k e^{i phase_k},   F_-2 = backward2 e^{i backward_phase2}        all constant in speed
    """

    source = "Sekhar & Prabhu, J. Sound Vib. 185 (1995) 655-671; Lal & Tiwari, Mech. Mach. Theory 54 (2012)"
    faults = Fault(
        physics="parallel_misalignment",
        enters="force",
        free={"amplitude2": (0.5,), "phase2": plane.ANGLES},
        sizes=("amplitude2",),
        law="2X forward, force constant in speed",
        confused_with=("breathing_crack", "open_crack", "asymmetric_shaft", "residual_bow", "angular_misalignment"),
        told_apart_by="change the sag (another set-point): a crack and a keyway scale with it, "
        "a misaligned coupling does not",
    ).variants(
        {
            "free": {
                "amplitude2": (0.5,),
                "phase2": plane.ANGLES,
                "backward2": (0.2,),
                "backward_phase2": plane.ANGLES,
            },
            "sizes": ("amplitude2", "backward2"),
            "law": "2X forward and backward, forces constant in speed",
        },
        {
            "free": {
                "amplitude1": (0.5,),
                "phase1": plane.ANGLES,
                "amplitude2": (0.5,),
                "phase2": plane.ANGLES,
                "backward2": (0.2,),
                "backward_phase2": (0.0,),
                "amplitude0": (0.2,),
                "phase0": (0.0,),
            },
            "sizes": ("amplitude1", "amplitude2", "backward2", "amplitude0"),
            "law": "orders 1 and 2 and a mean force, constant in speed",
        },
    )

    theta = In(unit="rad", doc="shaft angle")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    amplitude1 = Param(0.0, unit="N", low=0.0, doc="|F_1|")
    phase1 = Param(0.0, unit="rad", doc="angle of F_1")
    amplitude2 = Param(1.0, unit="N", low=0.0, doc="|F_2|")
    phase2 = Param(0.0, unit="rad", doc="angle of F_2")
    backward2 = Param(0.0, unit="N", low=0.0, doc="|F_-2|")
    backward_phase2 = Param(0.0, unit="rad", doc="angle of F_-2")
    amplitude0 = Param(0.0, unit="N", low=0.0, doc="|F_0|")
    phase0 = Param(0.0, unit="rad", doc="angle of F_0 from the x axis")

    def equations(self, p, u, x, t):
        force = p.amplitude1 * plane.unit(u.theta + p.phase1)
        force = force + p.amplitude2 * plane.unit(2 * u.theta + p.phase2)
        force = force + p.backward2 * plane.unit(-2 * u.theta + p.backward_phase2)
        return Equations(outputs={"force": force + p.amplitude0 * plane.unit(p.phase0)})
