"""Sensors that are turned against the bearing."""

from rotorsim.blocks.common import plane, sensor

from rotorsim.block import Block, Param
from rotorsim.fault import Fault


class SensorRotation(Block):
    """Give the displacement in the axes of sensors that are turned against those of the bearing.

    x_s = e^{i angle} x,   z = x + i y

    In the loop it acts as cross-coupling: k_i K_P sin(angle) drives backward or forward whirl.
    """

    source = "Schweitzer & Maslen (2009), ch. 3 (displacement sensors)"
    faults = (
        Fault(
            physics="sensor_rotation",
            enters="wire",
            through=sensor.THROUGH,
            free={"angle": (0.01,)},
            sizes=("angle",),
            law="acts as cross-coupling: damping of forward whirl falls, of backward whirl rises, or the reverse",
            confused_with=("seal_cross_coupling", "internal_damping"),
            told_apart_by="another set of gains: the coupling follows them; turn the sensors",
        ),
    )

    ports = sensor.PORTS
    angle = Param(0.05, unit="rad", doc="angle by which the sensed motion is turned forward")

    def equations(self, p, u, x, t):
        velocity = sensor.velocity_of(u)
        return sensor.sensed(plane.turned(u.displacement, p.angle), plane.turned(velocity, p.angle))
