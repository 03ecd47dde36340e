"""Lag of a magnetic force behind its current, by eddy currents."""

from math import pi

from rotorsim.block import Block, Equations, In, Option, Out, Param, State, sqrt
from rotorsim.fault import Fault, Longest

# sqrt(s) ~ sum of r s / (s + a): poles a [rad/s] and weights r (minimax), within 0.45 % for s = i w, 1 Hz to 1 kHz
_POLES = [2 * pi * f for f in (0.225103, 1.90529, 8.70976, 35.8635, 133.342, 505.173, 4000.0)]
_WEIGHTS = (1.42029, 1.74144, 3.46769, 6.46071, 11.8151, 25.7511, 187.721)

_LAW = "phase lag between the measured current and the force, like negative damping"


class EddyCurrentLag(Block):
    """Give the current that the force of a magnetic bearing follows behind eddy currents in its iron.

    law "sqrt":         i_f = i / (1 + sqrt(s time_constant))
    law "first_order":  i_f = (1 - share) i + share i / (1 + s time_constant)

    sqrt(s) is realised by seven poles up to 4 kHz; i_f is then right within 0.45 % from 1 Hz to 1 kHz, whatever the
    time constant.
    """

    source = "Schweitzer & Maslen (2009), ch. 4 (eddy currents); Zhu, Knospe & Maslen, IEEE Trans. Magn. 41 (2005)"
    faults = Fault(
        physics="eddy_current_lag",
        enters="wire",
        between=("controller", "bearing"),
        through={"current": "effective_current"},
        recorded="before",
        options={"law": "sqrt"},
        free={"time_constant": (1e-6, 1e-4)},
        most={"time_constant": Longest(30.0)},
        sizes=("time_constant",),
        law=f"{_LAW}; with the square root of frequency",
        confused_with=("viscous_damping", "amplifier_bandwidth", "control_delay"),
        told_apart_by="another set of gains; the lag acts after the measured current, that of the controller before it",
    ).variants(
        {
            "options": {"law": "first_order"},
            "free": {"time_constant": (1e-3, 2e-4), "share": (0.2,)},
            "sizes": ("share",),
            "law": f"{_LAW}; of part of the force, strongest near 1 / time_constant",
        }
    )

    current = In(shape="signal", unit="A", doc="current in the coils")
    effective_current = Out(shape="signal", unit="A", doc="current that the force follows")
    law = Option("sqrt", choices=("sqrt", "first_order"), kind=str, doc="law of the lag")
    time_constant = Param(1e-5, unit="s", low=1e-12, doc="time constant tau")
    share = Param(0.3, low=0.0, high=1.0, doc="part of the force that lags (law first_order)")
    elements = tuple(
        State(
            name=f"element{k}",
            shape="signal",
            unit="A",
            when=lambda o: o.law == "sqrt",
            doc=f"lag {k} of those that make up the square root",
        )
        for k in range(1, len(_POLES) + 1)
    )
    lagging = State(shape="signal", unit="A", when=lambda o: o.law == "first_order", doc="current that lags")

    def equations(self, p, u, x, t):
        if self.option.law == "first_order":
            return Equations(
                outputs={"effective_current": (1 - p.share) * u.current + p.share * x.lagging},
                derivatives={"lagging": (u.current - x.lagging) / p.time_constant},
            )
        # i_f + sqrt(tau) sum r (i_f - element) = i
        root = sqrt(p.time_constant)
        elements = [getattr(x, f"element{k}") for k in range(1, len(_POLES) + 1)]
        held = sum(r * element for r, element in zip(_WEIGHTS, elements, strict=True))
        effective = (u.current + root * held) / (1 + root * sum(_WEIGHTS))
        return Equations(
            outputs={"effective_current": effective},
            derivatives={
                f"element{k}": a * (effective - element)
                for k, (a, element) in enumerate(zip(_POLES, elements, strict=True), 1)
            },
        )
