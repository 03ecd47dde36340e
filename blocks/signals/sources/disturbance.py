"""A signal that is added to another: offset, drift, step, sine."""

from rotorsim.block import Block, Equations, In, Option, Out, Param, cos, sin, tanh
from rotorsim.fault import Course, Dominant, Fault, Longest, Of, Onset

_NAMES = {
    "step": "step_disturbance",
    "line": "periodic_disturbance",
    "unmeasured": "unmeasured_disturbance",
}  # of the physics, where the law's is no name
_LAWS = {
    "offset": (
        {"offset": (Of("input", 0.01), Of("input", -0.01))},
        {},
        "a constant in all runs",
        ("drift", "step_disturbance"),
    ),
    "drift": (
        {
            "offset": (Of("input", 1e-3),),
            "rate": (Of("input", 0.1, per=Longest(1.0)), Of("input", -0.1, per=Longest(1.0))),
        },
        {},
        "grows with time from the start of every run",
        ("offset", "gain_drift"),
    ),
    "step": (
        {"height": (Of("input", 0.1), Of("input", -0.1)), "time": (*map(Onset, range(3)), Longest(7 / 8))},
        {"width": Longest(1e-3)},
        "a jump at one time of every run",
        ("offset", "drift"),
    ),
    "line": (
        {
            "sine": (Of("input", 0.1), Of("input", -0.1)),
            "cosine": (Of("input", 0.1), Of("input", -0.1)),
            "frequency": (Dominant(),),
        },
        {},
        "one frequency, whatever the inputs do",
        ("missing_mode",),
    ),
    "unmeasured": (
        {},
        {"rms": Course("rms"), "correlation_time": Course("correlation_time")},
        "another course in every run, which no recorded signal predicts",
        ("drift", "offset"),
    ),
}


class Disturbance(Block):
    """Add a signal of its own to a signal, entry by entry.

    law "offset":  d = offset
    law "drift":   d = offset + rate t
    law "step":    d = height (1 + tanh((t - time) / width)) / 2
    law "line":    d = sine sin(frequency t) + cosine cos(frequency t)
    law "unmeasured":  d = 0, what is expected of a signal without a mean: no simulation knows its course
    output = input + d
    """

    source = "R. Isermann, Fault-Diagnosis Systems (2006), ch. 5 (additive faults of sensors and actuators)"
    faults = tuple(
        Fault(
            physics=_NAMES.get(law, law),
            enters="signal",
            through={"input": "output"},
            options={"law": law},
            free=free,
            fixed=fixed,
            simpler={"rate": (0.0, "offset")} if law == "drift" else {},
            holds=("offset",) if law == "step" else (),  # a step before the first sample
            adds=True,
            law=said,
            confused_with=like,
            told_apart_by="the same inputs again, another length of the run",
        )
        for law, (free, fixed, said, like) in _LAWS.items()
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="signal with the disturbance, shape of the input")
    law = Option("offset", choices=tuple(_LAWS), kind=str, doc="what is added")
    offset = Param(0.0, unit=None, doc="constant, unit of the input (laws offset, drift)")
    rate = Param(0.0, unit=None, doc="drift, unit of the input per second (law drift)")
    height = Param(0.0, unit=None, doc="height of the step, unit of the input (law step)")
    time = Param(1.0, unit="s", doc="time of the step (law step)")
    width = Param(1e-2, unit="s", above=0.0, doc="time over which it rises (law step)")
    sine = Param(0.0, unit=None, doc="amplitude of the sine, unit of the input (law line)")
    cosine = Param(0.0, unit=None, doc="amplitude of the cosine, unit of the input (law line)")
    frequency = Param(10.0, unit="rad/s", above=0.0, doc="angular frequency (law line)")

    rms = Param(0.0, unit=None, low=0.0, doc="root mean square of all runs, unit of the input (law unmeasured)")
    correlation_time = Param(1.0, unit="s", above=0.0, doc="after which 1/e of it is left (law unmeasured)")

    def equations(self, p, u, x, t):
        added = {
            "offset": lambda: p.offset,
            "drift": lambda: p.offset + p.rate * t,
            "step": lambda: p.height * (1 + tanh((t - p.time) / p.width)) / 2,
            "unmeasured": lambda: 0.0,
            "line": lambda: p.sine * sin(p.frequency * t) + p.cosine * cos(p.frequency * t),
        }[self.option.law]()
        return Equations(outputs={"output": u.input + added})
