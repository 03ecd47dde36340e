"""Sign."""

from rotorsim.block import Block, Equations, In, Out, sign


class Sign(Block):
    """Output the sign of a signal, entry by entry.

    output = 1 for input > 0,  0 for input = 0,  -1 for input < 0
    """

    source = "Simulink: Sign"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit="1", doc="sign, shape of the input")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": sign(u.input)}, events={"jump": u.input})
