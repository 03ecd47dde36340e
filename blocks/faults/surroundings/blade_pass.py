"""Force of blades that pass a stator."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Option, Out, Param
from rotorsim.fault import Fault


class BladePass(Block):
    """Give the force of blades that pass an obstacle.

    F = amplitude e^{i (N theta + phase)} + backward e^{-i (N theta + backward_phase)},   N = blades,   z = x + i y
    """

    source = "Brennen, Hydrodynamics of Pumps (1994), ch. 10; Childs, Turbomachinery Rotordynamics (1993)"
    faults = tuple(
        Fault(
            physics="blade_pass",
            enters="force",
            options={"blades": blades},
            free={"amplitude": (0.2,), "phase": plane.ANGLES, "backward": (0.2,), "backward_phase": (0.0,)},
            sizes=("amplitude", "backward"),
            law=f"orders {blades} and -{blades} alone, constant in speed",
            confused_with=("runout",),
            told_apart_by="load: the force follows the flow; the order is the number of blades",
        )
        for blades in range(3, 13)
    )

    theta = In(unit="rad", doc="shaft angle")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    blades = Option(4, kind=int, low=1, high=200, doc="number of blades N")
    amplitude = Param(0.2, unit="N", low=0.0, doc="size of the forward force")
    phase = Param(0.0, unit="rad", doc="angle of the forward force")
    backward = Param(0.0, unit="N", low=0.0, doc="size of the backward force")
    backward_phase = Param(0.0, unit="rad", doc="angle of the backward force, counted backward")

    def equations(self, p, u, x, t):
        angle = self.option.blades * u.theta
        force = p.amplitude * plane.unit(angle + p.phase)
        return Equations(outputs={"force": force + p.backward * plane.unit(-(angle + p.backward_phase))})
