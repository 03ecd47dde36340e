"""Polar form."""

from rotorsim.block import Block, Equations, In, Out, arctan2, sqrt


class Polar(Block):
    """Output amplitude and angle of a vector in the plane, such as a whirling displacement x + j y.

    amplitude = sqrt(x^2 + y^2),  angle = arctan2(y, x) in (-pi, pi]

    Neither has a finite derivative at the origin.
    """

    source = "Simulink: Complex to Magnitude-Angle"

    input = In(shape=2, unit=None, doc="vector [x, y]")
    amplitude = Out(unit=None, doc="amplitude")
    angle = Out(unit="rad", doc="angle from x towards y")

    def equations(self, p, u, x, t):
        a, b = u.input[0], u.input[1]
        return Equations(outputs={"amplitude": sqrt(a * a + b * b), "angle": arctan2(b, a)})
