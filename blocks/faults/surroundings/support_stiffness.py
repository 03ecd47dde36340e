"""Stiffness and damping that a model leaves out."""

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class SupportStiffness(Block):
    """Give the force of a spring and a damper, the same in each axis.

    F = -stiffness q - damping q'
    """

    source = "Friswell et al. (2010), ch. 5 (bearings)"
    faults = Fault(
        physics="support_stiffness",
        enters="force",
        free={"stiffness": (1e3,)},
        sizes=("stiffness",),
        law="shifts the critical speed; no order of its own",
        confused_with=(
            "force_displacement_factor",
            "force_current_factor",
            "sensor_gain",
            "magnetic_pull",
            "mass_error",
        ),
        told_apart_by="another set of gains; a known mass added to the rotor",
    ).variants(
        {
            "free": {"stiffness": (1e3,), "damping": (1.0,)},
            "sizes": ("stiffness", "damping"),
            "law": "shifts and damps the critical speed; no order of its own",
            "confused_with": (
                "force_displacement_factor",
                "force_current_factor",
                "sensor_gain",
                "magnetic_pull",
                "mass_error",
                "viscous_damping",
            ),
        }
    )

    displacement = In(shape="signal", unit="m", doc="displacement at the support")
    velocity = In(shape="signal", unit="m/s", doc="velocity at the support")
    force = Out(shape="signal", unit="N", doc="force on what moves")
    stiffness = Param(5e4, unit="N/m", doc="dk; negative: the support is softer than stated")
    damping = Param(0.0, unit="N s/m", doc="dc")

    def equations(self, p, u, x, t):
        return Equations(outputs={"force": -p.stiffness * u.displacement - p.damping * u.velocity})
