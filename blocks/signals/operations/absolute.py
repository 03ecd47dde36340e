"""Absolute value."""

from rotorsim.block import Block, Equations, In, Out, absolute


class Absolute(Block):
    """Output the absolute value of a signal, entry by entry.

    output = |input|
    """

    source = "Simulink: Abs"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="absolute value, shape of the input")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": absolute(u.input)}, events={"kink": u.input})
