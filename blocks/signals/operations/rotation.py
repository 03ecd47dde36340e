"""Rotation in the plane."""

from rotorsim.block import Block, Equations, In, Option, Out, cos, sin, vec


class Rotation(Block):
    """Turn a vector in the plane by an angle.

    output = [x cos a - y sin a, x sin a + y cos a],  a = multiple * angle        i.e. (x + j y) exp(j a)

    multiple = 1 takes a vector given in axes that turn with the rotor into fixed axes, multiple = -1 back.
    """

    source = "thesis eq. (2.28): complex notation r = u_x + j u_y"

    input = In(shape=2, unit=None, doc="vector [x, y]")
    angle = In(unit="rad", doc="angle from x towards y")
    output = Out(shape=2, unit=None, doc="turned vector")
    multiple = Option(1, kind=int, doc="whole number that multiplies the angle")

    def equations(self, p, u, x, t):
        c, s = cos(self.option.multiple * u.angle), sin(self.option.multiple * u.angle)
        a, b = u.input[0], u.input[1]
        return Equations(outputs={"output": vec(a * c - b * s, a * s + b * c)})
