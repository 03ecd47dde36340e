"""PD controller of a magnetic bearing."""

from rotorsim.blocks.common import controller as control

from rotorsim.block import Block, Equations, Param


class Pd(Block):
    """Control a magnetic bearing by proportional and derivative action on each axis.

    i = KP e + KD u'        e = u - reference

    u: displacement. u' is the wired velocity; without that wire it is taken from the displacement through a filter,
    s / (1 + derivative_time_constant s). Without integral action a constant load shifts the rotor.
    """

    source = "thesis eq. (2.24) without its integral term; Schweitzer and Maslen, Magnetic Bearings (2009), section 2.1"

    ports = control.PORTS
    KP = Param(12200.0, unit="A/m", doc="proportional gain")
    KD = Param(3.0, unit="A s/m", doc="derivative gain")
    filter = control.FILTER

    def equations(self, p, u, x, t):
        velocity, derivatives = control.velocity_of(p, u, x)
        return Equations(outputs={"current": p.KP * control.error_of(u) + p.KD * velocity}, derivatives=derivatives)
