"""Integrator."""

from rotorsim.block import Block, Equations, In, Out, Param, State


class Integrator(Block):
    """Integrate a signal over time, entry by entry.

    d value / dt = input,  value(0) = initial,  output = value
    """

    source = "Simulink: Integrator"

    input = In(shape="signal", unit=None, doc="rate of change")
    output = Out(shape="signal", unit=None, doc="integral, shape of the input")
    initial = Param(0.0, shape="signal", unit=None, doc="value at the start")
    value = State(shape="signal", unit=None, init="initial", doc="integral")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": x.value}, derivatives={"value": u.input})
