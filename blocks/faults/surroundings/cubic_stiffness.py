"""Stiffness that grows with the square of the displacement."""

from rotorsim.block import Block, Equations, In, Out, Param, sum_of, vec
from rotorsim.fault import Fault, Of

_STARTS = tuple(Of("displacement", newton, power=-3) for newton in (0.01, 1.0))  # force at the largest motion


class CubicStiffness(Block):
    """Give the force of a spring whose stiffness grows with the square of the displacement (Duffing).

    F = -stiffness |q|^2 q

    With an offset of the neutral point, along the first axis (that of the weight), the force at rest is left out:
    F = -stiffness (|r|^2 r - |o|^2 o),   r = q + o,   o = [offset, 0, ...]
    """

    source = "G. Duffing, Erzwungene Schwingungen, Vieweg 1918; Ehrich, Handbook of Rotordynamics (1992)"
    faults = Fault(
        physics="cubic_stiffness",
        enters="force",
        free={"stiffness": _STARTS},
        law="0, -1, 2 and 3X with a sag or an orbit that is not circular; grows with the cube of the amplitude",
        confused_with=("anisotropic_support", "clearance", "magnetic_nonlinearity"),
        told_apart_by="amplitude: the natural frequency moves with its square",
    ).variants({"free": {"stiffness": _STARTS, "offset": (Of("displacement", 0.3), Of("displacement", -0.3))}})

    displacement = In(shape="signal", unit="m", doc="displacement")
    force = Out(shape="signal", unit="N", doc="force on what moves")
    stiffness = Param(1e13, unit="N/m^3", doc="cubic stiffness k_3; negative: softening")
    offset = Param(0.0, unit="m", doc="displacement of the rest position from the neutral point, first axis")

    def equations(self, p, u, x, t):
        neutral = vec(p.offset, *[0] * (u.displacement.shape[0] - 1))
        r = u.displacement + neutral
        return Equations(outputs={"force": -p.stiffness * (sum_of(r**2) * r - p.offset**2 * neutral)})
