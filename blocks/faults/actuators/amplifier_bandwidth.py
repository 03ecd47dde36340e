"""Bandwidth of a power amplifier."""

from math import pi

from rotorsim.block import Block, Equations, In, Out, Param, State
from rotorsim.fault import Fault


class AmplifierBandwidth(Block):
    """Give the current that an amplifier of first order drives.

    i = i_c / (1 + s / bandwidth)

    In a recording the current may be the demand i_c or the current i that flows: a diagnosis tries both.
    """

    source = "Schweitzer & Maslen (2009), ch. 3 (power amplifiers)"
    faults = tuple(
        Fault(
            physics="amplifier_bandwidth",
            enters="wire",
            between=("controller", "bearing"),
            through={"current": "amplified"},
            recorded=recorded,
            free={"bandwidth": (2 * pi * 2000, 2 * pi * 400)},
            law="lag of the current in proportion to frequency, with a gain that falls with its square; the recorded "
            f"current is the {which}",
            confused_with=("control_delay", "eddy_current_lag"),
            told_apart_by="the gain at high orders: an amplifier lowers it, a delay leaves it; the current in the coil",
        )
        for recorded, which in (("before", "demand"), ("after", "one that flows"))
    )

    current = In(shape="signal", unit="A", doc="current demanded i_c")
    amplified = Out(shape="signal", unit="A", doc="current that flows i")
    bandwidth = Param(2 * pi * 1000, unit="rad/s", above=0.0, high=1e6, doc='bandwidth w_a (in JSON also "1 kHz")')
    flowing = State(shape="signal", unit="A", doc="current that flows")

    def equations(self, p, u, x, t):
        return Equations(
            outputs={"amplified": x.flowing}, derivatives={"flowing": p.bandwidth * (u.current - x.flowing)}
        )
