"""Scope: signals to record and plot."""

from rotorsim.blocks.common import names as naming

from rotorsim.block import Block, Equations, In, Option


class Scope(Block):
    """Mark signals of any shape to be recorded and plotted together.

    It has no output and changes nothing: what is wired to it is recorded as if named under "record".
    """

    source = "Simulink: Scope"

    input = In(shape="signal*", unit=None, many="names", doc="one port for each name, of any shape")
    names = Option(["input"], kind=str, doc="names of the input ports; the legend of the plot")

    def check(self, values):
        """Refuse missing and repeated names."""
        return naming.mistakes(self.option.names, "a scope")

    def equations(self, p, u, x, t):
        return Equations()
