"""Lead-lag controller of a magnetic bearing."""

from rotorsim.blocks.common import controller as control

from rotorsim.block import Block, Equations, Param, State


class LeadLag(Block):
    """Control a magnetic bearing by a lead-lag filter on each axis.

    i = gain (1 + lead_time_constant s) / (1 + lag_time_constant s) e        e = displacement - reference

    Stiffness at rest is that of a proportional gain; phase lead is largest at 1 / sqrt(lead lag time constants).
    State: lag_time_constant filtered' = e - filtered. The velocity port is there so that controllers can be swapped;
    it is not used.
    """

    source = "Schweitzer and Maslen, Magnetic Bearings (2009), chapter 8; Franklin et al., Feedback Control, 6.7"

    ports = control.PORTS_WITHOUT_VELOCITY
    gain = Param(12200.0, unit="A/m", doc="gain at rest")
    lead_time_constant = Param(2.5e-4, unit="s", low=0.0, doc="time constant of the numerator")
    lag_time_constant = Param(5e-5, unit="s", above=0.0, doc="time constant of the denominator")
    filtered = State(shape=2, unit="m", doc="error behind the lag")

    def equations(self, p, u, x, t):
        error = control.error_of(u)
        rate = (error - x.filtered) / p.lag_time_constant
        current = p.gain * (x.filtered + p.lead_time_constant * rate)
        return Equations(outputs={"current": current}, derivatives={"filtered": rate})
