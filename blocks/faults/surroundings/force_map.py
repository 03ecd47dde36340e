"""Force of unknown origin as a map of displacement and velocity."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param, tanh


class ForceMap(Block):
    """Give the force that a fitted map makes of displacement q and velocity v, for physics that has no name.

    f = -(k2 |q| + k3 |q|^2 + k5 |q|^4) q - (c2 |v| + c3 |q|^2) v - F0 tanh(|v| / width) v / |v| - J (kc + kc3 |q|^2) q

    J turns by 90 degrees, |.| is the length over all entries. Linear stiffness and damping are left out: the diagram
    has them. A scalar has no cross terms.
    """

    source = "Worden and Tomlinson, Nonlinearity in Structural Dynamics (2001), ch. 7 (restoring force surface)"

    displacement = In(shape="signal", unit="m", doc="displacement q")
    velocity = In(shape="signal", unit="m/s", doc="velocity v")
    force = Out(shape="signal", unit="N", doc="force")
    quadratic = Param(0.0, unit="N/m^2", doc="k2")
    cubic = Param(0.0, unit="N/m^3", doc="k3")
    quintic = Param(0.0, unit="N/m^5", doc="k5")
    drag = Param(0.0, unit="N s^2/m^2", doc="c2")
    damping_growth = Param(0.0, unit="N s/m^3", doc="c3")
    friction = Param(0.0, unit="N", doc="F0")
    width = Param(1e-3, unit="m/s", above=0.0, doc="velocity over which the friction reverses")
    cross = Param(0.0, unit="N/m", doc="kc")
    cross_cubic = Param(0.0, unit="N/m^3", doc="kc3")

    def equations(self, p, u, x, t):
        q, v = u.displacement, u.velocity
        size = plane.length(q)
        rate = plane.length(v)
        force = -(p.quadratic * size + p.cubic * size**2 + p.quintic * size**4) * q
        force -= (p.drag * rate + p.damping_growth * size**2 + p.friction * tanh(rate / p.width) / rate) * v
        if q.shape[0] == 2:
            force -= (p.cross + p.cross_cubic * size**2) * plane.times_i(q)
        return Equations(outputs={"force": force})
