"""Dry friction on top of a signal that is proportional to a velocity."""

from rotorsim.block import Block, Equations, In, Out, Param, tanh
from rotorsim.fault import Fault, Of


class DryFriction(Block):
    """Add a constant with the sign of the signal, entry by entry: Coulomb friction, where that is a velocity.

    output = input + level tanh(input / width)
    """

    source = "Simulink: Coulomb and Viscous Friction (here with a finite slope about zero)"
    faults = (
        Fault(
            physics="dry_friction",
            enters="signal",
            through={"input": "output"},
            free={"level": (Of("input", 0.1), Of("input", -0.1))},
            fixed={"width": Of("input", 0.01)},
            sizes=("level",),
            law="a jump where the signal changes its sign; its share falls with the amplitude",
            confused_with=("dead_zone", "gain_error"),
            told_apart_by="amplitude: its share falls as it grows",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="signal with friction, shape of the input")
    level = Param(1.0, unit=None, doc="friction beyond the width, unit of the input; negative: stiction that drives")
    width = Param(0.01, unit=None, above=0.0, doc="signal over which it changes its sign, unit of the input")

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": u.input + p.level * tanh(u.input / p.width)})
