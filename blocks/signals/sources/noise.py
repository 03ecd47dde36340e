"""White noise."""

from rotorsim.block import Block, DiscreteState, Equations, Out, Param, Random


class Noise(Block):
    """Output seeded Gaussian noise that is held over each sample time.

    at every hit:  output = mean + standard_deviation * draw,  draws independent, N(0, 1)

    The one-sided power spectral density is 2 standard_deviation^2 sample_time far below 1 / sample_time.
    The same seed gives the same noise; entries of a vector are independent.
    """

    source = "Simulink: Band-Limited White Noise, Random Number"

    output = Out(shape="signal", unit=None, doc="noise, of the shape that is wired or given by the parameters")
    mean = Param(0.0, shape="signal", unit=None, doc="mean")
    standard_deviation = Param(1.0, shape="signal", unit=None, low=0.0, doc="standard deviation")
    sample_time = Param(1e-3, unit="s", above=0.0, doc="time between draws")
    seed = Param(0.0, low=0.0, doc="whole number that fixes the sequence")
    draw = Random(shape="signal", seed="seed", doc="standard normal draws")
    value = DiscreteState(shape="signal", unit=None, init="mean", doc="held noise")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": x.value}, update={"value": p.mean + p.standard_deviation * x.draw})
