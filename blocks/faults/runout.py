"""Runout of the surface that a displacement sensor sees."""

from rotorsim.blocks.common import plane, sensor

from rotorsim.block import Block, In, Param
from rotorsim.fault import Fault, Of

_LAW = "constant amplitude at every speed, at slow roll too; the controller follows it, so that it drives a force"
_CONFUSED = ("residual_bow", "blade_pass", "sensor_offset")
_TOLD = "a probe at the disc, another set of gains"


def _fault(forward: int, backward: int) -> Fault:
    """Return the declaration with orders 1 to forward and -1 to -backward."""
    free: dict[str, tuple[float, ...]] = {}
    for k in range(1, forward + 1):
        free |= {f"amplitude{k}": (1e-6 if k == 1 else 3e-7,), f"phase{k}": plane.ANGLES}
    for k in range(1, backward + 1):
        free |= {f"backward{k}": (3e-7,), f"backward_phase{k}": (0.0,)}
    sizes = tuple(key for key in free if "phase" not in key)
    return Fault(
        physics="runout",
        enters="wire",
        through=sensor.THROUGH,
        free=free,
        most={key: Of("displacement", 1e3) for key in sizes},
        sizes=sizes,
        law=_LAW,
        confused_with=_CONFUSED,
        told_apart_by=_TOLD,
    )


class Runout(Block):
    """Add the runout of the sensed surface to the displacement that a sensor sees.

    x_s = x + sum_k r_k e^{i k theta},   k = 1, 2, 3, -1, -2, -3,   z = x + i y
    r_k = amplitude_k e^{i phase_k} for k > 0,   backward_k e^{i backward_phase_k} for k < 0

    The sensed velocity is that of x_s, with i k W r_k e^{i k theta}. The shaft itself does not move by r_k.
    """

    source = "Schweitzer & Maslen (2009), ch. 3 (sensors); API 670 (runout of the probe track)"
    faults = tuple(_fault(*orders) for orders in ((1, 0), (2, 0), (3, 0), (2, 2), (3, 3)))

    displacement = sensor.DISPLACEMENT
    velocity = sensor.VELOCITY
    theta = In(unit="rad", doc="shaft angle")
    speed = In(unit="rad/s", doc="shaft speed W")
    sensed_displacement = sensor.SENSED_DISPLACEMENT
    sensed_velocity = sensor.SENSED_VELOCITY
    amplitude1 = Param(1e-6, unit="m", low=0.0, doc="|r_1|")
    phase1 = Param(0.0, unit="rad", doc="angle of r_1")
    amplitude2 = Param(0.0, unit="m", low=0.0, doc="|r_2|")
    phase2 = Param(0.0, unit="rad", doc="angle of r_2")
    amplitude3 = Param(0.0, unit="m", low=0.0, doc="|r_3|")
    phase3 = Param(0.0, unit="rad", doc="angle of r_3")
    backward1 = Param(0.0, unit="m", low=0.0, doc="|r_-1|")
    backward_phase1 = Param(0.0, unit="rad", doc="angle of r_-1")
    backward2 = Param(0.0, unit="m", low=0.0, doc="|r_-2|")
    backward_phase2 = Param(0.0, unit="rad", doc="angle of r_-2")
    backward3 = Param(0.0, unit="m", low=0.0, doc="|r_-3|")
    backward_phase3 = Param(0.0, unit="rad", doc="angle of r_-3")

    def equations(self, p, u, x, t):
        displacement, velocity = u.displacement, sensor.velocity_of(u)
        terms = [(k, getattr(p, f"amplitude{k}"), getattr(p, f"phase{k}")) for k in (1, 2, 3)]
        terms += [(-k, getattr(p, f"backward{k}"), getattr(p, f"backward_phase{k}")) for k in (1, 2, 3)]
        for k, size, phase in terms:
            r = size * plane.unit(k * u.theta + phase)
            displacement = displacement + r
            if u.velocity is not None:
                velocity = velocity + k * u.speed * plane.times_i(r)
        return sensor.sensed(displacement, velocity)
