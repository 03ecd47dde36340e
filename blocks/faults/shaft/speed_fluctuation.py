"""Fluctuation of the speed of a shaft."""

from math import pi
from typing import Any

from rotorsim.block import Block, Equations, In, Out, Param, cos, sin
from rotorsim.fault import Fault, Lines


def _fault(physics: str, recorded: str, **words: Any) -> Fault:
    return Fault(
        physics=physics,
        enters="wire",
        between=("clock", "*"),
        through={"theta": "angle", "speed": "rate", "acceleration": "angular_acceleration"},
        recorded=recorded,
        joined=True,
        free={"amplitude": (1e-3,)},
        fixed={"frequency": Lines()},
        **words,
    )


class SpeedFluctuation(Block):
    """Let the angle of a shaft swing about that of a clock.

    angle = theta + amplitude sin(frequency t + phase),   its rate = W + amplitude frequency cos(frequency t + phase)
    angular_acceleration = W' - amplitude frequency^2 sin(frequency t + phase)

    It stands between the clock and everything that takes the angle. Each order k gets sidebands at k W +- frequency. A
    disc that swings by torsion against a drive that turns evenly is the same, but for the pulses of the drive. What
    takes the speed alone, a gyroscopic moment, keeps the mean: of the moment I_p W psi' of a disc whose slope is psi,
    amplitude frequency / W, beside twice that of its unbalance, is left out.
    """

    source = "Friswell et al. (2010), ch. 9 (torsion); Randall, Vibration-based Condition Monitoring (2011), ch. 2"
    faults = (
        _fault(
            "speed_fluctuation",
            "after",
            law="sidebands of every order, at a frequency of their own",
            confused_with=("base_excitation", "torsion_coupling"),
            told_apart_by="an encoder of many pulses a turn; sidebands grow with the order, a shaken base has one line",
        ),
        _fault(
            "torsion_coupling",
            "before",
            law="sidebands at the torsional frequency: the disc swings, the end with the pulses does not",
            confused_with=("speed_fluctuation",),
            told_apart_by="pulses at the disc: they swing where the drive's do not",
        ),
    )

    theta = In(unit="rad", doc="angle without the swing")
    speed = In(unit="rad/s", doc="speed W without the swing")
    acceleration = In(unit="rad/s^2", optional=True, doc="angular acceleration W' without the swing; unwired: zero")
    angle = Out(unit="rad", doc="angle of the shaft")
    rate = Out(unit="rad/s", doc="speed of the shaft")
    angular_acceleration = Out(unit="rad/s^2", doc="angular acceleration of the shaft")
    amplitude = Param(1e-3, unit="rad", low=0.0, doc="amplitude eps of the swing")
    frequency = Param(2 * pi * 10, unit="rad/s", above=0.0, doc="frequency nu of the swing")
    phase = Param(0.0, unit="rad", doc="phase at t = 0")

    def equations(self, p, u, x, t):
        inside = p.frequency * t + p.phase
        swing = -p.amplitude * p.frequency**2 * sin(inside)
        return Equations(
            outputs={
                "angle": u.theta + p.amplitude * sin(inside),
                "rate": u.speed + p.amplitude * p.frequency * cos(inside),
                "angular_acceleration": swing if u.acceleration is None else u.acceleration + swing,
            }
        )
