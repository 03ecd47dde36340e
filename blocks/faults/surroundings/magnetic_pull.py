"""Unbalanced magnetic pull of an electric motor."""

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class MagneticPull(Block):
    """Give the force that pulls the rotor of a motor further off centre.

    F = stiffness q
    """

    source = "Smith & Dorrell, IEE Proc. Electr. Power Appl. 143 (1996) 193-201; Friswell et al. (2010), ch. 7"
    faults = (
        Fault(
            physics="magnetic_pull",
            enters="force",
            free={"stiffness": (1e3,)},
            sizes=("stiffness",),
            law="softens; no order of its own; alias of a stiffness",
            confused_with=("support_stiffness", "force_displacement_factor", "mass_error", "sensor_gain"),
            told_apart_by="the motor without current: run down with the supply cut",
        ),
    )

    displacement = In(shape="signal", unit="m", doc="displacement at the motor")
    force = Out(shape="signal", unit="N", doc="force on what moves")
    stiffness = Param(2e4, unit="N/m", low=0.0, doc="magnetic stiffness k_m; it pulls outwards")

    def equations(self, p, u, x, t):
        return Equations(outputs={"force": p.stiffness * u.displacement})
