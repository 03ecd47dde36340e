"""PID controller with a notch filter."""

from rotorsim.blocks.common import controller as control

from rotorsim.block import Block, Equations, Param, State


class NotchPid(Block):
    """Control a magnetic bearing by PID action followed by a notch filter on each axis.

    i = N(s) (KP e + KI int e dt + KD u'),  N(s) = (s^2 + d b w s + w^2) / (s^2 + b w s + w^2)
    w = notch_frequency, b = notch_width, d = notch_depth;  |N(j w)| = d, and N = 1 far from w

    e = u - reference, u: displacement; u' is the wired velocity or the filtered derivative, as in `pid`.
    With d = 0 the width b is the bandwidth at -3 dB divided by the frequency. A fixed notch inside the bandwidth of
    the loop takes away phase below its frequency: check stability with `rotorsim modes`.
    Notch states: position' = w rate, rate' = w (i0 - b rate - position), i = i0 - b (1 - d) rate.
    """

    source = "thesis eq. (2.24); Schweitzer and Maslen, Magnetic Bearings (2009), section 8.3 (notch filters)"

    ports = control.PORTS
    gains = control.GAINS
    derivative_time_constant = control.TIME_CONSTANT
    notch_frequency = Param(2513.2741228718346, unit="rad/s", above=0.0, doc='centre of the notch (default "400 Hz")')
    notch_width = Param(0.1, above=0.0, doc="bandwidth of the notch divided by its frequency")
    notch_depth = Param(0.1, low=0.0, high=1.0, doc="gain at the centre: 0 blocks, 1 is no notch")
    initial_displacement = control.START
    integral = State(shape=2, unit="m s", doc="integral of e")
    filtered = control.FILTERED
    notch_position = State(shape=2, unit="A", doc="first state of the notch; the current, when at rest")
    notch_rate = State(shape=2, unit="A", doc="second state of the notch; zero when at rest")

    def equations(self, p, u, x, t):
        demand, _, _, derivatives = control.pid_of(p, u, x)
        derivatives["notch_position"] = p.notch_frequency * x.notch_rate
        derivatives["notch_rate"] = p.notch_frequency * (demand - p.notch_width * x.notch_rate - x.notch_position)
        current = demand - p.notch_width * (1 - p.notch_depth) * x.notch_rate
        return Equations(outputs={"current": current}, derivatives=derivatives)
