"""Quantiser."""

from math import pi

from rotorsim.block import Block, Equations, In, Out, Param, cos, floor


class Quantiser(Block):
    """Round a signal to whole multiples of an interval, entry by entry.

    output = interval * floor(input / interval + 1/2)
    """

    source = "Simulink: Quantizer"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="rounded signal, shape of the input")
    interval = Param(1.0, unit=None, above=0.0, doc="step between levels (of a converter: range / 2^bits)")

    def equations(self, p, u, x, t):
        ratio = u.input / p.interval
        # The output jumps where ratio + 1/2 is whole, which is where this cosine crosses zero.
        return Equations(outputs={"output": p.interval * floor(ratio + 0.5)}, events={"jump": cos(pi * ratio)})
