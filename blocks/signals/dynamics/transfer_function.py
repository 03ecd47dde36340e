"""Transfer function."""

import numpy as np

from rotorsim.block import Block, Equations, In, Option, Out, Param, State, rows, vec


class TransferFunction(Block):
    """Pass a scalar signal through a proper transfer function.

    G(s) = numerator(s) / denominator(s)        coefficients from the highest power of s down to s^0

    With a_0 s^n + ... + a_n below, b_0 s^n + ... + b_n above (missing leading b are 0), in controllable canonical form
    (d/dt) value_k = value_(k+1),  (d/dt) value_n = (input - sum_k a_(n+1-k) value_k) / a_0,
    output = sum_k (b_(n+1-k) - a_(n+1-k) b_0 / a_0) value_k + b_0 / a_0 input.
    The start is at rest. The numerator may be shorter than the denominator.
    """

    source = "Simulink: Transfer Fcn; Kailath, Linear Systems (1980), section 2.1"

    input = In(unit=None, doc="signal, scalar")
    output = Out(unit=None, doc="filtered signal, scalar")
    order = Option(1, kind=int, low=1, high=20, doc="highest power of s in the denominator")
    numerator = Param([1.0], shape=("terms",), unit=None, doc="coefficients, at most order + 1, highest power first")
    denominator = Param(
        [1.0, 1.0],
        shape=lambda o: (o.order + 1,),
        unit=None,
        doc="order + 1 coefficients, highest power first, first not 0",
    )
    value = State(shape=("order",), unit=None, doc="states of the controllable canonical form")

    def check(self, values):
        """Refuse improper transfer functions and a leading zero in the denominator."""
        messages = []
        if np.size(values["numerator"]) > self.option.order + 1:
            messages.append(
                f"the numerator has {np.size(values['numerator'])} coefficients, but at most order + 1 = "
                f"{self.option.order + 1} are possible (a proper transfer function)"
            )
        if np.ravel(values["denominator"])[0] == 0.0:
            messages.append("the first coefficient of the denominator must not be 0 (lower the order instead)")
        return messages

    def equations(self, p, u, x, t):
        n = self.option.order
        leading, *below = rows(p.denominator)
        given = rows(p.numerator)
        first, *above = [0.0] * (n + 1 - len(given)) + given
        states = rows(x.value)
        feed = first / leading
        top = u.input / leading
        output = feed * u.input
        for a, b, state in zip(reversed(below), reversed(above), states, strict=True):
            top = top - a * state / leading
            output = output + (b - a * feed) * state
        return Equations(outputs={"output": output}, derivatives={"value": vec(*states[1:], top)})
