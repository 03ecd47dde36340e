"""Integrator with a leak."""

from rotorsim.block import Block, Equations, In, Out, Param, State
from rotorsim.fault import Fault, Longest


class LeakyIntegrator(Block):
    """Integrate a signal over time with a leak, entry by entry.

    d value / dt = input - leak value,  value(0) = initial,  output = value
    """

    source = "Simulink: Integrator (here with a leak)"
    faults = (
        Fault(
            physics="integrator_leak",
            enters="replace",
            of=("integrator",),
            free={"leak": tuple(Longest(part, power=-1) for part in (0.1, 1.0, 10.0))},
            sizes=("leak",),
            law="forgets within 1 / leak: low frequencies only",
            confused_with=("lag", "gain_error"),
            told_apart_by="low frequencies, or a long rest after an input",
        ),
    )

    input = In(shape="signal", unit=None, doc="rate of change")
    output = Out(shape="signal", unit=None, doc="integral, shape of the input")
    leak = Param(0.0, unit="1/s", low=0.0, doc="leak: what is lost in a second, of the integral")
    initial = Param(0.0, shape="signal", unit=None, doc="value at the start")
    value = State(shape="signal", unit=None, init="initial", doc="integral")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": x.value}, derivatives={"value": u.input - p.leak * x.value})
