"""Gain."""

from rotorsim.block import Block, Equations, In, Out, Param


class Gain(Block):
    """Multiply a signal of any shape by a number.

    output = gain * input
    """

    source = "Simulink: Gain"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="scaled signal, shape of the input")
    gain = Param(1.0, unit=None, doc="factor")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": p.gain * u.input})
