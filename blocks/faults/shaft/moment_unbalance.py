"""Moment unbalance of a disc."""

from rotorsim.blocks.common import plane

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class MomentUnbalance(Block):
    """Give the moment of a disc whose principal axis is skew to the shaft.

    M = (polar_inertia - diametral_inertia) skew (W^2 - i W') e^{i (theta + phase)}

    M = M_1 + i M_2 in the planes of x and y. The term with the angular acceleration W' is there where
    ``acceleration`` is wired.
    """

    source = "Friswell et al. (2010), ch. 6 (moment unbalance); ISO 21940-11 (couple unbalance)"
    faults = (
        Fault(
            physics="moment_unbalance",
            enters="force",
            free={"skew": (1e-4,), "phase": plane.ANGLES},
            sizes=("skew",),
            inherits=("polar_inertia", "diametral_inertia"),
            law="1X on the tilt, grows with the square of speed",
            confused_with=("unbalance_elsewhere", "gyroscopic_error", "angular_misalignment"),
            told_apart_by="speeds near the second mode, where the disc tilts",
        ),
    )

    theta = In(unit="rad", doc="shaft angle")
    speed = In(unit="rad/s", doc="shaft speed W")
    acceleration = In(unit="rad/s^2", optional=True, doc="angular acceleration W' of the shaft; unwired: zero")
    moment = Out(shape=2, unit="N m", doc="moment on the rotor, in the planes of x and y")
    polar_inertia = Param(0.0048, unit="kg m^2", low=0.0, doc="polar moment of inertia I_p of the disc")
    diametral_inertia = Param(0.0024, unit="kg m^2", low=0.0, doc="diametral moment of inertia I_d of the disc")
    skew = Param(1e-4, unit="rad", low=0.0, doc="angle tau between the principal axis and the shaft")
    phase = Param(0.0, unit="rad", doc="angle of the skew axis against the phase reference")

    def equations(self, p, u, x, t):
        skewed = (p.polar_inertia - p.diametral_inertia) * p.skew
        direction = plane.unit(u.theta + p.phase)
        moment = skewed * u.speed**2 * direction
        if u.acceleration is not None:
            moment = moment - skewed * u.acceleration * plane.times_i(direction)
        return Equations(outputs={"moment": moment})
