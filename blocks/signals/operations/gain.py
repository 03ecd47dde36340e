"""Gain."""

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class Gain(Block):
    """Multiply a signal of any shape by a number.

    output = gain * input
    """

    source = "Simulink: Gain"
    faults = (
        Fault(
            physics="gain_error",
            enters="signal",
            through={"input": "output"},
            free={"gain": (1.1, 0.9)},
            law="proportional to the signal at all frequencies and amplitudes",
            confused_with=("lag", "asymmetry"),
            told_apart_by="a sensor on the other side of the gain",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="scaled signal, shape of the input")
    gain = Param(1.0, unit=None, doc="factor")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": p.gain * u.input})
