"""Constant source."""

from rotorsim.block import Block, Equations, Out, Param


class Constant(Block):
    """Output a constant of any shape.

    output = value
    """

    source = "Simulink: Constant"

    output = Out(shape="signal", unit=None, doc="the value")
    value = Param(1.0, shape="signal", unit=None, doc="value of the output, of any shape")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": p.value})
