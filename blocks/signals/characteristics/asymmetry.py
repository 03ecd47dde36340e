"""Two slopes."""

from rotorsim.block import Block, Equations, In, Out, Param, maximum
from rotorsim.fault import Fault


class Asymmetry(Block):
    """Pass a signal with two slopes, one for each sign, entry by entry.

    output = input + difference |input| / 2        slopes 1 + difference / 2 above zero and 1 - difference / 2 below
    """

    source = "S. W. Shaw & P. J. Holmes, J. Sound Vib. 90 (1983) 129-155 (piecewise linear characteristic)"
    faults = (
        Fault(
            physics="asymmetry",
            enters="signal",
            through={"input": "output"},
            free={"difference": (0.2, -0.2)},
            sizes=("difference",),
            law="even orders; proportional to the amplitude",
            confused_with=("static_nonlinearity", "one_sided_stop"),
            told_apart_by="amplitude: its share is the same at every one",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="signal behind the characteristic, shape of the input")
    difference = Param(0.0, unit=None, doc="difference of the slopes")

    def equations(self, p, u, x, t):
        size = maximum(u.input, -u.input)
        return Equations(outputs={"output": u.input + p.difference / 2 * size}, events={"zero": u.input})
