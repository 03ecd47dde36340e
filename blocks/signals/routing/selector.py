"""Selector."""

from rotorsim.block import Block, Equations, In, Option, Out, vec


class Selector(Block):
    """Pick entries of a vector, in any order, also repeatedly.

    output_k = input_(indices_k)        indices count from 1
    """

    source = "Simulink: Selector"

    input = In(shape=("entries",), unit=None, doc="vector")
    output = Out(shape=("indices",), unit=None, doc="picked entries, as many as indices")
    indices = Option([1], kind=int, low=1, doc="which entries to pick, counted from 1")

    def equations(self, p, u, x, t):
        n = u.input.shape[0]
        outside = [k for k in self.option.indices if k > n]
        if outside:
            raise ValueError(f"index {outside[0]} of indices is outside the input, which has {n} entries")
        return Equations(outputs={"output": vec(*[u.input[k - 1] for k in self.option.indices])})
