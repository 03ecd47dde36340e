"""Active magnetic bearing whose iron saturates."""

from typing import Any

from rotorsim.block import Block, Equations, In, Option, Out, Param, maximum, tanh
from rotorsim.fault import Fault, Of


class MagneticSaturation(Block):
    """Give the force of opposed magnets in differential driving whose flux saturates, for each axis.

    f = F [s(b_1)^2 - s(b_2)^2],   s(b) = B_s tanh(b / B_s),   B_s = saturation_flux
    b_1 = (1 - i / i0) / (1 - u / g0),   b_2 = (1 + i / i0) / (1 + u / g0),   g0 = k_i i0 / k_s
    F = k_i i0 / (4 s(1) s'(1))

    b is the flux density of a magnet, unsaturated, over that of the bias current at the set-point, so B_s is that of
    saturation over that of the bias. About u = i = 0: f = k_s u - k_i i as `amb`; F also holds the slope of saturation
    there, so that k_i and k_s are the small-signal factors. For B_s to infinity this is `amb_nonlinear`.

    driving "unipolar": the current of a magnet does not fall below zero      "bipolar": the law as it stands

    law "control": f = k_s u - k_i i_s tanh(i / i_s), i_s = saturation_current: only the field of the control current
    saturates, as where permanent magnets or coils of their own make the bias.
    """

    source = "Schweitzer & Maslen (2009), ch. 4 (saturation)"
    faults = Fault(
        physics="magnetic_saturation",
        enters="replace",
        of=("amb", "amb_nonlinear"),
        options={"driving": "bipolar"},
        free={"saturation_flux": (1.5, 3.0), "bias_current": (0.3, 1.0, 3.0)},
        law="3X of the force at high current",
        confused_with=("current_clipping", "magnetic_nonlinearity"),
        told_apart_by="the current: clipping shows in it, saturation only in the force",
    ).variants(
        {
            "options": {"law": "control"},
            "free": {"saturation_current": (Of("current", 2.0), Of("current", 8.0))},
            "confused_with": ("current_clipping", "cubic_stiffness"),
        }
    )

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] in the bearing")
    current = In(shape=2, unit="A", doc="control current [x, y]")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    law = Option("magnets", choices=("magnets", "control"), kind=str, doc="what saturates")
    driving = Option("unipolar", choices=("unipolar", "bipolar"), kind=str, doc="whether a current may change its sign")
    force_displacement_factor = Param(105210.0, unit="N/m", above=0.0, doc="k_s at the set-point")
    force_current_factor = Param(42.1, unit="N/A", above=0.0, doc="k_i at the set-point")
    bias_current = Param(1.0, unit="A", above=0.0, doc="bias current i0")
    saturation_flux = Param(3.0, low=0.2, doc="flux density of saturation B_s over that of the bias")
    saturation_current = Param(1.0, unit="A", above=0.0, doc="control current of saturation i_s (law control)")

    def equations(self, p, u, x, t):
        if self.option.law == "control":
            limited = _saturated(u.current, p.saturation_current)
            return Equations(
                outputs={"force": p.force_displacement_factor * u.displacement - p.force_current_factor * limited}
            )
        gap = p.force_current_factor * p.bias_current / p.force_displacement_factor
        upper, lower = 1 - u.current / p.bias_current, 1 + u.current / p.bias_current
        events = {}
        if self.option.driving == "unipolar":
            events = {"upper": upper, "lower": lower}
            upper, lower = maximum(upper, 0.0), maximum(lower, 0.0)
        pull = _saturated(upper / (1 - u.displacement / gap), p.saturation_flux)
        push = _saturated(lower / (1 + u.displacement / gap), p.saturation_flux)
        slope = 1 - tanh(1 / p.saturation_flux) ** 2
        at_bias = _saturated(1.0, p.saturation_flux)
        size = p.force_current_factor * p.bias_current / (4 * at_bias * slope)
        return Equations(outputs={"force": size * (pull**2 - push**2)}, events=events)


def _saturated(flux: Any, limit: Any) -> Any:
    return limit * tanh(flux / limit)
