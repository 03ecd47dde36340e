"""Multi-harmonic reference signals."""

from rotorsim.block import Block, Equations, In, Option, Out, cos, matrix, sin


class Reference(Block):
    """Output complex reference signals that turn at multiples of the shaft angle.

    s_i = cos(i theta) + j sin(i theta)        thesis eq. (2.48), Figure 2-6; row of harmonic i: [cos, sin]

    Analysed like displacement and current, they give the phase that each harmonic must be corrected by, (2.49)-(2.51).
    """

    source = "thesis eq. (2.48), Figure 2-6"
    category = "elementary"

    theta = In(unit="rad", doc="shaft angle")
    signal = Out(shape=("harmonics", 2), unit="1", doc="[cos(i theta), sin(i theta)] for each harmonic")
    harmonics = Option([-5, -3, -1, 0, 1, 2, 3, 5, 7], kind=int, doc="harmonic numbers i, one row each")

    def equations(self, p, u, x, t):
        table = [[cos(i * u.theta), sin(i * u.theta)] for i in self.option.harmonics]
        return Equations(outputs={"signal": matrix(table)})
