"""Signed sum."""

from rotorsim.block import Block, Equations, In, Option, Out


class Sum(Block):
    """Add and subtract signals of one shape.

    output = +- input1 +- input2 ...        one sign for each input, in order
    """

    source = "Simulink: Sum"

    input = In(shape="signal", unit=None, many="signs", by_parts=True, doc="terms: input1, input2, ...")
    output = Out(shape="signal", unit=None, doc="sum, shape of the inputs")
    signs = Option("++", kind=str, doc="one sign, + or -, for each input")

    def check(self, values):
        """Refuse signs other than + and -."""
        signs = self.option.signs
        return [] if signs and set(signs) <= set("+-") else [f"signs must be one or more of + and -, got '{signs}'"]

    def equations(self, p, u, x, t):
        total = None
        for sign, term in zip(self.option.signs, u.input, strict=True):
            signed = term if sign == "+" else -term
            total = signed if total is None else total + signed
        return Equations(outputs={"output": total})
