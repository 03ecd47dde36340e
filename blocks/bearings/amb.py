"""Active magnetic bearing, linear about its set-point."""

from rotorsim.block import Block, Equations, In, Out, Param


class Amb(Block):
    """Give the force of an isotropic magnetic bearing on the rotor, linear in displacement and current.

    f = force_displacement_factor u - force_current_factor i        minus thesis eq. (2.25), as it acts in (2.26)

    The displacement factor k_s is positive: the bearing without current is unstable.
    """

    source = "thesis eq. (2.25), (2.26), Table 2-1"

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] in the bearing")
    current = In(shape=2, unit="A", doc="control current [x, y]")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    force_displacement_factor = Param(105210.0, unit="N/m", doc="k_s")
    force_current_factor = Param(42.1, unit="N/A", doc="k_i")

    def equations(self, p, u, x, t):
        return Equations(
            outputs={"force": p.force_displacement_factor * u.displacement - p.force_current_factor * u.current}
        )
