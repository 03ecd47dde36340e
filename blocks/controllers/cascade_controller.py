"""Position controller of two loops."""

from rotorsim.block import Block, Equations, In, Out, Param, State


class CascadeController(Block):
    """Control a position by a proportional loop around a proportional velocity loop.

    u = velocity_gain (position_gain (reference - q) - v),   velocity_lag v' = q' - v

    velocity_lag stands for the differentiation of the measured position: half a sample period for the difference of
    two samples, more with a filter.
    """

    source = "Janot, Gautier & Brunot, EMPS, Workshop on Nonlinear System Identification Benchmarks (2019)"

    reference = In(unit="m", doc="position that is wanted")
    displacement = In(unit="m", doc="position q that is measured")
    velocity = In(unit="m/s", doc="its rate q'")
    voltage = Out(unit="V", doc="voltage u to the drive")
    position_gain = Param(100.0, unit="1/s", low=0.0, doc="gain of the position loop")
    velocity_gain = Param(100.0, unit="V s/m", low=0.0, doc="gain of the velocity loop")
    velocity_lag = Param(1e-3, unit="s", above=0.0, doc="time constant of the velocity")
    observed = State(unit="m/s", doc="velocity v as the controller has it")

    def equations(self, p, u, x, t):
        wanted = p.position_gain * (u.reference - u.displacement)
        return Equations(
            outputs={"voltage": p.velocity_gain * (wanted - x.observed)},
            derivatives={"observed": (u.velocity - x.observed) / p.velocity_lag},
        )
