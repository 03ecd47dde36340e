"""Saturation."""

from rotorsim.block import Block, Equations, In, Out, Param, maximum, minimum


class Saturation(Block):
    """Limit a signal from below and above, entry by entry.

    output = min(max(input, lower), upper)
    """

    source = "Simulink: Saturation"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="limited signal, shape of the input")
    lower = Param(-1.0, unit=None, doc="lower limit")
    upper = Param(1.0, unit=None, doc="upper limit")

    def check(self, values):
        """Refuse limits in the wrong order."""
        lower, upper = float(values["lower"]), float(values["upper"])
        return [] if lower <= upper else [f"lower = {lower:g} is above upper = {upper:g}"]

    def equations(self, p, u, x, t):
        return Equations(
            outputs={"output": minimum(maximum(u.input, p.lower), p.upper)},
            events={"lower": u.input - p.lower, "upper": u.input - p.upper},
        )
