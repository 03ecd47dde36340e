"""Step source."""

from rotorsim.block import Block, Equations, Out, Param, where


class Step(Block):
    """Output a step.

    output = initial for t < time,  final for t >= time
    """

    source = "Simulink: Step"

    output = Out(shape="signal", unit=None, doc="step, shape of initial and final")
    time = Param(1.0, unit="s", doc="time of the step")
    initial = Param(0.0, shape="signal", unit=None, doc="value before the step")
    final = Param(1.0, shape="signal", unit=None, doc="value from the step on")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": where(t >= p.time, p.final, p.initial)}, events={"step": t - p.time})
