"""Minimum and maximum."""

from rotorsim.block import Block, Equations, In, Option, Out, maximum, minimum


class MinMax(Block):
    """Output the smallest or largest of several signals of one shape, entry by entry.

    output = min(input1, input2, ...)  or  max(input1, input2, ...)
    """

    source = "Simulink: MinMax"

    input = In(shape="signal", unit=None, many="count", doc="signals: input1, input2, ...")
    output = Out(shape="signal", unit=None, doc="smallest or largest, shape of the inputs")
    function = Option("minimum", choices=("minimum", "maximum"), doc="which one to give out")
    count = Option(2, kind=int, low=1, high=1000, doc="number of inputs")

    def equations(self, p, u, x, t):
        choose = minimum if self.option.function == "minimum" else maximum
        result, *others = u.input
        events = {}
        for k, other in enumerate(others, start=2):
            events[f"input{k}"] = other - result
            result = choose(result, other)
        return Equations(outputs={"output": result}, events=events)
