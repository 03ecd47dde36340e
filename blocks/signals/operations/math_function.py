"""Mathematical function."""

from collections.abc import Callable
from typing import Any

from rotorsim.block import Block, Equations, In, Option, Out, exp, floor, log, sqrt, tanh

_FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "square": lambda v: v * v,
    "sqrt": sqrt,
    "exp": exp,
    "log": log,
    "reciprocal": lambda v: 1 / v,
    "tanh": tanh,
    "floor": floor,
}


class MathFunction(Block):
    """Apply a mathematical function to a signal, entry by entry.

    output = function(input)

    sqrt of negative values and log of negative values are not numbers: such a run stops as diverged.
    floor jumps; an adaptive solver does not locate its jumps (use a quantiser for that).
    """

    source = "Simulink: Math Function, Sqrt"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="function value, shape of the input")
    function = Option("square", choices=tuple(_FUNCTIONS), doc="function to apply")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": _FUNCTIONS[self.option.function](u.input)})
