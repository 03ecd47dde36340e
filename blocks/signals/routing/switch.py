"""Switch."""

from rotorsim.block import Block, Equations, In, Out, Param, where


class Switch(Block):
    """Pass one of two signals, chosen by a third.

    output = above for control >= threshold,  below for control < threshold
    """

    source = "Simulink: Switch"

    control = In(unit=None, doc="signal that chooses, scalar")
    above = In(shape="signal", unit=None, doc="signal passed while control >= threshold")
    below = In(shape="signal", unit=None, doc="signal passed while control < threshold")
    output = Out(shape="signal", unit=None, doc="the chosen signal, shape of above and below")
    threshold = Param(0.0, unit=None, doc="value of control at which the switch changes over")

    def equations(self, p, u, x, t):
        return Equations(
            outputs={"output": where(u.control >= p.threshold, u.above, u.below)},
            events={"switch": u.control - p.threshold},
        )
