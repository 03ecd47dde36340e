"""Gain error of a current, or of its measurement."""

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault


class CurrentGain(Block):
    """Scale a current.

    i_m = (1 + gain_error) i

    In the wire from the controller to the bearing: gains of the controller that are all in error alike. As a reading:
    the scale of the current sensor.
    """

    source = "Schweitzer & Maslen (2009), ch. 3 (current sensors and amplifiers)"
    faults = (
        Fault(
            physics="current_sensor_gain",
            enters="reading",
            between=("controller", "bearing"),
            through={"current": "scaled_current"},
            free={"gain_error": (0.01,)},
            sizes=("gain_error",),
            law="the recorded current alone, by the same factor at every frequency",
            confused_with=("force_current_factor", "controller_gain_error"),
            told_apart_by="the current measured by another instrument; the force of a known current",
        ),
        Fault(
            physics="controller_gain_error",
            enters="wire",
            between=("controller", "bearing"),
            through={"current": "scaled_current"},
            recorded="after",
            free={"gain_error": (0.01,)},
            sizes=("gain_error",),
            law="residual of the control law, in proportion to the stated current",
            confused_with=("current_sensor_gain", "control_delay", "amplifier_bandwidth"),
            told_apart_by="the current in the coil measured by another instrument",
        ),
    )

    current = In(shape="signal", unit="A", doc="current i")
    scaled_current = Out(shape="signal", unit="A", doc="(1 + gain_error) i")
    gain_error = Param(0.05, doc="relative error eps")

    def equations(self, p, u, x, t):
        return Equations(outputs={"scaled_current": (1 + p.gain_error) * u.current})
