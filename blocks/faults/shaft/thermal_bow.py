"""Bow of a shaft that grows as it warms up."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param, State
from rotorsim.fault import Fault, Longest, Of


class ThermalBow(Block):
    """Give the force of a shaft whose bow grows from the start of the run.

    F = stiffness b(t) e^{i theta},   b(t) = b_0 + b_1 (1 - e^{-t / time_constant}),   z = x + i y
    b_0 = amplitude e^{i phase},   b_1 = growth e^{i growth_phase}

    The growth is a state from 0 to 1: in the settled motion b is b_0 + b_1, as of a `residual_bow`.
    """

    source = "Kellenberger, J. Mech. Des. 102 (1980) 177-184; Friswell et al. (2010), ch. 6 (bent rotors)"
    faults = (
        Fault(
            physics="thermal_bow",
            enters="force",
            free={"growth": (1e-6,), "growth_phase": plane.ANGLES, "time_constant": (Longest(1.0), Longest(10.0))},
            most={"growth": Of("displacement", 1e3), "time_constant": Longest(30.0)},  # a longer one: no drift is seen
            sizes=("growth",),
            in_drift=("amplitude", "phase"),
            inherits=("stiffness",),
            law="the vector of 1X drifts at constant speed and comes to rest; force constant in speed",
            confused_with=("residual_bow", "unbalance_elsewhere"),
            told_apart_by="dwell at constant speed: loosening jumps, a warming shaft drifts and settles",
        ),
    )

    theta = In(unit="rad", doc="shaft angle")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    stiffness = Param(7.6e5, unit="N/m", low=0.0, doc="stiffness K of the shaft at the place")
    amplitude = Param(0.0, unit="m", low=0.0, doc="|b_0|")
    phase = Param(0.0, unit="rad", doc="angle of b_0")
    growth = Param(1e-6, unit="m", low=0.0, doc="|b_1|")
    growth_phase = Param(0.0, unit="rad", doc="angle of b_1")
    time_constant = Param(30.0, unit="s", above=0.0, doc="time constant tau of warming")
    grown = State(fresh=True, doc="1 - e^{-t / tau}")

    def equations(self, p, u, x, t):
        bow = p.amplitude * plane.unit(u.theta + p.phase)
        bow = bow + x.grown * p.growth * plane.unit(u.theta + p.growth_phase)
        return Equations(outputs={"force": p.stiffness * bow}, derivatives={"grown": (1 - x.grown) / p.time_constant})
