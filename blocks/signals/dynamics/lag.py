"""First-order lag."""

from rotorsim.block import Block, Equations, In, Out, Param, State
from rotorsim.fault import Fault, Sampled


class Lag(Block):
    """Pass a signal through a first-order lag, entry by entry.

    time_constant d value / dt = input - value,  value(0) = initial,  output = value
    transfer function  1 / (1 + time_constant s)
    """

    source = "Simulink: Transfer Fcn (first order)"
    faults = (
        Fault(
            physics="lag",
            enters="signal",
            through={"input": "output"},
            free={"time_constant": (Sampled(1.0), Sampled(10.0), Sampled(100.0))},
            law="attenuation and phase lag above the corner frequency",
            confused_with=("delay", "missing_mode"),
            told_apart_by="high frequencies: a lag attenuates them, a delay does not",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="signal behind the lag, shape of the input")
    time_constant = Param(1e-2, unit="s", above=0.0, doc="time constant T")
    initial = Param(0.0, shape="signal", unit=None, doc="output at the start")
    value = State(shape="signal", unit=None, init="initial", begins="input", doc="output")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": x.value}, derivatives={"value": (u.input - x.value) / p.time_constant})
