"""Saturation."""

from rotorsim.block import Block, Equations, In, Out, Param, maximum, minimum
from rotorsim.fault import Fault, Of


class Saturation(Block):
    """Limit a signal from below and above, entry by entry.

    output = min(max(input, lower), upper)
    """

    source = "Simulink: Saturation"
    faults = (
        Fault(
            physics="saturation",
            enters="signal",
            through={"input": "output"},
            free={"lower": (Of("input", -0.9), Of("input", -0.5)), "upper": (Of("input", 0.9), Of("input", 0.5))},
            law="flat tops; nothing below the limits",
            confused_with=("rate_limit", "static_nonlinearity"),
            told_apart_by="amplitude: below a limit nothing is left",
        ),
    )

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
