"""Linear controller given by its matrices."""

from rotorsim.blocks.common import controller as control

from rotorsim.block import Block, Param, State


class StateSpace(Block):
    """Control a magnetic bearing by any linear controller in state space.

    d value / dt = A value + B e,  i = C value + D e        e = displacement - reference

    Shapes: A (n, n), B (n, 2), C (2, n), D (2, 2). The velocity port is there so that controllers can be
    swapped; it is not used.
    """

    source = "Simulink: State-Space; Franklin et al., Feedback Control of Dynamic Systems, chapter 7"

    displacement = control.DISPLACEMENT
    velocity = control.UNUSED_VELOCITY
    reference = control.REFERENCE
    current = control.CURRENT
    A = Param(shape=("n", "n"), unit="1/s", doc="state matrix, shape (n, n)")
    B = Param(shape=("n", 2), unit=None, doc="input matrix, shape (n, 2)")
    C = Param(shape=(2, "n"), unit=None, doc="output matrix, shape (2, n)")
    D = Param([[0.0, 0.0], [0.0, 0.0]], shape=(2, 2), unit="A/m", doc="feedthrough matrix, shape (2, 2)")
    initial = Param(0.0, shape=("n",), unit=None, doc="state at the start, shape (n,)")
    value = State(shape=("n",), unit=None, init="initial", doc="state of the controller")

    def equations(self, p, u, x, t):
        return control.state_space_of(p, u, x)
