"""Sensor beside the bearing."""

from rotorsim.blocks.common import sensor

from rotorsim.block import Block, In, Param
from rotorsim.fault import Fault


class NonCollocation(Block):
    """Give the displacement at a sensor that lies beside the bearing.

    x_s = u + distance a,   u and a: displacement and tilt of the rotor in the bearing
    """

    source = "Schweitzer & Maslen (2009), ch. 10 (non-collocation)"
    faults = (
        Fault(
            physics="non_collocation",
            enters="wire",
            through=sensor.THROUGH,
            free={"distance": (0.005,)},
            sizes=("distance",),
            law="grows with mode 2, where the shaft tilts at the bearing",
            confused_with=("sensor_gain",),
            told_apart_by="speeds near the second mode; measure where the sensor sits",
        ),
    )

    ports = sensor.PORTS
    tilt = In(shape=2, unit="rad", doc="tilt in the planes of x and y")
    tilt_velocity = In(shape=2, unit="rad/s", doc="rate of tilt")
    distance = Param(0.02, unit="m", doc="position of the sensor beyond the bearing, along the shaft")

    def equations(self, p, u, x, t):
        displacement = u.displacement + p.distance * u.tilt
        return sensor.sensed(displacement, sensor.velocity_of(u) + p.distance * u.tilt_velocity)
