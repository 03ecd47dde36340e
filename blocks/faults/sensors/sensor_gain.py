"""Gain error of a displacement sensor."""

from rotorsim.blocks.common import sensor

from rotorsim.block import Block, Param
from rotorsim.fault import Fault


class SensorGain(Block):
    """Scale the displacement that a sensor gives.

    x_s = (1 + gain_error) x

    Alone it is not found: it reads like a scale of mass, stiffness and force factors together.
    """

    source = "Schweitzer & Maslen (2009), ch. 3 (displacement sensors)"
    faults = (
        Fault(
            physics="sensor_gain",
            enters="wire",
            through=sensor.THROUGH,
            free={"gain_error": (0.01,)},
            sizes=("gain_error",),
            law="every order by the same factor; scales mass and stiffness alike",
            confused_with=("mass_error", "support_stiffness", "current_sensor_gain"),
            told_apart_by="a known displacement (the sensor moved by a micrometer), a trial weight",
        ),
    )

    ports = sensor.PORTS
    gain_error = Param(0.05, doc="relative error eps, the same in each axis")

    def equations(self, p, u, x, t):
        gain = 1 + p.gain_error
        return sensor.sensed(gain * u.displacement, gain * sensor.velocity_of(u))
