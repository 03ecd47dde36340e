"""Mass that a model leaves out."""

from rotorsim.blocks.common import observer

from rotorsim.block import Block, Equations, In, Out, Param, State
from rotorsim.fault import Fault


class MassError(Block):
    """Give the inertia force of a mass beyond that of the model.

    F = -mass q''

    q'' comes from the velocity through an observer of frequency w = `bandwidth`: q'' (1 + sqrt(2) s / w) / D,
    D = 1 + sqrt(2) s / w + (s / w)^2. It falls short by (f / f_w)^2, 0.1 % at 500 Hz with the default, in phase,
    so that it hardly damps. RK4 is stable up to a step of 2 / w, 20 us, for a mass up to half of that which moves at
    its place; a lower w allows longer steps.
    """

    source = "Newton's second law; Luenberger, IEEE Trans. Autom. Control 16 (1971) 596-602 (observer)"
    faults = (
        Fault(
            physics="mass_error",
            enters="force",
            free={"mass": (0.02,)},
            sizes=("mass",),
            law="grows with the square of frequency; shifts the critical speed",
            confused_with=("sensor_gain", "support_stiffness", "magnetic_pull"),
            told_apart_by="weigh the rotor; a known mass added",
        ),
    )

    velocity = In(shape="signal", unit="m/s", doc="velocity")
    force = Out(shape="signal", unit="N", doc="force on what moves")
    mass = Param(0.1, unit="kg", doc="dm; negative: the model has too much")
    bandwidth = observer.BANDWIDTH
    estimate = State(shape="signal", unit="m/s", doc="velocity as observed")
    trend = State(shape="signal", unit="m/s^2", doc="acceleration as observed")

    def equations(self, p, u, x, t):
        acceleration, derivatives = observer.acceleration(u.velocity, x.estimate, x.trend, p.bandwidth)
        return Equations(outputs={"force": -p.mass * acceleration}, derivatives=derivatives)
