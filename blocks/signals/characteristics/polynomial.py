"""Static characteristic as a polynomial."""

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault, Of


class Polynomial(Block):
    """Pass a signal through a characteristic that is nearly straight, entry by entry.

    output = input + quadratic input^2 + cubic input^3
    """

    source = "S. A. Billings, Nonlinear System Identification (2013), ch. 2"
    faults = (
        Fault(
            physics="static_nonlinearity",
            enters="signal",
            through={"input": "output"},
            free={
                "quadratic": (Of("input", 0.1, power=-1),),
                "cubic": (Of("input", 0.1, power=-2), Of("input", -0.1, power=-2)),
            },
            sizes=("quadratic", "cubic"),
            law="grows with the square and the cube of the amplitude",
            confused_with=("saturation", "asymmetry", "dead_zone"),
            told_apart_by="amplitude: the share of what is left grows with it",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="signal behind the characteristic, shape of the input")
    quadratic = Param(0.0, unit=None, doc="factor of the square")
    cubic = Param(0.0, unit=None, doc="factor of the cube")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": u.input * (1 + p.quadratic * u.input + p.cubic * u.input**2)})
