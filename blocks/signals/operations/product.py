"""Product and quotient."""

from rotorsim.block import Block, Equations, In, Option, Out


class Product(Block):
    """Multiply and divide signals of one shape, entry by entry.

    output = input1 * input2 / input3 ...        one operation for each input, in order
    """

    source = "Simulink: Product"

    input = In(shape="signal", unit=None, many="operations", doc="factors: input1, input2, ...")
    output = Out(shape="signal", unit=None, doc="product, shape of the inputs")
    operations = Option("**", kind=str, doc="one operation, * or /, for each input")

    def check(self, values):
        """Refuse operations other than * and /."""
        given = self.option.operations
        return (
            [] if given and set(given) <= set("*/") else [f"operations must be one or more of * and /, got '{given}'"]
        )

    def equations(self, p, u, x, t):
        result = None
        for operation, factor in zip(self.option.operations, u.input, strict=True):
            if result is None:
                result = factor if operation == "*" else 1 / factor
            else:
                result = result * factor if operation == "*" else result / factor
        return Equations(outputs={"output": result})
