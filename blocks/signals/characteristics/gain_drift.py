"""A gain that drifts."""

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault, Longest


class GainDrift(Block):
    """Multiply a signal by a factor that changes with time, entry by entry.

    output = (1 + rate t) input
    """

    source = "R. Isermann, Fault-Diagnosis Systems (2006), ch. 5 (multiplicative faults)"
    faults = (
        Fault(
            physics="gain_drift",
            enters="signal",
            through={"input": "output"},
            free={"rate": (Longest(0.1, power=-1), Longest(-0.1, power=-1))},
            sizes=("rate",),
            law="proportional to the signal, and to the time since the start of every run",
            confused_with=("gain_error", "drift"),
            told_apart_by="the same inputs again, later in the run",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="signal with the drifting gain, shape of the input")
    rate = Param(0.0, unit="1/s", doc="change of the factor per second")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": (1 + p.rate * t) * u.input})
