"""Sampled PID controller with computational delay."""

from rotorsim.blocks.common import controller as control
from rotorsim.blocks.common import plane

from rotorsim.block import Block, DiscreteState, Equations, In, Option, Out, Param, rows, vec, where


class DiscretePid(Block):
    """Control a magnetic bearing by a sampled PID law with computational delay on each axis.

    at hit k, T = sample_time, T_f = derivative_time_constant, u: displacement, e = u - reference:
    s[k] = s[k-1] + T e[k]                                              (backward Euler)
    v[k] = (T_f v[k-1] + u[k] - u[k-1]) / (T_f + T), or the wired velocity
    c[k] = KP e[k] + KI s[k] + KD v[k]
    current = c[k - delay_samples], held until hit k + 1

    anti_windup "clamp": c is limited to +- current_limit on each axis, and s keeps its value while the unlimited
    current is beyond the limit and e would drive it further. The hold adds half a sample of delay on average.
    """

    source = "Astrom and Wittenmark, Computer-Controlled Systems, section 8.5; thesis, after eq. (2.30) (delay)"

    displacement = control.DISPLACEMENT
    velocity = In(shape=2, unit="m/s", optional=True, doc="rotor velocity [x, y]; unwired: filtered difference")
    reference = control.REFERENCE
    current = Out(shape=2, unit="A", doc="control current [x, y], held between hits")
    gains = control.GAINS
    sample_time = Param(1e-4, unit="s", above=0.0, doc="time between hits")
    derivative_time_constant = Param(0.0, unit="s", low=0.0, doc="filter of the difference; 0: plain difference")
    current_limit = Param(10.0, unit="A", above=0.0, doc='largest current, with anti_windup "clamp"')
    initial_displacement = Param([0.0, 0.0], shape=2, unit="m", doc="displacement before the first hit")
    delay_samples = Option(1, kind=int, low=0, high=100, doc="computational delay in samples")
    anti_windup = Option("off", choices=("off", "clamp"), doc="limit the current and stop the integral at the limit")
    integral = DiscreteState(shape=2, unit="m s", doc="s, integral of e")
    previous = DiscreteState(
        shape=2, unit="m", init="initial_displacement", unless_wired="velocity", doc="displacement at the hit before"
    )
    difference = DiscreteState(shape=2, unit="m/s", unless_wired="velocity", doc="v, filtered difference")
    line = DiscreteState(shape=lambda o: (o.delay_samples + 1, 2), unit="A", doc="computed currents, newest first")

    def equations(self, p, u, x, t):
        error = control.error_of(u)
        update = {}
        velocity = u.velocity
        if velocity is None:
            filtered = p.derivative_time_constant * x.difference + u.displacement - x.previous
            velocity = update["difference"] = filtered / (p.derivative_time_constant + p.sample_time)
            update["previous"] = u.displacement
        integral = x.integral + p.sample_time * error
        computed = p.KP * error + p.KI * integral + p.KD * velocity
        if self.option.anti_windup == "clamp":
            excess = computed - plane.within(computed, p.current_limit)
            integral = where(excess * p.KI * error > 0, x.integral, integral)
            computed = plane.within(p.KP * error + p.KI * integral + p.KD * velocity, p.current_limit)
        update["integral"] = integral
        line = rows(x.line)
        update["line"] = vec(computed.T, *line[:-1])
        return Equations(outputs={"current": line[-1].T}, update=update)
