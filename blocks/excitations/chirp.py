"""Sine sweep, a test signal."""

from rotorsim.block import Block, Equations, Option, Out, Param, cos, exp, log, maximum, minimum, sin, where


class Chirp(Block):
    """Output a sine whose frequency rises from one value to another, and its rate of change.

    output = amplitude sin(phi(tau)), rate = d output / dt, tau = t - start; both are zero before 0 and after duration

    spacing "logarithmic":  phi = first duration / L (exp(L tau / duration) - 1), L = ln(last / first)
    spacing "linear":       phi = first tau + (last - first) tau^2 / (2 duration)

    Added to the signal of a sensor it shows the sensitivity of a bearing's loop (`rotorsim margins`).
    """

    source = "Simulink: Chirp Signal; ISO 14839-3:2006 (test signal E)"
    category = "elementary"

    output = Out(shape="signal", unit=None, doc="sweep, shape of amplitude")
    rate = Out(shape="signal", unit=None, doc="its rate of change, per second")
    spacing = Option("logarithmic", choices=("logarithmic", "linear"), kind=str, doc="law of the frequency")
    amplitude = Param(1.0, shape="signal", unit=None, doc="amplitude, 0 to peak")
    first = Param(6.283185307179586, unit="rad/s", doc='frequency at the start (write "1 Hz" for one cycle per second)')
    last = Param(6283.185307179586, unit="rad/s", doc="frequency at the end")
    start = Param(0.0, unit="s", doc="time at which it begins")
    duration = Param(1.0, unit="s", doc="how long it lasts")

    def check(self, values):
        """Refuse sweeps that do not last, and logarithmic ones from or to zero."""
        problems = [] if float(values["duration"]) > 0 else ["duration must be above zero"]
        if self.option.spacing == "logarithmic" and min(float(values["first"]), float(values["last"])) <= 0:
            problems.append("a logarithmic sweep needs frequencies above zero")
        return problems

    def equations(self, p, u, x, t):
        tau = minimum(maximum(t - p.start, 0.0), p.duration)
        if self.option.spacing == "linear":
            slope = (p.last - p.first) / p.duration
            angle, speed = (p.first + 0.5 * slope * tau) * tau, p.first + slope * tau
        else:
            octaves = log(p.last / p.first)  # of e; a sweep that stays at one frequency has none
            some = where(octaves * octaves < 1e-16, 1e-8, octaves)
            grown = exp(some * tau / p.duration)
            angle, speed = p.first * p.duration / some * (grown - 1.0), p.first * grown
        inside = where(t < p.start, 0.0, where(t <= p.start + p.duration, 1.0, 0.0))
        return Equations(
            outputs={"output": p.amplitude * sin(angle) * inside, "rate": p.amplitude * speed * cos(angle) * inside},
            events={"start": t - p.start, "end": t - p.start - p.duration},  # that no step passes over it
        )
