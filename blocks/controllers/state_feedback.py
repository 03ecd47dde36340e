"""Observer-based state-feedback controller."""

from rotorsim.blocks.common import controller as control

from rotorsim.block import Block


class StateFeedback(Block):
    """Control a magnetic bearing by feedback of observed states.

    d value / dt = A value + B e,  i = C value + D e        e = displacement - reference

    Shapes: A (n, n), B (n, 2), C (2, n), D (2, 2). `rotorsim swap` designs the matrices from the linearised
    plant x' = Ap x + Bp i, u = Cp x: with feedback gain K (i = -K x) and observer gain L,
    A = Ap - Bp K - L Cp,  B = L,  C = -K,  D = 0. The velocity port is there so that controllers can be swapped; it is
    not used.
    """

    source = "Anderson and Moore, Optimal Control: Linear Quadratic Methods (1990), chapter 8"

    ports = control.PORTS_WITHOUT_VELOCITY
    matrices = control.MATRICES

    def equations(self, p, u, x, t):
        return control.state_space_of(p, u, x)
