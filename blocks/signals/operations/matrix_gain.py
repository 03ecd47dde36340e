"""Matrix gain."""

from rotorsim.block import Block, Equations, In, Out, Param


class MatrixGain(Block):
    """Multiply a vector by a matrix.

    output = gain @ input        shapes (outputs,) = (outputs, inputs) @ (inputs,)
    """

    source = "Simulink: Gain (matrix K*u)"

    input = In(shape=("inputs",), unit=None, doc="vector, shape (inputs,)")
    output = Out(shape=("outputs",), unit=None, doc="vector, shape (outputs,)")
    gain = Param(shape=("outputs", "inputs"), unit=None, doc="matrix, shape (outputs, inputs)")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": p.gain @ u.input})
