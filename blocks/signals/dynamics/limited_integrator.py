"""Integrator with limits."""

from rotorsim.block import Block, Equations, In, Out, Param, State, maximum, minimum
from rotorsim.fault import Fault, Of, Sampled


class LimitedIntegrator(Block):
    """Integrate a signal over time and stop at limits, entry by entry: no windup beyond them.

    d value / dt = input - beyond / time_constant,  value(0) = initial,  output = value - beyond
    beyond = value - upper  above upper,  value - lower  below lower,  0 between

    At a limit the value goes on by time_constant times the input, and is back as fast; that goes to zero with it.
    Stiffness: its eigenvalue there is -1/time_constant; RK4 needs steps below 2.78 time_constant.
    """

    source = "Simulink: Integrator Limited (here with a time constant)"
    faults = (
        Fault(
            physics="integrator_limit",
            enters="replace",
            of=("integrator",),
            free={"lower": (Of("output", -0.9), Of("output", -0.5)), "upper": (Of("output", 0.9), Of("output", 0.5))},
            fixed={"time_constant": Sampled(0.5)},  # RK4 is stable with a step a sample
            most={"lower": Of("output", 1e3), "upper": Of("output", 1e3)},
            law="stops at a limit, and leaves it as soon as its input changes its sign",
            confused_with=("saturation", "integrator_leak"),
            told_apart_by="amplitude: below a limit nothing is left",
        ),
    )

    input = In(shape="signal", unit=None, doc="rate of change")
    output = Out(shape="signal", unit=None, doc="integral within the limits, shape of the input")
    lower = Param(-1.0, unit=None, doc="lower limit")
    upper = Param(1.0, unit=None, doc="upper limit")
    time_constant = Param(1e-3, unit="s", above=0.0, doc="time constant of the stop")
    initial = Param(0.0, shape="signal", unit=None, doc="value at the start")
    value = State(shape="signal", unit=None, init="initial", doc="integral")

    def check(self, values):
        """Refuse limits in the wrong order."""
        lower, upper = float(values["lower"]), float(values["upper"])
        return [] if lower <= upper else [f"lower = {lower:g} is above upper = {upper:g}"]

    def equations(self, p, u, x, t):
        beyond = maximum(x.value - p.upper, 0.0) + minimum(x.value - p.lower, 0.0)
        return Equations(
            outputs={"output": x.value - beyond},
            derivatives={"value": u.input - beyond / p.time_constant},
            events={"upper": x.value - p.upper, "lower": x.value - p.lower},
        )
