"""Ramp source."""

from rotorsim.block import Block, Equations, Out, Param, maximum


class Ramp(Block):
    """Output a ramp.

    output = initial + slope max(t - time, 0)
    """

    source = "Simulink: Ramp"

    output = Out(shape="signal", unit=None, doc="ramp, shape of initial and slope")
    time = Param(0.0, unit="s", doc="time at which the ramp starts")
    initial = Param(0.0, shape="signal", unit=None, doc="value before the ramp")
    slope = Param(1.0, shape="signal", unit=None, doc="change per second")

    def equations(self, p, u, x, t):
        rise = maximum(t - p.time, 0.0)
        return Equations(outputs={"output": p.initial + p.slope * rise}, events={"start": t - p.time})
