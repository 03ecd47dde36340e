"""Active magnetic bearing with the force law of its magnets."""

from typing import Any

from rotorsim.block import Block, Equations, In, Option, Out, Param, maximum
from rotorsim.fault import Fault


class AmbNonlinear(Block):
    """Give the force of opposed magnets in differential driving on the rotor, for each axis.

    f = K [((i0 - i) / (g0 - u))^2 - ((i0 + i) / (g0 + u))^2],   K = k_i g0^2 / (4 i0),   g0 = k_i i0 / k_s

    About u = i = 0: f = k_s u - k_i i, as `amb` with the same two factors; what they and the bias current i0 say of
    the nominal air gap g0 is k_s = k_i i0 / g0.

    driving "unipolar": the current of a magnet does not fall below zero      "bipolar": the law as it stands
    """

    source = "Schweitzer & Maslen (2009), eq. (4.28) ff., with cos alpha in K"
    faults = (
        Fault(
            physics="magnetic_nonlinearity",
            enters="replace",
            of=("amb",),
            options={"driving": "bipolar"},
            free={"bias_current": (0.3, 1.0, 3.0)},
            law="odd orders on centre, even ones and -1X off centre; k_i and k_s vary with amplitude",
            confused_with=("force_displacement_factor", "force_current_factor", "magnetic_saturation"),
            told_apart_by="amplitude and set-point: raise the unbalance, or shift the reference off centre",
        ),
    )

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] in the bearing")
    current = In(shape=2, unit="A", doc="control current [x, y]")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    driving = Option("unipolar", choices=("unipolar", "bipolar"), kind=str, doc="whether a current may change its sign")
    force_displacement_factor = Param(105210.0, unit="N/m", above=0.0, doc="k_s at the set-point")
    force_current_factor = Param(42.1, unit="N/A", above=0.0, doc="k_i at the set-point")
    bias_current = Param(1.0, unit="A", above=0.0, doc="bias current i0")

    def holds_below(self, p):
        """Return the air gap: there the rotor touches the magnets."""
        return {"displacement": _air_gap(p)}

    def equations(self, p, u, x, t):
        gap = _air_gap(p)
        constant = p.force_current_factor * gap**2 / (4 * p.bias_current)
        upper, lower = p.bias_current - u.current, p.bias_current + u.current
        events = {}
        if self.option.driving == "unipolar":
            events = {"upper": upper, "lower": lower}
            upper, lower = maximum(upper, 0.0), maximum(lower, 0.0)
        pull, push = upper / (gap - u.displacement), lower / (gap + u.displacement)
        return Equations(outputs={"force": constant * (pull**2 - push**2)}, events=events)


def _air_gap(p: Any) -> Any:
    return p.force_current_factor * p.bias_current / p.force_displacement_factor
