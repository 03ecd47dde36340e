"""Dry friction."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Option, Out, Param, tanh
from rotorsim.fault import Fault, Of

_LAW = "odd orders; damping that falls with the reciprocal of the amplitude, at every frequency alike"


class CoulombFriction(Block):
    """Give the force of dry friction on what moves in a line or in a plane.

    law "resultant":  F = -friction q' / |q'| tanh(|q'| / width) - offset
    law "axes":       F = -friction tanh(q' / width) - offset, entry by entry

    tanh stands for the jump of sgn: beyond 3 widths the force is within 0.5 % of dry friction. It has no stiction: at
    rest it is a damper of friction / width. offset: half of the difference between the frictions of the two directions.
    """

    source = "C. A. Coulomb (1785); Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083-1138"
    faults = Fault(
        physics="coulomb_friction",
        enters="force",
        options={"law": "resultant"},
        free={"friction": (0.002, 0.05, 1.0)},
        sizes=("friction",),
        fixed={"width": Of("velocity", 0.05, least=True)},  # narrow beside the slowest motion
        law=_LAW,
        confused_with=("hysteretic_damping", "viscous_damping"),
        told_apart_by="amplitude: change it at one speed, by unbalance or gains",
        told_apart_at_rest_by="amplitude: drive it harder and more softly",
    ).variants(
        {"options": {"law": "axes"}},
        {
            "options": {"law": "axes"},
            "free": {"friction": (0.002, 0.05, 1.0), "offset": (0.01,)},
            "sizes": ("friction", "offset"),
            "law": f"{_LAW}; another friction in each direction",
        },
    )

    velocity = In(shape="signal", unit="m/s", doc="velocity at the contact")
    force = Out(shape="signal", unit="N", doc="force on what moves")
    law = Option("resultant", choices=("resultant", "axes"), kind=str, doc="against the velocity, or in each axis")
    friction = Param(0.1, unit="N", low=0.0, doc="friction force F_c")
    width = Param(1e-5, unit="m/s", above=0.0, doc="velocity over which the force changes its sign")
    offset = Param(0.0, unit="N", doc="constant part, against each positive axis")

    def equations(self, p, u, x, t):
        if self.option.law == "axes":
            friction = p.friction * tanh(u.velocity / p.width)
        else:
            speed = plane.length(u.velocity)
            friction = p.friction * tanh(speed / p.width) / speed * u.velocity
        return Equations(outputs={"force": -friction - p.offset})
