"""Hysteresis with smooth transitions (Bouc-Wen)."""

from rotorsim.block import Block, Equations, In, Out, Param, State, absolute, sqrt

_ZERO = 1e-6  # added to |z| as a root of squares, so that its powers have derivatives at zero


class Hysteresis(Block):
    """Output what depends on a signal and on its past, in loops that do not depend on how fast it moves (Bouc-Wen).

    output = slope (ratio input + (1 - ratio) knee z)
    knee dz/dt = rate - |z|^(exponent - 1) (shape |rate| z + (1 - shape) rate |z|),  z(0) = initial

    rate: the time derivative of the input, as a wire of its own. z stays between -1 and 1. From z = 0 the output begins
    with `slope`, bends at the knee, and goes on with ratio slope. shape 1/2: after a reversal it goes back straight,
    with the first slope, up to z = 0. exponent: how sharp the knee is; dry friction behind a spring as it grows. With
    exponent 1 and shape 1/2 loading from zero is z = 1 - exp(-input/knee). |z| is sqrt(z^2 + 1e-12).
    Stiffness: the eigenvalue at the limit is -exponent |rate| / knee, so RK4 needs steps in which the input moves by
    less than 2.78 knee / exponent.
    """

    source = "Y.-K. Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249-263; F. Ikhouane, J. Rodellar (2007), chapter 2"

    input = In(shape="signal", unit=None, doc="signal, such as a displacement")
    rate = In(shape="signal", unit=None, doc="its time derivative, such as a velocity")
    output = Out(shape="signal", unit=None, doc="what follows with hysteresis, such as a force; shape of the input")
    slope = Param(1.0, unit=None, doc="output per input from z = 0 on")
    ratio = Param(0.1, low=0.0, high=1.0, doc="slope beyond the knee, of the first one")
    knee = Param(1.0, unit=None, above=0.0, doc="input at which the two slopes meet")
    exponent = Param(1.0, low=1.0, doc="how sharp the knee is")
    shape = Param(0.5, low=0.0, high=1.0, doc="share of the loss: 1 fat loops, 0 none, and z beyond 1 would grow")
    initial = Param(0.0, shape="signal", doc="z at the start")
    z = State(shape="signal", init="initial", doc="hysteretic part, between -1 and 1")

    def equations(self, p, u, x, t):
        size = sqrt(x.z * x.z + _ZERO**2)
        bend = size ** (p.exponent - 1.0) * (p.shape * absolute(u.rate) * x.z + (1.0 - p.shape) * u.rate * size)
        return Equations(
            outputs={"output": p.slope * (p.ratio * u.input + (1.0 - p.ratio) * p.knee * x.z)},
            derivatives={"z": (u.rate - bend) / p.knee},
        )
