"""Support that is stiffer in one axis than in the other."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class AnisotropicSupport(Block):
    """Give the force of the difference between the two axes of a support.

    F = -dk conj(q) - dc conj(q)',   dk = (k_x - k_y) / 2,   dc = (c_x - c_y) / 2,   q = x + i y

    In the axes: F_x = -dk x - dc x', F_y = dk y + dc y'. The mean of the two axes is left to the bearing: a spring k
    that acts in y only is dk = -k / 2 here and a bearing that is stiffer by k / 2.
    """

    source = "Friswell et al. (2010), ch. 5 (anisotropic bearings); thesis eq. (5.1)"
    faults = Fault(
        physics="anisotropic_support",
        enters="force",
        free={"stiffness_difference": (1e4,)},
        sizes=("stiffness_difference",),
        law="-1X from the conjugate of 1X, and -k from k at every order; the critical speed splits in two",
        confused_with=("breathing_crack", "sensor_gain_mismatch", "amb_cross_coupling", "cubic_stiffness"),
        told_apart_by="its law of speed: it follows the conjugate of the motion, a crack does not",
    ).variants(
        {
            "free": {"stiffness_difference": (1e4,), "damping_difference": (1.0,)},
            "sizes": ("stiffness_difference", "damping_difference"),
        }
    )

    displacement = In(shape=2, unit="m", doc="displacement [x, y] at the support")
    velocity = In(shape=2, unit="m/s", doc="velocity [x, y] at the support")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    stiffness_difference = Param(5e4, unit="N/m", doc="k_x - k_y = 2 dk")
    damping_difference = Param(0.0, unit="N s/m", doc="c_x - c_y = 2 dc")

    def equations(self, p, u, x, t):
        dk, dc = p.stiffness_difference / 2, p.damping_difference / 2
        return Equations(outputs={"force": -dk * plane.conjugate(u.displacement) - dc * plane.conjugate(u.velocity)})
