"""A gain that depends on another signal."""

from rotorsim.block import Block, Equations, In, Option, Out, Param, absolute, tanh
from rotorsim.fault import Fault, Of

_KNEE = {"change": (1.0, -0.5), "knee": (Of("other", 0.2), Of("other", 0.5)), "width": (Of("other", 0.1),)}
_LAWS = {
    "linear": (
        {"slope": (Of("other", 0.1, power=-1), Of("other", -0.1, power=-1))},
        ("slope",),
        "proportional to the signal and to another one",
    ),
    "square": (
        {"curvature": (Of("other", 0.1, power=-2), Of("other", -0.1, power=-2))},
        ("curvature",),
        "proportional to the signal and to the square of another one",
    ),
    "knee": (_KNEE, ("change",), "proportional to the signal; another factor where another signal is large"),
    "divisor": (_KNEE, ("change",), "inversely proportional to what changes where another signal is large"),
}


class ScheduledGain(Block):
    """Multiply a signal by a factor that depends on another signal, entry by entry.

    law "linear":  factor = 1 + slope other
    law "square":  factor = 1 + curvature other^2
    law "knee":    factor = 1 + change S
    law "divisor": factor = 1 / (1 + change S)
    S = (1 + tanh((|other| - knee) / width)) / 2
    output = factor input

    Behind a block that is linear in a parameter, that parameter depends on the other signal: behind a spring, its
    stiffness. By the law "divisor" it is one that divides: behind the voltage across a coil, the inductance, which
    falls beyond the knee as the iron saturates (change between -1 and 0); behind a force, the mass.
    """

    source = "W. J. Rugh, J. S. Shamma, Automatica 36 (2000) 1401-1425 (scheduled gains)"
    faults = tuple(
        Fault(
            physics="signal_dependent_gain",
            enters="signal",
            through={"input": "output"},
            argument="other",
            own="static_nonlinearity" if law in ("linear", "square") else "",
            options={"law": law},
            free=free,
            sizes=sizes,
            law=said,
            confused_with=("static_nonlinearity", "nonlinear_coupling"),
            told_apart_by="the same input while the other signal is held elsewhere",
        )
        for law, (free, sizes, said) in _LAWS.items()
    )

    input = In(shape="signal", unit=None, doc="signal")
    other = In(shape="signal", unit=None, doc="signal that the factor depends on")
    output = Out(shape="signal", unit=None, doc="signal with the varying gain, shape of the input")
    law = Option("linear", choices=tuple(_LAWS), kind=str, doc="how the factor depends on the other signal")
    slope = Param(0.0, unit=None, doc="change of the factor per other signal (law linear)")
    curvature = Param(0.0, unit=None, doc="change of the factor per its square (law square)")
    change = Param(0.0, unit=None, low=-1.0, doc="change of the factor, or of the divisor, far beyond the knee")
    knee = Param(1.0, unit=None, above=0.0, doc="magnitude of the other signal where half of it is reached")
    width = Param(0.1, unit=None, above=0.0, doc="half width of the transition, unit of the other signal")

    def equations(self, p, u, x, t):
        o, law = u.other, self.option.law
        if law in ("linear", "square"):
            return Equations(
                outputs={"output": u.input * (1 + (p.slope * o if law == "linear" else p.curvature * o * o))}
            )
        factor = 1 + p.change * (1 + tanh((absolute(o) - p.knee) / p.width)) / 2
        return Equations(outputs={"output": u.input / factor if law == "divisor" else u.input * factor})
