"""Force of a seal or an impeller."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class SealCrossCoupling(Block):
    """Give the force of a fluid that turns between rotor and stator.

    F = i cross_stiffness q - direct_stiffness q - direct_damping q',   q = x + i y

    In the axes: F_x = -k_c y - k_d x - c_d x', F_y = k_c x - k_d y - c_d y'. Positive k_c drives forward whirl.
    """

    source = "Childs, Turbomachinery Rotordynamics (1993), ch. 4, 5; H. Black, J. Appl. Mech. 36 (1969) 244-254"
    faults = Fault(
        physics="seal_cross_coupling",
        enters="force",
        free={"cross_stiffness": (1e3,)},
        sizes=("cross_stiffness",),
        law="damping of forward whirl falls, that of backward whirl rises, or the reverse",
        confused_with=("internal_damping", "sensor_rotation"),
        told_apart_by="change of flow or pressure; the residual of the control law, which a rotated sensor changes",
    ).variants(
        {
            "free": {"cross_stiffness": (1e3,), "direct_stiffness": (1e3,), "direct_damping": (1.0,)},
            "sizes": ("cross_stiffness", "direct_stiffness", "direct_damping"),
            "holds": ("support_stiffness", "magnetic_pull"),
            "confused_with": ("internal_damping", "sensor_rotation", "support_stiffness"),
        }
    )

    displacement = In(shape=2, unit="m", doc="displacement [x, y] at the seal")
    velocity = In(shape=2, unit="m/s", doc="velocity [x, y] at the seal")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    cross_stiffness = Param(1e4, unit="N/m", doc="k_c; its sign is that of the whirl which it drives")
    direct_stiffness = Param(0.0, unit="N/m", doc="k_d")
    direct_damping = Param(0.0, unit="N s/m", doc="c_d")

    def equations(self, p, u, x, t):
        force = p.cross_stiffness * plane.times_i(u.displacement)
        return Equations(outputs={"force": force - p.direct_stiffness * u.displacement - p.direct_damping * u.velocity})
