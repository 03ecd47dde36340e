"""What all models of a displacement sensor share: ports, and the wires that they stand in.

A sensor stands in the wires of displacement and velocity from the rotor to the controller. The velocity is that of the
sensed displacement; where the controller makes its own, neither `velocity` nor `sensed_velocity` is wired.
"""

from typing import Any

from rotorsim.block import Equations, In, Out

THROUGH = {"displacement": "sensed_displacement", "velocity": "sensed_velocity"}
PORTS = (
    In(name="displacement", shape=2, unit="m", doc="displacement [x, y] at the sensor"),
    In(name="velocity", shape=2, unit="m/s", optional=True, doc="velocity [x, y] at the sensor; unwired: zero"),
    Out(name="sensed_displacement", shape=2, unit="m", doc="displacement [x, y] as sensed"),
    Out(name="sensed_velocity", shape=2, unit="m/s", doc="velocity [x, y] as sensed"),
)


def velocity_of(u: Any) -> Any:
    """Return the wired velocity, or zeros in the shape of the displacement."""
    return 0 * u.displacement if u.velocity is None else u.velocity


def sensed(displacement: Any, velocity: Any, **more: Any) -> Equations:
    """Return the equations of a sensor that gives these two."""
    return Equations(outputs={"sensed_displacement": displacement, "sensed_velocity": velocity}, **more)
