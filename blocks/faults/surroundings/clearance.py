"""Clearance in a bearing."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Option, Out, Param, cos, maximum, sum_of, where
from rotorsim.fault import Fault, Of

_LAW = "none below a threshold in amplitude; sub- and superharmonics above it; the critical speed falls"


class Clearance(Block):
    """Give the force of a spring that is met beyond a clearance.

    law "radial":    F = -stiffness (rho - gap)_+ q / rho,   rho = |q|        a ring, or two stops on a line
    law "bilinear":  F = -stiffness (q . n - gap)_+ n,   n = [cos direction, sin direction]        one stop

    (a)_+ = a for a > 0, else 0. On a line n is the sign of cos direction.
    """

    source = "Ehrich, Handbook of Rotordynamics (1992); Shaw & Holmes, J. Sound Vib. 90 (1983) 129-155 (bilinear)"
    faults = Fault(
        physics="clearance",
        enters="force",
        options={"law": "radial"},
        free={
            "gap": (Of("displacement", 0.9), Of("displacement", 0.7), Of("displacement", 0.4)),
            "stiffness": (1e4, 1e5),
        },
        law=_LAW,
        confused_with=("rub", "cubic_stiffness"),
        told_apart_by="amplitude: change the unbalance or the gains at one speed",
        told_apart_at_rest_by="amplitude: drive it harder and more softly",
    ).variants(
        {
            "options": {"law": "bilinear"},
            "free": {
                "gap": (Of("displacement", 0.4), Of("displacement", 0.05)),
                "stiffness": (1e5,),
                "direction": plane.ANGLES,
            },
            "law": f"{_LAW}; even orders and a mean force",
        }
    )

    displacement = In(shape="signal", unit="m", doc="displacement")
    force = Out(shape="signal", unit="N", doc="force on what moves")
    law = Option("radial", choices=("radial", "bilinear"), kind=str, doc="stops all round, or one")
    gap = Param(2e-5, unit="m", low=0.0, doc="clearance g")
    stiffness = Param(1e5, unit="N/m", low=0.0, doc="stiffness k beyond the clearance")
    direction = Param(0.0, unit="rad", doc="angle of the stop from the first axis (law bilinear)")

    def equations(self, p, u, x, t):
        q = u.displacement
        if self.option.law == "radial":
            depth = plane.length(q) - p.gap
            normal = q / plane.length(q)
        else:
            normal = where(cos(p.direction) > 0, 1.0, -1.0) if q.shape[0] == 1 else plane.unit(p.direction)
            depth = sum_of(q * normal) - p.gap
        return Equations(outputs={"force": -p.stiffness * maximum(depth, 0.0) * normal}, events={"contact": depth})
