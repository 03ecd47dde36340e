"""Trigonometric function."""

from collections.abc import Callable
from typing import Any

from rotorsim.block import Block, Equations, In, Option, Out, arctan2, cos, sin, sqrt, tan

# Through arctan2 rather than arcsin: 1 - v^2 as a product keeps all digits near v = 1.
_FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "sin": sin,
    "cos": cos,
    "tan": tan,
    "arcsin": lambda v: arctan2(v, sqrt((1 - v) * (1 + v))),
    "arccos": lambda v: arctan2(sqrt((1 - v) * (1 + v)), v),
    "arctan": lambda v: arctan2(v, 1),
}


class Trigonometric(Block):
    """Apply a trigonometric function to a whole multiple of a signal, entry by entry.

    output = function(multiple * input)

    Angles are in radians. arcsin and arccos of values outside [-1, 1] are not numbers: such a run stops as diverged.
    Several blocks that take multiples of one angle cost little: the compiler makes them from one sine and cosine.
    """

    source = "Simulink: Trigonometric Function"

    input = In(shape="signal", unit=None, doc="angle [rad]; a ratio for the arc functions")
    output = Out(shape="signal", unit=None, doc="function value; an angle [rad] for the arc functions")
    function = Option("sin", choices=tuple(_FUNCTIONS), doc="function to apply")
    multiple = Option(1, kind=int, doc="harmonic number: the input is multiplied by it")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": _FUNCTIONS[self.option.function](self.option.multiple * u.input)})
