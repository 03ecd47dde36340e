"""Runout of the surface that a displacement sensor sees."""

from rotorsim.blocks.common import plane, sensor

from rotorsim.block import Block, In, Param
from rotorsim.fault import Fault, Of


def _names(order: int) -> tuple[str, str]:
    """Return the parameters that hold size and angle of an order."""
    k = abs(order)
    return (f"amplitude{k}", f"phase{k}") if order > 0 else (f"backward{k}", f"backward_phase{k}")


def _order(order: int, size: float = 0.0) -> tuple[Param, Param]:
    """Declare r_k of an order k."""
    amplitude, phase = _names(order)
    return (
        Param(size, name=amplitude, unit="m", low=0.0, doc=f"|r_{order}|"),
        Param(0.0, name=phase, unit="rad", doc=f"angle of r_{order}"),
    )


def _fault(*orders: int) -> Fault:
    """Return the declaration with some orders."""
    free: dict[str, tuple[float, ...]] = {}
    for order in orders:
        size, phase = _names(order)
        free |= {size: (1e-6 if order == 1 else 3e-7,), phase: plane.ANGLES if order > 0 else (0.0,)}
    sizes = tuple(_names(order)[0] for order in orders)
    return Fault(
        physics="runout",
        enters="wire",
        through=sensor.THROUGH,
        free=free,
        most={key: Of("displacement", 1e3) for key in sizes},
        sizes=sizes,
        law="constant amplitude at every speed, at slow roll too; the controller follows it, so that it drives a force",
        confused_with=("residual_bow", "blade_pass", "sensor_offset"),
        told_apart_by="a probe at the disc, another set of gains",
    )


class Runout(Block):
    """Add the runout of the sensed surface to the displacement that a sensor sees.

    x_s = x + sum_k r_k e^{i k theta},   k = 1, 2, 3, -1, -2, -3,   z = x + i y
    r_k = amplitude_k e^{i phase_k} for k > 0,   backward_k e^{i backward_phase_k} for k < 0

    The sensed velocity is that of x_s, with i k W r_k e^{i k theta}. The shaft itself does not move by r_k.
    """

    source = "Schweitzer & Maslen (2009), ch. 3 (sensors); API 670 (runout of the probe track)"
    faults = (_fault(1), _fault(1, 2), _fault(1, 2, 3), _fault(1, 2, -1, -2), _fault(1, 2, 3, -1, -2, -3))

    ports = sensor.PORTS
    theta = In(unit="rad", doc="shaft angle")
    speed = In(unit="rad/s", doc="shaft speed W")
    forward = (*_order(1, 1e-6), *_order(2), *_order(3))
    backward = (*_order(-1), *_order(-2), *_order(-3))

    def equations(self, p, u, x, t):
        displacement, velocity = u.displacement, sensor.velocity_of(u)
        for k in (1, 2, 3, -1, -2, -3):
            size, phase = (getattr(p, name) for name in _names(k))
            r = size * plane.unit(k * u.theta + phase)
            displacement = displacement + r
            if u.velocity is not None:
                velocity = velocity + k * u.speed * plane.times_i(r)
        return sensor.sensed(displacement, velocity)
