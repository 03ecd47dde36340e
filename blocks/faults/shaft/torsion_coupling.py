"""Torsion of a shaft, coupled to its bending by the unbalance and by a crack."""

from math import pi

from rotorsim.blocks.common import observer, plane

from rotorsim.block import Block, Equations, In, Out, Param, State, cos, vec
from rotorsim.fault import Fault

_GRAVITY = 9.80665  # m/s^2, along x, in which the sag is counted


class TorsionCoupling(Block):
    """Give what the twist of the shaft adds to the force of unbalance and crack on one disc.

    b = theta + phi + phase,   a = theta + crack_phase,   n = e^{i a},   s = (1 + cos a) / 2,   z = x + i y
    F = unbalance [((W + phi')^2 - i phi'') e^{i b} - W^2 e^{i (theta + phase)}] - s crack_coupling phi n
    inertia (phi'' + 2 damping_ratio frequency phi' + frequency^2 phi) =
        -unbalance Im(e^{-i b} (q'' - g)) - s crack_coupling Re(conj(n) (q + sag))

    phi: twist of the disc against steady rotation; unbalance = m e. The unbalance of the untwisted shaft is left to its
    own block. Lagrange's equations of a disc with mass eccentricity, and of the energy s crack_coupling phi Re(conj(n)
    (q + sag)) of a crack that opens with the weight; its pull on the rotation of n is small and left out. q'' is
    observed as in `mass_error`.
    """

    source = "Darpe, Gupta & Chawla, J. Sound Vib. 269 (2004) 33-60; Tondl (1965), ch. 6 (unbalance and torsion)"
    faults = Fault(
        physics="torsion_coupling",
        enters="force",
        free={"unbalance": (5e-5,), "phase": plane.ANGLES, "frequency": (2 * pi * 60, 2 * pi * 200)},
        inherits=("crack.sag",),
        law="sidebands at the torsional frequency; orders 0 and 2 of the unbalance, strong where k W is torsional",
        confused_with=("speed_fluctuation",),
        told_apart_by="an encoder: the twist has a resonance at the torsional frequency, a fluctuating drive has none",
    ).variants(
        {
            "free": {
                "unbalance": (5e-5,),
                "phase": plane.ANGLES,
                "frequency": (2 * pi * 60, 2 * pi * 200),
                "crack_coupling": (1e3,),
                "crack_phase": (0.0,),
            },
            "law": "sidebands at the torsional frequency of the orders of the crack",
        }
    )

    displacement = In(shape=2, unit="m", doc="displacement [x, y] of the disc")
    velocity = In(shape=2, unit="m/s", doc="velocity [x, y] of the disc")
    theta = In(unit="rad", doc="angle of steady rotation")
    speed = In(unit="rad/s", doc="steady speed W")
    force = Out(shape=2, unit="N", doc="force on the rotor [x, y]")
    twist = Out(unit="rad", doc="twist phi of the disc")
    unbalance = Param(5e-5, unit="kg m", low=0.0, doc="unbalance m e of the disc")
    phase = Param(0.0, unit="rad", doc="angle of the unbalance against the phase reference")
    inertia = Param(0.0048, unit="kg m^2", above=0.0, doc="moment of inertia of the disc about the shaft")
    frequency = Param(2 * pi * 100, unit="rad/s", above=0.0, doc="torsional natural frequency")
    damping_ratio = Param(0.01, low=0.0, doc="damping ratio in torsion")
    crack_coupling = Param(0.0, unit="N/rad", doc="coupling stiffness of the open crack between bending and torsion")
    crack_phase = Param(0.0, unit="rad", doc="angle of the crack against the phase reference")
    sag = Param(2.6e-5, unit="m", doc="static deflection, along x")
    bandwidth = observer.BANDWIDTH
    angle = State(unit="rad", doc="twist phi")
    rate = State(unit="rad/s", doc="its rate phi'")
    estimate = State(shape=2, unit="m/s", doc="velocity as observed")
    trend = State(shape=2, unit="m/s^2", doc="acceleration as observed")

    def equations(self, p, u, x, t):
        acceleration, derivatives = observer.acceleration(u.velocity, x.estimate, x.trend, p.bandwidth)
        heavy = plane.unit(u.theta + x.angle + p.phase)
        normal = plane.unit(u.theta + p.crack_phase)
        coupling = 0.5 * (1 + cos(u.theta + p.crack_phase)) * p.crack_coupling
        torque = -p.unbalance * plane.along(acceleration - vec(_GRAVITY, 0), plane.times_i(heavy))
        torque = torque - coupling * plane.along(u.displacement + vec(p.sag, 0), normal)
        twisting = torque / p.inertia - 2 * p.damping_ratio * p.frequency * x.rate - p.frequency**2 * x.angle
        turning = (u.speed + x.rate) ** 2 * heavy - twisting * plane.times_i(heavy)
        turning = turning - u.speed**2 * plane.unit(u.theta + p.phase)
        return Equations(
            outputs={"force": p.unbalance * turning - coupling * x.angle * normal, "twist": x.angle},
            derivatives={"angle": x.rate, "rate": twisting, **derivatives},
        )
