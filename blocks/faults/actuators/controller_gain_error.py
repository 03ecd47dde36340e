"""Controller whose gains are not the stated ones."""

from rotorsim.blocks.common import sensor

from rotorsim.block import Block, Equations, In, Out, Param
from rotorsim.fault import Fault

THROUGH = {"displacement": "weighted_displacement", "velocity": "weighted_velocity"}


class ControllerGainError(Block):
    """Weigh the inputs of a controller, as if its gains were in error.

    x_c = (1 + displacement_error) x,   v_c = (1 + velocity_error) v

    Before a PID controller with a wired velocity it makes the gains (1 + displacement_error) KP and KI and
    (1 + velocity_error) KD. Where the controller makes its own velocity, all three are (1 + displacement_error) fold.
    """

    source = "Schweitzer & Maslen (2009), ch. 2 (PD control); thesis eq. (2.24)"
    faults = (
        Fault(
            physics="controller_gain_error",
            enters="wire",
            through=THROUGH,
            recorded="before",
            free={"displacement_error": (0.01,), "velocity_error": (0.01,)},
            sizes=("displacement_error", "velocity_error"),
            law="residual of the control law, in proportion to displacement and to velocity",
            confused_with=("current_sensor_gain", "control_delay", "amplifier_bandwidth"),
            told_apart_by="the current in the coil measured by another instrument",
        ),
    )

    displacement = In(shape=2, unit="m", doc="displacement [x, y]")
    velocity = In(shape=2, unit="m/s", optional=True, doc="velocity [x, y]; unwired: zero")
    weighted_displacement = Out(shape=2, unit="m", doc="displacement [x, y] for the controller")
    weighted_velocity = Out(shape=2, unit="m/s", doc="velocity [x, y] for the controller")
    displacement_error = Param(0.05, doc="relative error of the gains of displacement")
    velocity_error = Param(0.0, doc="relative error of the gain of velocity")

    def equations(self, p, u, x, t):
        return Equations(
            outputs={
                "weighted_displacement": (1 + p.displacement_error) * u.displacement,
                "weighted_velocity": (1 + p.velocity_error) * sensor.velocity_of(u),
            }
        )
