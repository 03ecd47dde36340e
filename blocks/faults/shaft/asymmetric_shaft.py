"""Shaft with two different stiffnesses in bending."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param, vec
from rotorsim.fault import Fault


class AsymmetricShaft(Block):
    """Give the force of the difference between the two bending stiffnesses of a shaft (keyway, flats).

    F = -asymmetry e^{2 i (theta + phase)} conj(q + sag),   asymmetry = dK_a = (k_xi - k_eta) / 2,   q = x + i y

    k_xi: stiffness along the axis of the shaft that is at the angle theta + phase. The sag gives 2X, the motion R_1
    gives 1X from its conjugate.
    """

    source = "Friswell et al. (2010), ch. 7 (asymmetric rotors); Tondl, Some Problems of Rotor Dynamics (1965)"
    faults = (
        Fault(
            physics="asymmetric_shaft",
            enters="force",
            free={"asymmetry": (1e2,), "phase": (0.0, 1.05, -1.05)},
            sizes=("asymmetry",),
            inherits=("crack.sag",),
            law="2X from the sag, 1X from the conjugate of 1X; k from the conjugate of 2 - k",
            confused_with=("open_crack", "parallel_misalignment"),
            told_apart_by="location: a crack acts at one place, a keyway along the shaft; another set-point",
        ),
    )

    displacement = In(shape=2, unit="m", doc="displacement [x, y]")
    theta = In(unit="rad", doc="shaft angle")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    asymmetry = Param(1e4, unit="N/m", low=0.0, doc="dK_a, half of the difference of the stiffnesses")
    phase = Param(0.0, unit="rad", doc="angle of the stiffer axis against the phase reference")
    sag = Param(2.6e-5, unit="m", doc="static deflection, along x")

    def equations(self, p, u, x, t):
        total = u.displacement + vec(p.sag, 0)
        return Equations(
            outputs={"force": -p.asymmetry * plane.turned(plane.conjugate(total), 2 * (u.theta + p.phase))}
        )
