"""Crack that opens and closes with the deflection of the shaft."""

from typing import Any

from rotorsim.block import Block, Equations, In, Option, Out, Param, cos, sin, tanh, vec, where


class CrackBreathing(Block):
    """Give the force of a transverse crack whose opening follows the total deflection.

    xi = (u_x + sag_x) cos a + (u_y + sag_y) sin a,   a = theta + phase     deflection normal to the crack front
    f  = s(xi) stiffness xi [cos a, sin a]                                  thesis eq. (2.3), (2.16), (2.20)

    law "smooth":  s = (1 + tanh(xi / width)) / 2          law "hinge":  s = 1 for xi > 0, else 0

    With u = 0 and the hinge this is `crack` with opening "exact"; here the vibration takes part.
    """

    source = "thesis eq. (2.3), (2.20); Gasch (1993)"

    theta = In(unit="rad", doc="shaft angle")
    displacement = In(shape=2, unit="m", doc="vibration displacement [x, y] at the crack")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    opening = Out(doc="opening s: 1 open, 0 closed")
    law = Option("smooth", choices=("smooth", "hinge"), kind=str, doc="law of the opening")
    stiffness = Param(3e5, unit="N/m", doc="additive crack stiffness dk_22")
    sag = Param([2.6e-5, 0.0], shape=2, unit="m", doc="static deflection [x, y] at the crack")
    phase = Param(0.0, unit="rad", doc="angle of the crack against the phase reference")
    width = Param(2e-6, unit="m", above=0.0, doc="deflection over which the crack opens (law smooth)")

    def equations(self, p, u, x, t):
        a = u.theta + p.phase
        normal = vec(cos(a), sin(a))
        total = u.displacement + p.sag
        xi = total[0] * normal[0] + total[1] * normal[1]
        if self.option.law == "smooth":
            return self._of(0.5 * (1 + tanh(xi / p.width)), xi, normal, p, {})
        return self._of(where(xi > 0, 1.0, 0.0), xi, normal, p, {"contact": xi})

    @staticmethod
    def _of(s: Any, xi: Any, normal: Any, p: Any, events: dict[str, Any]) -> Equations:
        return Equations(outputs={"force": s * p.stiffness * xi * normal, "opening": s}, events=events)
