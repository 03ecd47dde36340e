"""PID controller with a notch filter."""

from typing import Any

from rotorsim.block import Block, Equations, In, Out, Param, State


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
    category = "controller"

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] at the bearing")
    velocity = In(shape=2, unit="m/s", optional=True, doc="rotor velocity [x, y]; unwired: filtered derivative")
    reference = In(shape=2, unit="m", optional=True, doc="set-point of the displacement; unwired: zero")
    current = Out(shape=2, unit="A", doc="control current [x, y]")
    KP = Param(12200.0, unit="A/m", doc="proportional gain")
    KI = Param(2000.0, unit="A/(m s)", doc="integral gain")
    KD = Param(3.0, unit="A s/m", doc="derivative gain")
    derivative_time_constant = Param(1e-4, unit="s", above=0.0, doc="filter of the derivative if velocity is unwired")
    notch_frequency = Param(2513.2741228718346, unit="rad/s", above=0.0, doc='centre of the notch (default "400 Hz")')
    notch_width = Param(0.1, above=0.0, doc="bandwidth of the notch divided by its frequency")
    notch_depth = Param(0.1, low=0.0, high=1.0, doc="gain at the centre: 0 blocks, 1 is no notch")
    initial_displacement = Param(
        [0.0, 0.0], shape=2, unit="m", doc="displacement before the start, for the filter of the derivative"
    )
    integral = State(shape=2, unit="m s", doc="integral of e")
    filtered = State(
        shape=2, unit="m", init="initial_displacement", unless_wired="velocity", doc="displacement behind the filter"
    )
    notch_position = State(shape=2, unit="A", doc="first state of the notch; the current, when at rest")
    notch_rate = State(shape=2, unit="A", doc="second state of the notch; zero when at rest")

    def equations(self, p: Any, u: Any, x: Any, t: Any) -> Equations:
        error = u.displacement if u.reference is None else u.displacement - u.reference
        derivatives = {"integral": error}
        velocity = u.velocity
        if velocity is None:
            velocity = derivatives["filtered"] = (u.displacement - x.filtered) / p.derivative_time_constant
        demand = p.KP * error + p.KI * x.integral + p.KD * velocity
        derivatives["notch_position"] = p.notch_frequency * x.notch_rate
        derivatives["notch_rate"] = p.notch_frequency * (demand - p.notch_width * x.notch_rate - x.notch_position)
        current = demand - p.notch_width * (1 - p.notch_depth) * x.notch_rate
        return Equations(outputs={"current": current}, derivatives=derivatives)
