"""A stop on one side."""

from rotorsim.block import Block, Equations, In, Out, Param, maximum
from rotorsim.fault import Fault, Of


class OneSidedStop(Block):
    """Add a second slope beyond a gap on one side, entry by entry.

    output = input + ratio max(input - gap, 0)        side +1
    output = input - ratio max(-input - gap, 0)       side -1
    """

    source = "S. W. Shaw & P. J. Holmes, J. Sound Vib. 90 (1983) 129-155"
    faults = tuple(
        Fault(
            physics="one_sided_stop",
            enters="signal",
            through={"input": "output"},
            fixed={"side": side},
            free={"gap": (Of("input", 0.3), Of("input", 0.7)), "ratio": (1.0,)},
            sizes=("ratio",),
            simpler={"ratio": (-1.0, "saturation"), "gap": (0.0, "asymmetry")},  # but for a gain
            law="nothing below the gap; one side only",
            confused_with=("asymmetry", "static_nonlinearity"),
            told_apart_by="amplitude: below the gap nothing is left",
        )
        for side in (1.0, -1.0)
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="signal behind the stop, shape of the input")
    gap = Param(0.0, unit=None, doc="distance of the stop, unit of the input")
    ratio = Param(0.0, unit=None, doc="slope beyond the gap, beside that of the signal")
    side = Param(1.0, unit=None, doc="1: stop above, -1: below")

    def equations(self, p, u, x, t):
        beyond = p.side * u.input - p.gap
        return Equations(outputs={"output": u.input + p.side * p.ratio * maximum(beyond, 0.0)}, events={"stop": beyond})
