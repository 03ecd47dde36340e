"""Rotor with an offset disc: translation, tilt and gyroscopic moments."""

from rotorsim.block import Block, Equations, In, Out, Param, State, vec


class Rotor4dof(Block):
    """Move a disc that translates and tilts on a massless shaft.

    mass u'' + c22 u' + c23 a' + k22 u + k23 a = force
    I_d a'' + c23 u' + c33 a' + k23 u + k33 a + W I_p [a_2', -a_1'] = moment

    u = [x, y]; a = [du_x/dz, du_y/dz] is the tilt of the disc in the planes of x and y. With
    a = a_1 + i a_2 the gyroscopic moment is -i W I_p a', which raises forward modes. The thesis' eq. (3.2)
    carries the opposite sign, which would raise the backward ones; the physical sign is used here.
    """

    type_name = "rotor_4dof"
    source = "thesis eq. (3.19), Table 3-1; sign: Friswell et al. (2010), sec. 3.6"

    force = In(shape=2, unit="N", additive=True, conjugate="displacement", doc="sum of the forces on the disc [x, y]")
    moment = In(shape=2, unit="N m", additive=True, conjugate="tilt", doc="sum of the moments in the planes of x and y")
    speed = In(unit="rad/s", doc="shaft speed W")
    displacement = Out(shape=2, unit="m", doc="displacement [x, y]")
    tilt_port = Out(name="tilt", shape=2, unit="rad", doc="tilt in the planes of x and y")
    velocity_port = Out(name="velocity", shape=2, unit="m/s", doc="velocity [x, y]")
    tilt_velocity_port = Out(name="tilt_velocity", shape=2, unit="rad/s", doc="rate of tilt")
    mass = Param(2.0, unit="kg", above=0.0, doc="mass of the disc")
    polar_inertia = Param(0.0048, unit="kg m^2", low=0.0, doc="polar moment of inertia I_p")
    diametral_inertia = Param(0.0024, unit="kg m^2", above=0.0, doc="diametral moment of inertia I_d")
    stiffness = Param(7.6e5, unit="N/m", doc="k22, force per displacement")
    coupling_stiffness = Param(8900.0, unit="N/rad", doc="k23, force per tilt and moment per displacement")
    tilt_stiffness = Param(2350.0, unit="N m/rad", doc="k33, moment per tilt")
    viscous_damping = Param(76.0, unit="N s/m", doc="c22, force per velocity")
    coupling_damping = Param(11.0, unit="N s/rad", doc="c23, force per rate of tilt and moment per velocity")
    tilt_damping = Param(6.0, unit="N m s/rad", doc="c33, moment per rate of tilt")
    position = State(shape=2, unit="m", doc="displacement")
    tilt = State(shape=2, unit="rad", doc="tilt")
    velocity = State(shape=2, unit="m/s", doc="velocity")
    tilt_velocity = State(shape=2, unit="rad/s", doc="rate of tilt")

    def equations(self, p, u, x, t):
        gyroscopic = u.speed * p.polar_inertia * vec(x.tilt_velocity[1], -x.tilt_velocity[0])
        elastic = p.stiffness * x.position + p.coupling_stiffness * x.tilt
        damping = p.viscous_damping * x.velocity + p.coupling_damping * x.tilt_velocity
        elastic_moment = p.coupling_stiffness * x.position + p.tilt_stiffness * x.tilt
        damping_moment = p.coupling_damping * x.velocity + p.tilt_damping * x.tilt_velocity
        return Equations(
            outputs={
                "displacement": x.position,
                "tilt": x.tilt,
                "velocity": x.velocity,
                "tilt_velocity": x.tilt_velocity,
            },
            derivatives={
                "position": x.velocity,
                "tilt": x.tilt_velocity,
                "velocity": (u.force - damping - elastic) / p.mass,
                "tilt_velocity": (u.moment - gyroscopic - damping_moment - elastic_moment) / p.diametral_inertia,
            },
        )
