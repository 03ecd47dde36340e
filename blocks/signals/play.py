"""Play: backlash with memory."""

from rotorsim.block import Block, Equations, In, Out, Param, State, maximum, minimum


class Play(Block):
    """Follow a signal through a gap, as behind the backlash of a gear, entry by entry.

    d value / dt = dead(input - value) / time_constant,  value(0) = initial,  output = value
    dead(e) = e - width/2  above width/2,  e + width/2  below -width/2,  0 between

    Between the flanks the output stays where it is: that is its memory. On a flank it follows width/2 behind the input
    with a lag of `time_constant`; as that goes to zero this is the play operator, from which it differs by at most
    time_constant times the largest rate of the input. The right side is continuous, its slope is not: RK4 keeps its
    order but for the steps in which a flank is met.
    Stiffness: the eigenvalue on a flank is -1/time_constant; RK4 needs steps below 2.78 time_constant.
    """

    source = "M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (1989), section 2 (play; here with a lag)"

    input = In(shape="signal", unit=None, doc="signal to follow")
    output = Out(shape="signal", unit=None, doc="signal behind the play, shape of the input")
    width = Param(1.0, unit=None, low=0.0, doc="full width of the gap (the backlash)")
    time_constant = Param(1e-3, unit="s", above=0.0, doc="time constant with which a flank is followed")
    initial = Param(0.0, shape="signal", unit=None, doc="output at the start")
    value = State(shape="signal", unit=None, init="initial", doc="output")

    def equations(self, p, u, x, t):
        apart, half = u.input - x.value, p.width / 2
        pushed = maximum(apart - half, 0.0) + minimum(apart + half, 0.0)
        return Equations(
            outputs={"output": x.value},
            derivatives={"value": pushed / p.time_constant},
            events={"upper": apart - half, "lower": apart + half},
        )
