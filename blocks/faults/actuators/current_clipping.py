"""Limits of a power amplifier."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Option, Out, Param, State
from rotorsim.fault import Fault, Of


class CurrentClipping(Block):
    """Limit the current of an amplifier, or its rate (the voltage over the inductance).

    law "limit":  i = min(max(i_c, -limit), limit)
    law "slew":   i = v + e,   v' = e / lag,   e = min(max(i_c - v, -lag slew), lag slew)

    Within its limit the current is the demanded one, i = i_c. The slew limit |i'| <= slew = V / L is met while it acts;
    it acts once the demand, behind the short `lag`, changes faster.
    """

    source = "Schweitzer & Maslen (2009), ch. 3 (power amplifiers: maximal current, force slew rate)"
    faults = tuple(
        Fault(
            physics="current_clipping",
            enters="wire",
            between=("controller", "bearing"),
            through={"current": "limited"},
            recorded=recorded,
            options={"law": law},
            free={law: starts},
            law=f"{shape}; odd orders; none below a threshold; the recorded current is the {which}",
            confused_with=("magnetic_saturation",),
            told_apart_by="the current in the coil: clipping shows there first, saturation only in the force",
        )
        for recorded, which in (("after", "one that flows"), ("before", "demand"))
        for law, starts, shape in (
            ("limit", (Of("current", 0.95), Of("current", 0.7)), "flat tops"),
            ("slew", (Of("current", 0.95, rate=True), Of("current", 0.7, rate=True)), "straight flanks"),
        )
    )

    current = In(shape="signal", unit="A", doc="current demanded i_c")
    limited = Out(shape="signal", unit="A", doc="current that flows i")
    law = Option("limit", choices=("limit", "slew"), kind=str, doc="limit of the current, or of its rate")
    limit = Param(1.0, unit="A", above=0.0, doc="largest current i_max, in each axis (law limit)")
    slew = Param(1000.0, unit="A/s", above=0.0, doc="largest rate V / L, in each axis (law slew)")
    lag = Param(1e-4, unit="s", above=0.0, doc="time over which the rate of the demand is seen (law slew)")
    followed = State(shape="signal", unit="A", when=lambda o: o.law == "slew", doc="v, demand behind the lag")

    def equations(self, p, u, x, t):
        if self.option.law == "limit":
            return Equations(
                outputs={"limited": plane.within(u.current, p.limit)},
                events={"lower": u.current + p.limit, "upper": u.current - p.limit},
            )
        behind, most = u.current - x.followed, p.lag * p.slew
        step = plane.within(behind, most)
        return Equations(
            outputs={"limited": x.followed + step},
            derivatives={"followed": step / p.lag},
            events={"lower": behind + most, "upper": behind - most},
        )
