"""Clock: the angle, the speed and the angular acceleration of the shaft."""

from typing import Any

import numpy as np

from rotorsim.block import Block, Equations, Option, Out, Param, maximum, minimum, rows, where


class Clock(Block):
    """Give the shaft angle, speed and angular acceleration as functions of time.

    profile "constant":  W(t) = speed
    profile "ramp":      W(t) = speed + acceleration t, until speed_limit is reached; it falls if acceleration does
    profile "table":     W(t) interpolates speeds at times linearly, constant before and after

    The output acceleration is dW/dt, after the corner where W has one. A coast-down is a table that falls, or a ramp
    with acceleration < 0 and speed_limit = 0.

    angle "integral":  theta = phase + integral of W from 0 to t
    angle "omega_t":   theta = phase + W(t) t, as in the thesis' run-ups; the true speed of that angle is W + W' t

    All are closed forms of t without a state, so that forcing is computed once per instant.
    """

    source = "thesis section 2.4 (block Clock); angle omega_t: Figures 2-11, 3-4, 4-10, 5-5"
    category = "clock"

    theta = Out(unit="rad", doc="shaft angle")
    speed_port = Out(name="speed", unit="rad/s", doc="shaft speed W")
    acceleration_port = Out(name="acceleration", unit="rad/s^2", doc="angular acceleration dW/dt of the shaft")
    profile = Option("constant", choices=("constant", "ramp", "table"), kind=str, doc="law of the speed")
    angle = Option("integral", choices=("integral", "omega_t"), kind=str, doc="law of the angle")
    speed = Param(157.07963267948966, unit="rad/s", doc="speed (at t = 0 for a ramp; not used by a table)")
    acceleration = Param(0.0, unit="rad/s^2", doc="angular acceleration of a ramp, negative where it falls")
    speed_limit = Param(1e6, unit="rad/s", doc="speed at which a ramp ends")
    phase = Param(0.0, unit="rad", doc="angle at t = 0")
    times = Param([0.0, 1.0], shape="points", unit="s", doc="times of the table, rising")
    speeds = Param([0.0, 0.0], shape="points", unit="rad/s", doc="speeds of the table at these times")

    def check(self, values):
        """Refuse tables whose times do not rise and ramps that begin beyond their limit."""
        problems = []
        if self.option.profile == "table" and not (np.diff(values["times"]) > 0).all():
            problems.append("times of the table must rise")
        if self.option.profile == "ramp":
            way = float(values["speed_limit"]) - float(values["speed"])
            if float(values["acceleration"]) < 0 < way:
                what = "speed_limit is above the speed at which the falling ramp begins"
                problems.append(f"{what}; 0 rad/s lets the shaft coast down to rest")
            elif float(values["acceleration"]) >= 0 > way:
                problems.append("speed_limit is below the speed at which the ramp begins")
        return problems

    def equations(self, p, u, x, t):
        if self.option.profile == "constant":
            speed, turned, acceleration = p.speed, p.speed * t, 0.0 * t
        elif self.option.profile == "ramp":
            # a ramp without acceleration never ends; the largest number keeps the division harmless
            falls = p.acceleration < 0
            end = (p.speed_limit - p.speed) / where(falls, p.acceleration, maximum(p.acceleration, 1e-300))
            rising = minimum(t, end)
            speed = p.speed + p.acceleration * rising
            turned = p.speed * t + p.acceleration * rising * (t - 0.5 * rising)
            acceleration = where(t < end, p.acceleration, 0.0)
        else:
            speed, turned, acceleration = _table(rows(p.times), rows(p.speeds), t)
        if self.option.angle == "omega_t":
            turned = speed * t
        return Equations(outputs={"theta": turned + p.phase, "speed": speed, "acceleration": acceleration})


def _table(times: list[Any], speeds: list[Any], t: Any) -> tuple[Any, Any, Any]:
    """Return the interpolated speed, its integral from 0 to t (piecewise quadratic, exact), and its slope."""

    def integral(at: Any) -> Any:
        total = speeds[0] * minimum(at, times[0])
        for k in range(len(times) - 1):
            inside = minimum(maximum(at - times[k], 0.0), times[k + 1] - times[k])
            slope = (speeds[k + 1] - speeds[k]) / (times[k + 1] - times[k])
            total = total + inside * (speeds[k] + 0.5 * slope * inside)
        return total + speeds[-1] * maximum(at - times[-1], 0.0)

    speed, acceleration = speeds[0], 0.0 * t
    for k in range(len(times) - 1):
        slope = (speeds[k + 1] - speeds[k]) / (times[k + 1] - times[k])
        speed = speed + slope * minimum(maximum(t - times[k], 0.0), times[k + 1] - times[k])
        acceleration = where(t < times[k], acceleration, where(t < times[k + 1], slope, 0.0))
    return speed, integral(t) - integral(0.0), acceleration
