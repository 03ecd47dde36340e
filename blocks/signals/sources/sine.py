"""Sine source."""

from rotorsim.block import Block, Equations, Out, Param, sin


class Sine(Block):
    """Output a sine of time.

    output = offset + amplitude sin(frequency t + phase)

    A sine that must follow the turning rotor takes its angle from the clock: use `trigonometric` or `reference`.
    """

    source = "Simulink: Sine Wave"

    output = Out(shape="signal", unit=None, doc="sine, shape of amplitude, phase and offset")
    amplitude = Param(1.0, shape="signal", unit=None, doc="amplitude, 0 to peak")
    frequency = Param(6.283185307179586, unit="rad/s", doc='angular frequency (write "1 Hz" for one cycle per second)')
    phase = Param(0.0, shape="signal", unit="rad", doc="phase at t = 0")
    offset = Param(0.0, shape="signal", unit=None, doc="mean value")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": p.offset + p.amplitude * sin(p.frequency * t + p.phase)})
