"""Active magnetic bearing with its magnets, windings and power amplifiers."""

from math import pi
from typing import Any

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Option, Out, Param, State, cos, maximum, minimum, tanh

MU_0 = 4e-7 * pi  # Vs/(Am)


class AmbActuator(Block):
    """Give the force of a magnetic bearing from its nameplate: bias, gap, windings, amplifiers, saturation.

    f = A cos(alpha) / mu_0 [B(i0 - i, g0 - u)^2 - B(i0 + i, g0 + u)^2],   for each axis
    B(c, g) = B_s tanh(b / B_s),   b = mu_0 N max(c, 0) / (2 g + l_iron)
    d i/dt = min(max(w_a (i_c - i), -r_-), r_+),   r_+- = max(U - R (i0 +- i), 0) / L,   |i_c| limited to i_max

    N: turns of one magnet, both poles; A: area of one pole; alpha: angle of its poles from the axis; l_iron: length of
    the flux in iron over its relative permeability. i_c is the current demanded, i the one that flows. Amplifiers drive
    i0 - i and i0 + i; their voltage U, less that over the resistance R, drives at most r_+ and r_- through the
    inductance of a magnet at the nominal gap, L = mu_0 N^2 A / (2 g0 + l_iron): below, they are of first order with the
    bandwidth w_a. The voltage that motion induces is left out. About u = i = 0, unsaturated: f = k_s u - k_i i as of
    `amb`; tanh bends early: at a bias of 0.2 B_s both are 5 % less, at 0.5 B_s 27 %.
    k_i = 4 A cos(alpha) mu_0 N^2 i0 / (2 g0 + l_iron)^2,   k_s = 2 k_i i0 / (2 g0 + l_iron)
    """

    source = "Schweitzer & Maslen (2009), 4.3-4.5 (force, saturation), 3.3 (amplifiers: force slew rate)"

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] in the bearing")
    current = In(shape=2, unit="A", doc="control current demanded i_c [x, y]")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    flowing_current = Out(shape=2, unit="A", doc="control current that flows i [x, y]")
    iron = Option("saturating", choices=("saturating", "linear"), kind=str, doc="whether the iron saturates at B_s")
    bias_current = Param(2.5, unit="A", above=0.0, doc="bias current i0")
    air_gap = Param(0.5e-3, unit="m", above=0.0, doc="nominal air gap g0, radial, at one pole")
    turns = Param(100.0, above=0.0, doc="turns N of one magnet, both poles")
    pole_area = Param(2e-4, unit="m^2", above=0.0, doc="area A of one pole")
    pole_angle = Param(
        pi / 8, unit="rad", low=0.0, high=1.5, doc="angle alpha of the poles from the axis: 22.5 deg of 8"
    )
    iron_length = Param(0.0, unit="m", low=0.0, doc="length of the flux in iron over its relative permeability")
    saturation_flux_density = Param(1.5, unit="T", above=0.0, doc="flux density B_s (iron saturating)")
    resistance = Param(0.5, unit="Ohm", low=0.0, doc="resistance R of a winding")
    voltage = Param(100.0, unit="V", above=0.0, doc="voltage U of the amplifiers")
    bandwidth = Param(
        2 * pi * 2000, unit="rad/s", above=0.0, high=1e6, doc='of the amplifiers, w_a (in JSON also "2 kHz")'
    )
    largest_current = Param(2.5, unit="A", above=0.0, doc="largest control current i_max")
    flowing = State(shape=2, unit="A", doc="control current that flows i")

    def check(self, values: Any) -> list[str]:
        """Refuse a bias that saturates the iron, and one that the amplifiers cannot hold."""
        path = 2 * values["air_gap"] + values["iron_length"]
        bias = float(MU_0 * values["turns"] * values["bias_current"] / path)
        problems = []
        if self.option.iron == "saturating" and bias >= values["saturation_flux_density"]:
            most = float(values["saturation_flux_density"])
            problems.append(f"the bias makes {bias:.3g} T in the gap, and the iron saturates at {most:.3g} T")
        drop = float(values["resistance"] * (values["bias_current"] + values["largest_current"]))
        if drop >= values["voltage"]:
            problems.append(
                f"bias_current and largest_current need {drop:.3g} V over the resistance, "
                f"and voltage is {float(values['voltage']):.3g} V"
            )
        return problems

    def holds_below(self, p: Any) -> dict[str, Any]:
        """Return the air gap: there the rotor touches the magnets."""
        return {"displacement": p.air_gap}

    def equations(self, p, u, x, t):
        upper = self._flux_density(p, p.bias_current - x.flowing, p.air_gap - u.displacement)
        lower = self._flux_density(p, p.bias_current + x.flowing, p.air_gap + u.displacement)
        area = p.pole_area * cos(p.pole_angle) / MU_0
        inductance = MU_0 * p.turns**2 * p.pole_area / (2 * p.air_gap + p.iron_length)
        wanted = p.bandwidth * (plane.within(u.current, p.largest_current) - x.flowing)
        most = maximum(p.voltage - p.resistance * (p.bias_current + x.flowing), 0.0) / inductance
        least = maximum(p.voltage - p.resistance * (p.bias_current - x.flowing), 0.0) / inductance
        return Equations(
            outputs={"force": area * (upper**2 - lower**2), "flowing_current": x.flowing},
            derivatives={"flowing": minimum(maximum(wanted, -least), most)},
            events={
                "upper": p.bias_current - x.flowing,
                "lower": p.bias_current + x.flowing,
                "rising": wanted - most,
                "falling": wanted + least,
            },
        )

    def _flux_density(self, p: Any, current: Any, gap: Any) -> Any:
        """Return B of a magnet at a current, which its amplifier does not drive below zero, and a gap."""
        linear = MU_0 * p.turns * maximum(current, 0.0) / (2 * gap + p.iron_length)
        if self.option.iron == "linear":
            return linear
        return p.saturation_flux_density * tanh(linear / p.saturation_flux_density)
