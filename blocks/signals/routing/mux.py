"""Scalars to vector."""

from rotorsim.block import Block, Equations, In, Option, Out, vec


class Mux(Block):
    """Stack scalars into a vector.

    output = [input1, input2, ...]
    """

    source = "Simulink: Mux"

    input = In(unit=None, many="count", doc="scalars: input1, input2, ...")
    output = Out(shape=("count",), unit=None, doc="vector, shape (count,)")
    count = Option(2, kind=int, low=1, high=10000, doc="number of scalars")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": vec(*u.input)})
