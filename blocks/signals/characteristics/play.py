"""Play: backlash with memory."""

from rotorsim.block import Block, Equations, In, Option, Out, Param, State, maximum, minimum
from rotorsim.fault import Fault, Of, Sampled


class Play(Block):
    """Follow a signal through a gap, as behind the backlash of a gear, or with a share of itself, entry by entry.

    law "play":        output = held
    law "hysteresis":  output = input + share (held - input)
    held = value + dead(input - value)
    d value / dt = dead(input - value) / time_constant,  value(0) = initial
    dead(e) = e - width/2  above width/2,  e + width/2  below -width/2,  0 between

    Between the flanks the value stays where it is: that is its memory. On a flank held is width/2 behind the input, and
    the value follows it with a lag of `time_constant`. As that goes to zero held is the play operator, from which it
    differs, from a reversal to the next flank, by time_constant^2 times the acceleration of the input at the reversal.
    The right side is continuous, its slope is not: RK4 keeps its order but for the steps in which a flank is met.
    Hysteresis goes on with slope 1 - share where the value waits, in loops of height share width (Prandtl and
    Ishlinskii, of one play); with a negative share a spring has another beside it, behind dry friction.
    Stiffness: the eigenvalue on a flank is -1/time_constant; RK4 needs steps below 2.78 time_constant. From
    z = h / time_constant = 1.296 on its last stage overtakes the flank, as z (1 - z/2 + z^2/4) is above 1: behind an
    input that jumps the output is held too far back within that step.
    """

    source = "M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (1989), section 2 (here with a lag)"
    faults = tuple(
        Fault(
            physics=physics,
            enters="signal",
            through={"input": "output"},
            options={"law": physics},
            free=free,
            fixed={"time_constant": Sampled(0.8)},  # 1/1.25: with a step a sample no stage overtakes the flank
            sizes=tuple(free)[:1],
            simpler={"share": (1.0, "play")} if physics == "hysteresis" else {},
            law=law,
            confused_with=like,
            told_apart_by="amplitude: the loop over its input keeps its width",
        )
        for physics, free, law, like in (
            (
                "play",
                {"width": (Of("input", 0.02), Of("input", 0.2))},
                "waits for the width of the gap after every reversal",
                ("hysteresis", "lag", "dead_zone"),
            ),
            (
                "hysteresis",
                {"share": (0.3, -0.3), "width": (Of("input", 0.1), Of("input", 0.5))},
                "loops that do not depend on how fast its input moves",
                ("play", "lag", "dry_friction"),
            ),
        )
    )

    input = In(shape="signal", unit=None, doc="signal to follow")
    output = Out(shape="signal", unit=None, doc="signal behind the play, shape of the input")
    law = Option("play", choices=("play", "hysteresis"), kind=str, doc="what is behind the gap")
    width = Param(1.0, unit=None, low=0.0, doc="full width of the gap (the backlash)")
    share = Param(1.0, doc="of the signal that goes through the gap (law hysteresis)")
    time_constant = Param(1e-3, unit="s", above=0.0, doc="time constant with which the value follows on a flank")
    initial = Param(0.0, shape="signal", unit=None, doc="value at the start")
    value = State(
        shape="signal", unit=None, init="initial", begins="input", doc="where the other side of the gap was left"
    )

    def equations(self, p, u, x, t):
        apart, half = u.input - x.value, p.width / 2
        pushed = maximum(apart - half, 0.0) + minimum(apart + half, 0.0)
        held = x.value + pushed
        hysteresis = self.option.law == "hysteresis"
        return Equations(
            outputs={"output": u.input + p.share * (held - u.input) if hysteresis else held},
            derivatives={"value": pushed / p.time_constant},
            events={"upper": apart - half, "lower": apart + half},
        )
