"""Signal that a recording gives."""

from rotorsim.block import Block, Equations, Option, Out, Param


class Recorded(Block):
    """Output a signal that a recording measured: what drives a bench from outside.

    output = value + offset

    value: the samples of the channel `block.output`, read between samples as `interpolation` says

    "hold": constant from each sample to the next (a converter); "linear": straight lines; "band_limited": the only
    curve through the samples without frequencies above half the sample rate (what came through an anti-alias filter).
    Where nothing is recorded `value` is the parameter. offset: between what was recorded and what acts (converters).
    """

    source = "C. E. Shannon, Proc. IRE 37 (1949) 10-21 (band-limited interpolation)"
    category = "input"

    output = Out(shape="signal", unit=None, doc="the signal")
    interpolation = Option("linear", choices=("hold", "linear", "band_limited"), kind=str, doc="between samples")
    value = Param(0.0, shape="signal", unit=None, doc="what stands for the recording without one")
    offset = Param(0.0, unit=None, doc="added to what was recorded")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": p.value + p.offset})
