"""Linear state-space system."""

from rotorsim.block import Block, Equations, In, Out, Param, State


class LinearSystem(Block):
    """Pass a vector through a linear time-invariant system.

    d value / dt = A value + B input,  output = C value + D input

    Shapes: A (n, n), B (n, inputs), C (outputs, n), D (outputs, inputs).
    """

    source = "Simulink: State-Space"

    input = In(shape=("inputs",), unit=None, doc="vector, shape (inputs,)")
    output = Out(shape=("outputs",), unit=None, doc="vector, shape (outputs,)")
    A = Param(shape=("n", "n"), unit=None, doc="state matrix, shape (n, n)")
    B = Param(shape=("n", "inputs"), unit=None, doc="input matrix, shape (n, inputs)")
    C = Param(shape=("outputs", "n"), unit=None, doc="output matrix, shape (outputs, n)")
    D = Param(0.0, shape=("outputs", "inputs"), unit=None, doc="feedthrough matrix, shape (outputs, inputs)")
    initial = Param(0.0, shape=("n",), unit=None, doc="state at the start, shape (n,)")
    value = State(shape=("n",), unit=None, init="initial", doc="state")

    def equations(self, p, u, x, t):
        return Equations(
            outputs={"output": p.C @ x.value + p.D @ u.input}, derivatives={"value": p.A @ x.value + p.B @ u.input}
        )
