"""PID controller of a magnetic bearing."""

from rotorsim.blocks.common import controller as control

from rotorsim.block import Block, Equations, State


class Pid(Block):
    """Control a magnetic bearing by proportional, integral and derivative action on each axis.

    i = KP e + KI int e dt + KD u'        e = u - reference        thesis eq. (2.24)

    u: displacement. u' is the wired velocity; without that wire it is taken from the displacement through a filter,
    s / (1 + derivative_time_constant s). It acts on the displacement alone, so a jump of the reference gives no kick.
    Positive displacement gives positive current. Gains: thesis Table 2-1.
    """

    source = "thesis eq. (2.24), Table 2-1"

    ports = control.PORTS
    gains = control.GAINS
    integral = State(shape=2, unit="m s", doc="integral of e")
    filter = control.FILTER

    def equations(self, p, u, x, t):
        current, _, _, derivatives = control.pid_of(p, u, x)
        return Equations(outputs={"current": current}, derivatives=derivatives)
