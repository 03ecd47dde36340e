"""Linear controller given by its matrices."""

from rotorsim.blocks.common import controller as control

from rotorsim.block import Block


class StateSpace(Block):
    """Control a magnetic bearing by any linear controller in state space.

    d value / dt = A value + B e,  i = C value + D e        e = displacement - reference

    Shapes: A (n, n), B (n, 2), C (2, n), D (2, 2). The velocity port is there so that controllers can be
    swapped; it is not used.
    """

    source = "Simulink: State-Space; Franklin et al., Feedback Control of Dynamic Systems, chapter 7"

    ports = control.PORTS_WITHOUT_VELOCITY
    matrices = control.MATRICES

    def equations(self, p, u, x, t):
        return control.state_space_of(p, u, x)
