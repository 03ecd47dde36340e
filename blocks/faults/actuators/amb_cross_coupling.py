"""Coupling between the axes of a magnetic bearing."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class AmbCrossCoupling(Block):
    """Give the current that the force of a magnetic bearing follows when its axes differ or couple.

    i_f = i + eps conj(i),   eps = real_coupling + i imaginary_coupling,   i = i_x + i i_y

    Between controller and bearing it makes the force k_i (i + eps conj i). A real eps is another k_i in each axis, an
    imaginary one a pull across.
    """

    source = "Schweitzer & Maslen (2009), ch. 4 (magnetic coupling of the axes)"
    faults = (
        Fault(
            physics="amb_cross_coupling",
            enters="wire",
            between=("controller", "bearing"),
            through={"current": "effective_current"},
            recorded="before",
            free={"real_coupling": (0.01,), "imaginary_coupling": (0.01,)},
            sizes=("real_coupling", "imaginary_coupling"),
            law="-1X of the force from the conjugate of the 1X current, and -k from k",
            confused_with=("anisotropic_support", "sensor_gain_mismatch"),
            told_apart_by="another set of gains: the coupling follows the current, a support the displacement",
        ),
    )

    current = In(shape=2, unit="A", doc="control current [x, y]")
    effective_current = Out(shape=2, unit="A", doc="current that the force follows [x, y]")
    real_coupling = Param(0.05, doc="real part of eps")
    imaginary_coupling = Param(0.0, doc="imaginary part of eps")

    def equations(self, p, u, x, t):
        mirror = plane.conjugate(u.current)
        coupled = p.real_coupling * mirror + p.imaginary_coupling * plane.times_i(mirror)
        return Equations(outputs={"effective_current": u.current + coupled})
