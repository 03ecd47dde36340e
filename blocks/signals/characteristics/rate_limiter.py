"""Rate limiter."""

from rotorsim.block import Block, Equations, In, Out, Param, State, maximum, minimum
from rotorsim.fault import Fault, Of, Sampled


class RateLimiter(Block):
    """Follow a signal no faster than at given rates, entry by entry.

    d value / dt = min(max(wanted, falling), rising),  value(0) = initial,  output = value
    wanted = (input - value) / time_constant + (input - past) / time_constant
    d past / dt = (input - past) / time_constant

    Below the limits the output follows as (1 + 2 s T) / (1 + s T)^2, T = time_constant: without delay, in error by T^2
    times the acceleration of the input. A jump of the input is followed at the limit at once.
    Stiffness: the eigenvalues are -1/T; RK4 needs steps below 2.78 T.
    """

    source = "Simulink: Rate Limiter (here continuous, with a lag of second order)"
    faults = (
        Fault(
            physics="rate_limit",
            enters="signal",
            through={"input": "output"},
            free={
                "rising": tuple(Of("input", part, per=Sampled(1.0)) for part in (0.1, 0.01)),
                "falling": tuple(Of("input", -part, per=Sampled(1.0)) for part in (0.1, 0.01)),
            },
            fixed={"time_constant": Sampled(0.5)},
            law="straight flanks; nothing while the signal is slow",
            confused_with=("saturation", "lag"),
            told_apart_by="frequency at small amplitude: below the rate nothing is left",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal to follow")
    output = Out(shape="signal", unit=None, doc="limited signal, shape of the input")
    rising = Param(1.0, unit=None, low=0.0, doc="largest rate upwards, per second")
    falling = Param(-1.0, unit=None, high=0.0, doc="largest rate downwards, per second, not positive")
    time_constant = Param(1e-3, unit="s", above=0.0, doc="time constant with which the output follows")
    initial = Param(0.0, shape="signal", unit=None, doc="output at the start")
    value = State(shape="signal", unit=None, init="initial", begins="input", doc="output")
    past = State(
        shape="signal", unit=None, init="initial", begins="input", doc="input a time constant ago, for its slope"
    )

    def check(self, values):
        """Refuse a limiter that can never move."""
        return (
            ["rising and falling are both 0: the output could never move"]
            if (float(values["rising"]) == 0.0 and float(values["falling"]) == 0.0)
            else []
        )

    def equations(self, p, u, x, t):
        slope = (u.input - x.past) / p.time_constant
        wanted = (u.input - x.value) / p.time_constant + slope
        return Equations(
            outputs={"output": x.value},
            derivatives={"value": minimum(maximum(wanted, p.falling), p.rising), "past": slope},
            events={"rising": wanted - p.rising, "falling": wanted - p.falling},
        )
