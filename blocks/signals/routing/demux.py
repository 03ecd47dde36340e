"""Vector to scalars."""

from rotorsim.block import Block, Equations, In, Option, Out, rows


class Demux(Block):
    """Split a vector into scalars.

    output1 = input_1,  output2 = input_2,  ...

    A wire can also pick one entry by itself: ``["rotor.displacement[1]", "gain.input"]``.
    """

    source = "Simulink: Demux"

    input = In(shape=("count",), unit=None, doc="vector, shape (count,)")
    output = Out(unit=None, many="count", doc="scalars: output1, output2, ...")
    count = Option(2, kind=int, low=1, high=10000, doc="number of scalars")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": rows(u.input)})
