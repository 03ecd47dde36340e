"""Hysteretic (structural) damping: loss that does not depend on frequency."""

from math import pi
from typing import Any

from rotorsim.block import Block, Equations, In, Option, Out, Param, State, absolute, rows, vec
from rotorsim.fault import Fault

# Poles [rad/s] and weights (minimax, with one damper [s] behind them) of a chain of Maxwell elements whose loss is 1
# within 0.18 % from 1 Hz to 1 kHz.
_POLES = [2 * pi * f for f in (0.37, 1.3089, 4.63, 16.3783, 57.9374, 204.9503, 725.0)]
_WEIGHTS = (1.1927, 0.7775, 0.8087, 0.8014, 0.8072, 0.7971, 0.8706)
_DAMPER = 0.3658 / (2 * pi * 1000)

_LAW = "loss of each order proportional to its amplitude alone, not to frequency; forward and backward alike"


def _of_band(option: Any) -> bool:
    return bool(option.law == "band")


def _of_orders(option: Any) -> bool:
    return not _of_band(option)


def _axes(option: Any) -> Any:
    return "signal" if _of_band(option) else (2,)  # only a shaft has orders


def _orders(option: Any) -> tuple[int, int]:
    return option.orders, 2


class HystereticDamping(Block):
    """Give the force of damping whose loss does not depend on frequency.

    F_k = -i loss_factor sgn(k W) stiffness q_k        at each order k

    This law is not causal: no machine in time has it exactly. Two realisations:
    law "harmonics": exact in the settled motion at constant speed, forward and backward orders 1 to `orders`:
        c_k' = 2 |W| e / pi - k |W| s_k, s_k' = k |W| c_k, m' = |W| e / pi, e = q - m - sum c_k finds q = m + sum c_k
        within some turns; s_k is c_k a quarter later, and F = loss_factor stiffness sum s_k. Needs `speed`.
    law "band": Maxwell elements, F = -loss_factor stiffness [G - Re G(i w_r)] q, G = sum g_j s / (s + a_j) + d s; the
        loss Im G is 1 within 0.2 % from 1 Hz to 1 kHz. As in every causal material the stiffness then rises with
        frequency, by 2 / pi loss_factor stiffness for each factor e; it is the stated one at w_r =
        reference_frequency.
    """

    source = "Bishop, J. R. Aeronaut. Soc. 59 (1955) 738-742; Crandall, J. Sound Vib. 11 (1970) 3-18 (causality)"
    faults = Fault(
        physics="hysteretic_damping",
        enters="force",
        options={"law": "harmonics"},
        free={"loss_factor": (0.005,)},
        sizes=("loss_factor",),
        inherits=("stiffness",),
        law=_LAW,
        confused_with=("viscous_damping", "coulomb_friction"),
        told_apart_by="loss over a wide range of speeds: viscous loss grows with speed; "
        "amplitude: friction falls with it",
        told_apart_at_rest_by="loss over a wide range of frequencies; amplitude: friction falls with it",
    ).variants({"options": {"law": "band"}, "law": f"{_LAW}; the stiffness rises with the logarithm of frequency"})

    displacement = In(shape=_axes, unit="m", doc="displacement")
    velocity = In(shape=_axes, unit="m/s", doc="velocity")
    speed = In(unit="rad/s", optional=True, doc="shaft speed W (law harmonics)")
    force = Out(shape=_axes, unit="N", doc="force on what moves")
    law = Option("band", choices=("harmonics", "band"), kind=str, doc="how the law is realised in time")
    orders = Option(9, kind=int, low=1, high=30, doc="orders that are damped (law harmonics)")
    loss_factor = Param(0.01, low=0.0, doc="loss factor eta")
    stiffness = Param(7.6e5, unit="N/m", low=0.0, doc="stiffness K that loses energy")
    reference_frequency = Param(2 * pi * 30, unit="rad/s", above=0.0, doc="where the stiffness is K (law band)")
    mean = State(shape=2, unit="m", when=_of_orders, doc="mean m of the displacement")
    cosine = State(shape=_orders, unit="m", when=_of_orders, doc="parts c_k of the displacement [order, axis]")
    sine = State(shape=_orders, unit="m", when=_of_orders, doc="the same a quarter later, s_k [order, axis]")
    elements = tuple(
        State(name=f"element{k}", shape=_axes, unit="m", when=_of_band, doc=f"damper end of Maxwell element {k}")
        for k in range(1, len(_POLES) + 1)
    )

    def check(self, values):
        """Refuse orders of a shaft whose speed is not known."""
        unknown = self.option.law == "harmonics" and "speed" not in self.wired
        return ['law "harmonics" needs the input speed (without a shaft: law "band")'] if unknown else []

    def equations(self, p, u, x, t):
        return self._harmonics(p, u, x) if self.option.law == "harmonics" else self._band(p, u, x)

    def _harmonics(self, p: Any, u: Any, x: Any) -> Equations:
        pace = absolute(u.speed)
        q = u.displacement.T  # rows hold the orders, columns the axes
        cosines, sines = rows(x.cosine), rows(x.sine)
        quarter: Any = sum(sines)
        error = q - x.mean.T - sum(cosines)
        orders = range(1, self.option.orders + 1)
        return Equations(
            outputs={"force": p.loss_factor * p.stiffness * quarter.T},
            derivatives={
                "mean": pace / pi * error.T,
                "cosine": vec(*[2 * pace / pi * error - k * pace * s for k, s in zip(orders, sines, strict=True)]),
                "sine": vec(*[k * pace * c for k, c in zip(orders, cosines, strict=True)]),
            },
        )

    def _band(self, p: Any, u: Any, x: Any) -> Equations:
        w2 = p.reference_frequency**2
        springs = [u.displacement - getattr(x, f"element{k}") for k in range(1, len(_POLES) + 1)]
        stiffening = sum(g * w2 / (w2 + a**2) for g, a in zip(_WEIGHTS, _POLES, strict=True))
        loss = sum(g * spring for g, spring in zip(_WEIGHTS, springs, strict=True))
        loss = loss + _DAMPER * u.velocity - stiffening * u.displacement
        return Equations(
            outputs={"force": -p.loss_factor * p.stiffness * loss},
            derivatives={
                f"element{k}": a * spring for k, (a, spring) in enumerate(zip(_POLES, springs, strict=True), 1)
            },
        )
