"""Second-order low-pass: a mode in the way of a signal."""

from math import inf, pi

from rotorsim.block import Block, Equations, In, Out, Param, State
from rotorsim.fault import Fault, Sampled

# Times the rate of samples, a factor of 1.5 apart: the resonance of a damping ratio of 0.3 is 2 * 0.3 of its frequency
# wide (half power). The first few are tried wherever little is known, and span the whole range.
_FREQUENCIES = tuple(0.004 * 1.5**k for k in (5, 9, 13, 1, 3, 7, 11, 15, *range(0, 16, 2)))


class SecondOrder(Block):
    """Pass a signal through a mode, entry by entry.

    value'' + 2 damping_ratio w value' + w^2 value = w^2 input,  output = value,  w = frequency
    """

    source = "Simulink: Transfer Fcn (second order)"
    faults = (
        Fault(
            physics="missing_mode",
            enters="signal",
            through={"input": "output"},
            free={"frequency": tuple(Sampled(part, power=-1) for part in _FREQUENCIES), "damping_ratio": (0.3,)},
            most={"frequency": Sampled(pi, power=-1)},  # of Nyquist
            simpler={"frequency": (inf, "lag")},
            law="resonance at its frequency, nothing far below it",
            confused_with=("delay", "lag"),
            told_apart_by="excitation at the resonance",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="signal behind the mode, shape of the input")
    frequency = Param(100.0, unit="rad/s", above=0.0, doc="natural frequency w")
    damping_ratio = Param(0.1, unit=None, above=0.0, doc="damping ratio")
    value = State(shape="signal", unit=None, begins="input", doc="output")
    rate = State(shape="signal", unit="1/s", doc="its rate")

    def equations(self, p, u, x, t):
        force = p.frequency**2 * (u.input - x.value) - 2 * p.damping_ratio * p.frequency * x.rate
        return Equations(outputs={"output": x.value}, derivatives={"value": x.rate, "rate": force})
