"""Quantiser."""

from math import pi

from rotorsim.block import Block, Equations, In, Option, Out, Param, arctan2, cos, floor, sin
from rotorsim.fault import Fault, Of

_ROUND = {"steep": 0.99, "smooth": 0.9}  # r of the equations
_LEVELS = (4.0, 16.0, *(0.5 + 0.25 * k for k in range(160)))  # 40 in the largest value: a quarter of a step apart there


class Quantiser(Block):
    """Round a signal to whole multiples of an interval, entry by entry.

    edges "sharp":            output = interval * floor(input / interval + 1/2)
    edges "steep", "smooth":  output = input - interval/pi * atan(r sin(a) / (1 + r cos(a))),  a = 2 pi input / interval
                              r = 0.99, 0.9

    Between two levels the output rises with slope (1 + r) / (1 - r), on them with the inverse; r = 1 is sharp. Sharp
    edges have no slope, so that nothing in front of them could be fitted.
    """

    source = "Simulink: Quantizer; W. Kester, Analog-Digital Conversion (2004), ch. 2 (quantisation error: a sawtooth)"
    faults = (
        Fault(
            physics="quantisation",
            enters="signal",
            through={"input": "output"},
            options={"edges": "smooth"},
            finer={"edges": "steep"},
            free={"interval": tuple(Of("input", 1 / levels) for levels in _LEVELS)},
            most={"interval": Of("input", 2.0)},
            law="steps of one height; what lies between two levels is lost",
            confused_with=("play", "dead_zone"),
            told_apart_by="amplitude: slow and smaller than a step, nothing passes",
            convention="edges are 1/200 of an interval wide: inside a loop the interval is known no better",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="rounded signal, shape of the input")
    edges = Option("sharp", choices=("sharp", *_ROUND), kind=str, doc="how the output goes from level to level")
    interval = Param(1.0, unit=None, above=0.0, doc="step between levels (of a converter: range / 2^bits)")

    def equations(self, p, u, x, t):
        ratio = u.input / p.interval
        if self.option.edges == "sharp":
            # The output jumps where ratio + 1/2 is whole, which is where this cosine crosses zero.
            return Equations(outputs={"output": p.interval * floor(ratio + 0.5)}, events={"jump": cos(pi * ratio)})
        r, angle = _ROUND[self.option.edges], 2 * pi * ratio
        return Equations(outputs={"output": u.input - p.interval / pi * arctan2(r * sin(angle), 1 + r * cos(angle))})
