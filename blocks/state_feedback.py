"""Observer-based state-feedback controller."""

from typing import Any

from rotorsim.block import Block, Equations, In, Out, Param, State


class StateFeedback(Block):
    """Control a magnetic bearing by feedback of observed states.

    d value / dt = A value + B e,  i = C value + D e        e = displacement - reference

    Shapes: A (n, n), B (n, 2), C (2, n), D (2, 2). `rotorsim swap` designs the matrices from the linearised
    plant x' = Ap x + Bp i, u = Cp x: with feedback gain K (i = -K x) and observer gain L,
    A = Ap - Bp K - L Cp,  B = L,  C = -K,  D = 0. The velocity port is there so that controllers can be swapped; it is
    not used.
    """

    source = "Anderson and Moore, Optimal Control: Linear Quadratic Methods (1990), chapter 8"
    category = "controller"

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] at the bearing")
    velocity = In(shape=2, unit="m/s", optional=True, doc="rotor velocity [x, y]; not used")
    reference = In(shape=2, unit="m", optional=True, doc="set-point of the displacement; unwired: zero")
    current = Out(shape=2, unit="A", doc="control current [x, y]")
    A = Param(shape=("n", "n"), unit="1/s", doc="state matrix, shape (n, n)")
    B = Param(shape=("n", 2), unit=None, doc="input matrix, shape (n, 2)")
    C = Param(shape=(2, "n"), unit=None, doc="output matrix, shape (2, n)")
    D = Param([[0.0, 0.0], [0.0, 0.0]], shape=(2, 2), unit="A/m", doc="feedthrough matrix, shape (2, 2)")
    initial = Param(0.0, shape=("n",), unit=None, doc="state at the start, shape (n,)")
    value = State(shape=("n",), unit=None, init="initial", doc="state of the controller")

    def equations(self, p: Any, u: Any, x: Any, t: Any) -> Equations:
        error = u.displacement if u.reference is None else u.displacement - u.reference
        return Equations(
            outputs={"current": p.C @ x.value + p.D @ error},
            derivatives={"value": p.A @ x.value + p.B @ error},
        )
