"""Filtered derivative."""

from rotorsim.block import Block, Equations, In, Out, Param, State


class Derivative(Block):
    """Differentiate a signal through a first-order filter, entry by entry.

    d filtered / dt = (input - filtered) / time_constant,  output = (input - filtered) / time_constant
    transfer function  s / (1 + time_constant s)

    The output lags the true derivative by the angle arctan(w time_constant) at frequency w; the error is below 1 %
    for w time_constant < 0.01 in phase [rad] and 0.14 in magnitude. With a fixed step h, RK4 needs
    time_constant > h / 2.78. At the start `filtered` is `initial`: set it to the first input to avoid a kick.
    """

    source = "Simulink: Derivative (there unfiltered, with a lag of part of a step)"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="derivative [1/s of the input], shape of the input")
    time_constant = Param(1e-4, unit="s", above=0.0, doc="time constant of the filter")
    initial = Param(0.0, shape="signal", unit=None, doc="input before the start")
    filtered = State(shape="signal", unit=None, init="initial", doc="input behind the filter")

    def equations(self, p, u, x, t):
        rate = (u.input - x.filtered) / p.time_constant
        return Equations(outputs={"output": rate}, derivatives={"filtered": rate})
