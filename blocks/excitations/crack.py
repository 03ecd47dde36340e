"""Crack force of a rotor whose weight opens and closes the crack."""

import numpy as np
from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Option, Out, Param, cos, rows, sin, vec, where
from rotorsim.fault import Fault


class Crack(Block):
    """Give the force of a transverse crack that opens and closes with the shaft angle (weight dominance).

    f = 1/2 s(a) stiffness sag [1 + cos 2a, sin 2a],   a = theta + phase        thesis eq. (2.22)

    opening "switching":  s = 1/2 + (2/pi) (cos a - cos 3a / 3 + cos 5a / 5 - ...), `terms` cosines    (2.11)
    opening "exact":      s = 1 for cos a > 0, else 0: the square wave that the series approximates
    opening "breathing":  s = (1 + cos a) / 2, Mayes                                                   (2.12)
    opening "open":       s = 1
    opening "harmonics":  s = mean + sum of cosines[k] cos ka + sines[k] sin ka, k = 1, 2, ...

    moment: the same with tilt_stiffness and tilt_sag, eq. (3.18). theta is the angle from the inertial x
    axis to the normal of the crack front.
    """

    source = "thesis eq. (2.11), (2.12), (2.22), (3.18); Gasch (1993); Mayes & Davies (1984)"
    faults = (
        Fault(
            physics="breathing_crack",
            enters="replace",
            of=("crack",),
            options={"opening": "breathing"},
            law="weights 1/4 at orders 0, 1, 2 and 1/8 at -1, 3; none at -3, 5",
            confused_with=("runout", "anisotropic_support"),
            told_apart_by="the ratio of 3X to 1X; -3X and 5X, which only a switching crack has",
        ),
        Fault(
            physics="open_crack",
            enters="replace",
            of=("crack",),
            options={"opening": "open"},
            law="orders 0 and 2 forward only",
            confused_with=("asymmetric_shaft", "parallel_misalignment"),
            told_apart_by="location: a keyway acts along the whole shaft",
        ),
        Fault(
            physics="crack_location",
            enters="move",
            of=("crack",),
            law="the same harmonics with another law of speed; strength follows the static curvature of the shaft",
            confused_with=("second_crack",),
            told_apart_by="motion at several nodes over several speeds",
        ),
        Fault(
            physics="second_crack",
            # opposite to the first and as deep: one that is always open; where the first has no depth: it has moved
            holds=("open_crack", "crack_location"),
            enters="force",
            options={"opening": "switching"},
            free={"stiffness": (1e5,), "phase": plane.ANGLES},
            sizes=("stiffness",),
            inherits=("crack.sag",),
            law="the harmonics of a crack at another angle: phases between harmonics drift, 2X may cancel",
            confused_with=("crack_location",),
            told_apart_by="motion at several nodes over several speeds",
        ),
    )

    theta = In(unit="rad", doc="shaft angle")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    moment = Out(shape=2, unit="N m", doc="moment on the rotor, in the planes of x and y")
    opening_port = Out(name="opening", doc="opening function s: 1 open, 0 closed")
    opening = Option(
        "switching", choices=("switching", "exact", "breathing", "open", "harmonics"), kind=str, doc="law of s"
    )
    terms = Option(5, kind=int, low=1, high=50, doc="cosines of the switching series")
    stiffness = Param(3e5, unit="N/m", doc="additive crack stiffness dk_22")
    sag = Param(2.6e-5, unit="m", doc="static deflection delta_x at the crack")
    phase = Param(0.0, unit="rad", doc="angle of the crack against the phase reference")
    tilt_stiffness = Param(0.0, unit="N m/rad", doc="additive crack stiffness in tilt dk_44")
    tilt_sag = Param(0.0, unit="rad", doc="static slope at the crack")
    mean = Param(0.5, doc="mean of s for opening harmonics")
    cosines = Param([0.5], shape="orders", doc="cosine coefficients of s for opening harmonics")
    sines = Param([0.0], shape="orders", doc="sine coefficients of s for opening harmonics")

    def equations(self, p, u, x, t):
        a = u.theta + p.phase
        events = {}
        if self.option.opening == "switching":
            odd = [2 * k + 1 for k in range(self.option.terms)]
            s = 0.5 + sum((-1) ** k * 2 / (np.pi * n) * cos(n * a) for k, n in enumerate(odd))
        elif self.option.opening == "exact":
            s = where(cos(a) > 0, 1.0, 0.0)
            events = {"switch": cos(a)}
        elif self.option.opening == "breathing":
            s = 0.5 * (1 + cos(a))
        elif self.option.opening == "open":
            s = 1.0 + 0.0 * a
        else:
            pairs = zip(rows(p.cosines), rows(p.sines), strict=True)
            s = p.mean + sum(c * cos(k * a) + d * sin(k * a) for k, (c, d) in enumerate(pairs, 1))
        shape = vec(1 + cos(2 * a), sin(2 * a))
        return Equations(
            outputs={
                "force": 0.5 * s * p.stiffness * p.sag * shape,
                "moment": 0.5 * s * p.tilt_stiffness * p.tilt_sag * shape,
                "opening": s,
            },
            events=events,
        )
