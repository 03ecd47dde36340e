"""Offset of a displacement sensor."""

from rotorsim.blocks.common import sensor

from rotorsim.block import Block, Param, vec
from rotorsim.fault import Fault, Of


class SensorOffset(Block):
    """Add a constant to the displacement that a sensor gives.

    x_s = x + d,   d = [offset_x, offset_y]        the velocity is not changed
    """

    source = "Schweitzer & Maslen (2009), ch. 3 (displacement sensors)"
    faults = (
        Fault(
            physics="sensor_offset",
            enters="wire",
            through=sensor.THROUGH,
            free={"offset_x": (1e-6,), "offset_y": (1e-6,)},
            most={"offset_x": Of("displacement", 1e3), "offset_y": Of("displacement", 1e3)},
            sizes=("offset_x", "offset_y"),
            law="order 0 only",
            confused_with=("sag", "parallel_misalignment"),
            told_apart_by="the bearing without current, the rotor lifted or turned by hand",
        ),
    )

    ports = sensor.PORTS
    offset_x = Param(5e-6, unit="m", doc="offset of the sensor of x")
    offset_y = Param(0.0, unit="m", doc="offset of the sensor of y")

    def equations(self, p, u, x, t):
        displacement = u.displacement + vec(p.offset_x, p.offset_y)
        return sensor.sensed(displacement, sensor.velocity_of(u))
