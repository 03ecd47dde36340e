"""Bus selector: parts of a vector by name."""

from itertools import pairwise

import numpy as np
from rotorsim.blocks.common import names as naming

from rotorsim.block import Block, Equations, In, Option, Out


class BusSelector(Block):
    """Take a vector apart into named outputs, in order.

    first output = first widths[0] entries of the input, second output = next widths[1] entries, ...
    """

    source = "Simulink: Bus Selector"

    input = In(shape=lambda option: (sum(option.widths),), unit=None, doc="vector, all widths together")
    output = Out(shape="part*", unit=None, many="names", doc="one port for each name")
    names = Option(["signal"], kind=str, doc="names of the output ports")
    widths = Option([2], kind=int, low=1, high=10000, doc="number of entries of each output")

    def check(self, values):
        """Refuse names without a width and repeated names."""
        names, widths = self.option.names, self.option.widths
        if len(names) != len(widths):
            return [f"{len(names)} names and {len(widths)} widths; one width is needed for each name"]
        return naming.mistakes(names, "a bus selector") if names else []

    def output_shapes(self, inputs):
        """Give every output its width."""
        return {name: (width,) for name, width in zip(self.option.names, self.option.widths, strict=False)}

    def equations(self, p, u, x, t):
        ends = np.cumsum([0, *self.option.widths])
        parts = [u.input[int(a) : int(b)] for a, b in pairwise(ends)]
        return Equations(outputs={"output": parts})
