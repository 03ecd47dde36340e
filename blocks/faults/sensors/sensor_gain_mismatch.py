"""Sensors of x and y that differ."""

from typing import Any

from rotorsim.blocks.common import plane, sensor

from rotorsim.block import Block, Param
from rotorsim.fault import Fault


class SensorGainMismatch(Block):
    """Give the displacement that sensors of unequal gain, or not at a right angle, see.

    x_s = x + eps conj(x),   eps = mismatch + i skew,   z = x + i y

    mismatch: the sensor of x reads (1 + mismatch) fold, that of y (1 - mismatch) fold. skew: each reads so much of the
    other axis.
    """

    source = "Schweitzer & Maslen (2009), ch. 3 (displacement sensors)"
    faults = Fault(
        physics="sensor_gain_mismatch",
        enters="wire",
        through=sensor.THROUGH,
        free={"mismatch": (0.01,)},
        sizes=("mismatch",),
        law="-k from the conjugate of k at every order, by the same factor",
        confused_with=("anisotropic_support", "amb_cross_coupling"),
        told_apart_by="slow roll and law of speed: the factor is the same at every order and speed",
        convention="the mean of both gains is taken as right, for no run shows it: if one sensor alone is off, "
        "all values that scale with the displacement are wrong by the mismatch",
    ).variants({"free": {"mismatch": (0.01,), "skew": (0.01,)}, "sizes": ("mismatch", "skew")})

    ports = sensor.PORTS
    mismatch = Param(0.02, doc="real part of eps, half of the difference of the gains")
    skew = Param(0.0, unit="rad", doc="imaginary part of eps, half of the error of the right angle")

    def equations(self, p, u, x, t):
        velocity = sensor.velocity_of(u)
        return sensor.sensed(_seen(p, u.displacement), _seen(p, velocity))


def _seen(p: Any, z: Any) -> Any:
    mirror = plane.conjugate(z)
    return z + p.mismatch * mirror + p.skew * plane.times_i(mirror)
