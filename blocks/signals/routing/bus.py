"""Bus: signals of any shape in one vector."""

from math import prod

from rotorsim.blocks.common import names as naming

from rotorsim.block import Block, Equations, In, Option, Out, concatenate


class Bus(Block):
    """Put signals of any shape one after another into one vector.

    output = [entries of the first signal, entries of the second, ...]        each in row-major order
    """

    source = "thesis Figures 2-5, 3-2, 4-4, 5-3 (bus creator); Simulink: Bus Creator, Vector Concatenate"

    input = In(shape="signal*", unit=None, many="names", doc="one port for each name, of any shape")
    output = Out(shape=("total",), unit=None, doc="all entries, shape (total,)")
    names = Option(["input1", "input2"], kind=str, doc="names of the input ports, in the order of the output")

    def check(self, values):
        """Refuse missing and repeated names."""
        return naming.mistakes(self.option.names, "a bus")

    def output_shapes(self, inputs):
        """Add up the entries of the inputs."""
        return {"output": (sum(prod(shape) for shape in inputs.values()),)}

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": concatenate(u.input)})
