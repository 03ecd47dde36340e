"""Sample and hold."""

from rotorsim.block import Block, DiscreteState, Equations, In, Out, Param


class SampleHold(Block):
    """Sample a signal at every hit and hold it until the next, entry by entry.

    at hit k:  output = input, held until hit k + 1
    """

    source = "Simulink: Zero-Order Hold"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="held samples, shape of the input")
    sample_time = Param(1e-3, unit="s", above=0.0, doc="time between hits")
    initial = Param(0.0, shape="signal", unit=None, doc="output before the first hit")
    value = DiscreteState(shape="signal", unit=None, init="initial", doc="held sample")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": x.value}, update={"value": u.input})
