"""A signal that acts on another: cross-talk, a force that depends on a position, a torque that depends on an angle."""

from rotorsim.block import Block, Equations, In, Option, Out, Param, cos, maximum, sin
from rotorsim.fault import Fault, Of

_LAWS = {
    "linear": (
        "cross_talk",
        {"linear": (Of("other", 0.1, power=-1), Of("other", -0.1, power=-1))},
        ("linear",),
        "proportional to another signal",
        ("nonlinear_coupling", "position_ripple"),
    ),
    "polynomial": (
        "nonlinear_coupling",
        {
            "linear": (Of("other", 0.1, power=-1),),
            "quadratic": (Of("other", 0.01, power=-2),),
            "cubic": (Of("other", 0.1, power=-3), Of("other", -0.1, power=-3)),
        },
        ("linear", "quadratic", "cubic"),
        "grows with another signal, its square and its cube",
        ("cross_talk", "position_ripple"),
    ),
    "periodic": (
        "position_ripple",
        {
            "sine": (0.1, -0.1),
            "cosine": (0.01,),
            "wave_number": (1.0, Of("other", 3.0, power=-1), Of("other", 10.0, power=-1)),
        },
        ("sine", "cosine"),
        "repeats itself as another signal goes on: an angle, a position",
        ("cross_talk", "nonlinear_coupling"),
    ),
    "stop": (
        "one_sided_stop",
        {"gap": (Of("other", 0.3), Of("other", 0.7)), "slope": (Of("other", -0.1, power=-1),)},
        ("slope",),
        "nothing until another signal reaches a gap; one side only",
        ("nonlinear_coupling", "asymmetry"),
    ),
}
_SIDES = {"stop": ({"side": 1.0}, {"side": -1.0})}
# A polynomial or a long wave is linear at first, so is a stop that is always met, about a constant; a wave of which
# less than a period shows is a polynomial; whatever depends on a signal that rests is an offset.
_HELD = {
    "linear": ("offset",),
    "polynomial": ("cross_talk", "integrator_leak", "offset"),
    "periodic": ("cross_talk", "integrator_leak", "nonlinear_coupling", "static_nonlinearity", "offset"),
    "stop": ("cross_talk", "integrator_leak", "offset"),
}
_OWN = {"linear": "gain_error", "polynomial": "static_nonlinearity", "stop": "one_sided_stop"}


class Coupling(Block):
    """Add a function of another signal to a signal, entry by entry.

    law "linear":      d = linear other
    law "polynomial":  d = linear other + quadratic other^2 + cubic other^3
    law "periodic":    d = sine sin(wave_number other) + cosine (cos(wave_number other) - 1)
    law "stop":        d = slope max(side other - gap, 0)
    output = input + d

    Cross-talk between sensors is linear; a spring that was left out, linear or a polynomial of the position; the weight
    of an off-centre mass, cogging and force ripple are periodic in an angle (wave_number 1: once a turn) or a position;
    a buffer or an end stop pushes back (slope times side below zero) once a position reaches it.
    """

    source = (
        "R. Isermann, Fault-Diagnosis Systems (2006), ch. 5; D. Hanselman, Brushless Motors (2012), ch. 9; "
        "S. W. Shaw & P. J. Holmes, J. Sound Vib. 90 (1983) 129-155 (stop)"
    )
    faults = tuple(
        Fault(
            physics=physics,
            enters="signal",
            through={"input": "output"},
            argument="other",
            own=_OWN.get(law, ""),
            of_integral="integrator_leak" if law == "linear" else "",
            options={"law": law},
            free=free,
            fixed=fixed,
            sizes=sizes,
            holds=_HELD.get(law, ()),
            adds=True,
            law=said,
            confused_with=like,
            told_apart_by="amplitude: the other signal over a wider range",
        )
        for law, (physics, free, sizes, said, like) in _LAWS.items()
        for fixed in _SIDES.get(law, ({},))
    )

    input = In(shape="signal", unit=None, doc="signal")
    other = In(shape="signal", unit=None, doc="signal that acts on it")
    output = Out(shape="signal", unit=None, doc="signal with what is added, shape of the input")
    law = Option("linear", choices=tuple(_LAWS), kind=str, doc="what is added")
    linear = Param(0.0, unit=None, doc="factor of the other signal (laws linear, polynomial)")
    quadratic = Param(0.0, unit=None, doc="factor of its square (law polynomial)")
    cubic = Param(0.0, unit=None, doc="factor of its cube (law polynomial)")
    sine = Param(0.0, unit=None, doc="amplitude of the sine, unit of the input (law periodic)")
    cosine = Param(0.0, unit=None, doc="amplitude of the cosine, unit of the input (law periodic)")
    slope = Param(0.0, unit=None, doc="of what is added beyond the gap, per other signal (law stop)")
    gap = Param(0.0, unit=None, doc="from which it is, unit of the other signal (law stop)")
    side = Param(1.0, unit=None, doc="1: where the other signal is large, -1: where it is small (law stop)")
    wave_number = Param(1.0, unit=None, above=0.0, doc="radians of a period per other signal (law periodic)")

    def equations(self, p, u, x, t):
        o, law = u.other, self.option.law
        if law == "periodic":
            added = p.sine * sin(p.wave_number * o) + p.cosine * (cos(p.wave_number * o) - 1)
        elif law == "polynomial":
            added = o * (p.linear + o * (p.quadratic + o * p.cubic))
        elif law == "stop":
            beyond = p.side * o - p.gap
            return Equations(outputs={"output": u.input + p.slope * maximum(beyond, 0.0)}, events={"stop": beyond})
        else:
            added = p.linear * o
        return Equations(outputs={"output": u.input + added})
