"""Active magnetic bearing with the force law of its magnets."""

from typing import Any

from rotorsim.block import Block, Equations, In, Out, Param, maximum


class AmbNonlinear(Block):
    """Give the force of opposed magnets in differential driving on the rotor, for each axis.

    f = K [((i0 - i) / (g0 - u))^2 - ((i0 + i) / (g0 + u))^2],   K = k_i g0^2 / (4 i0)

    About u = i = 0: f = k_s u - k_i i with k_i = force_current_factor and k_s = k_i i0 / g0. A magnet
    does not push: its current does not fall below zero.
    """

    source = "Schweitzer & Maslen (2009), eq. (4.28) ff., with cos alpha in K"
    category = "bearing"

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] in the bearing")
    current = In(shape=2, unit="A", doc="control current [x, y]")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    force_current_factor = Param(42.1, unit="N/A", above=0.0, doc="k_i at the set-point")
    bias_current = Param(1.0, unit="A", above=0.0, doc="bias current i0")
    gap = Param(4.0015e-4, unit="m", above=0.0, doc="nominal air gap g0; k_s = k_i i0 / g0")

    def equations(self, p: Any, u: Any, x: Any, t: Any) -> Equations:
        constant = p.force_current_factor * p.gap**2 / (4 * p.bias_current)
        pull = maximum(p.bias_current - u.current, 0.0) / (p.gap - u.displacement)
        push = maximum(p.bias_current + u.current, 0.0) / (p.gap + u.displacement)
        return Equations(
            outputs={"force": constant * (pull**2 - push**2)},
            events={"upper": p.bias_current - u.current, "lower": p.bias_current + u.current},
        )
