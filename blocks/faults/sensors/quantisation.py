"""Resolution of a converter."""

from math import pi

from rotorsim.blocks.common import sensor

from rotorsim.block import Block, Option, Param, cos, floor, tanh
from rotorsim.fault import Fault, Of, Steps

_LAW = "harmonics where the amplitude is below a few steps, noise above"
_TOLD = "amplitude; a histogram of the readings"


class Quantisation(Block):
    """Round the displacement to whole steps of a converter, in each axis.

    law "exact":   x_s = interval floor(x / interval + 1/2)
    law "smooth":  x_s = interval [n + 1/2 + tanh((r - n - 1/2) / width) / (2 tanh(1 / (2 width)))],   r = x / interval,
                   n = floor(r); continuous, and the exact law for width to 0

    The velocity is not changed.
    """

    source = "Widrow & Kollar, Quantization Noise (2008)"
    faults = (
        Fault(
            physics="quantisation",
            enters="wire",
            through=sensor.THROUGH,
            options={"law": "smooth"},
            free={"interval": (Of("displacement", 0.1), Of("displacement", 0.5))},
            law=_LAW,
            confused_with=("noise",),
            told_apart_by=_TOLD,
        ),
        Fault(
            physics="quantisation",
            enters="reading",
            through={"displacement": "sensed_displacement"},
            options={"law": "exact"},
            fixed={"interval": Steps()},
            law=_LAW,
            confused_with=("noise",),
            told_apart_by=_TOLD,
        ),
    )

    ports = sensor.PORTS
    law = Option("exact", choices=("exact", "smooth"), kind=str, doc="steps that jump, or rise steeply")
    interval = Param(1e-6, unit="m", above=0.0, doc="step LSB of the converter")
    width = Param(0.2, above=0.0, doc="part of the step over which it rises (law smooth)")

    def equations(self, p, u, x, t):
        ratio = u.displacement / p.interval
        velocity = sensor.velocity_of(u)
        if self.option.law == "exact":
            # jumps where ratio + 1/2 is whole, which is where this cosine crosses zero
            return sensor.sensed(p.interval * floor(ratio + 0.5), velocity, events={"jump": cos(pi * ratio)})
        below = floor(ratio)
        rise = tanh((ratio - below - 0.5) / p.width) / (2 * tanh(0.5 / p.width))
        return sensor.sensed(p.interval * (below + 0.5 + rise), velocity)
