"""Scope: signals to record and plot."""

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
        names = self.option.names
        if not names:
            return ["names is empty: a scope needs at least one input"]
        return [f"name '{name}' is given twice" for name in dict.fromkeys(names) if names.count(name) > 1]

    def equations(self, p, u, x, t):
        return Equations()
