"""Euclidean norm."""

from rotorsim.block import Block, Equations, In, Out, sqrt, sum_of


class Norm(Block):
    """Output the Euclidean norm of a signal of any shape.

    output = sqrt(sum of input_i^2)

    The norm has a kink at zero: the derivative is not finite there.
    """

    source = "Simulink: Norm"

    input = In(shape="signal", unit=None, doc="signal of any shape")
    output = Out(unit=None, doc="norm, scalar")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": sqrt(sum_of(u.input * u.input))})
