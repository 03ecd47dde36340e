"""PID controller of a magnetic bearing."""

from typing import Any

from rotorsim.block import Block, Equations, In, Out, Param, State


class Pid(Block):
    """Control a magnetic bearing by proportional, integral and derivative action on each axis.

    i = KP e + KI int e dt + KD u'        e = u - reference        thesis eq. (2.24)

    u: displacement. u' is the wired velocity; without that wire it is taken from the displacement through a filter,
    s / (1 + derivative_time_constant s). It acts on the displacement alone, so a jump of the reference gives no kick.
    Positive displacement gives positive current. Gains: thesis Table 2-1.
    """

    source = "thesis eq. (2.24), Table 2-1"
    category = "controller"

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] at the bearing")
    velocity = In(shape=2, unit="m/s", optional=True, doc="rotor velocity [x, y]; unwired: filtered derivative")
    reference = In(shape=2, unit="m", optional=True, doc="set-point of the displacement; unwired: zero")
    current = Out(shape=2, unit="A", doc="control current [x, y]")
    KP = Param(12200.0, unit="A/m", doc="proportional gain")
    KI = Param(2000.0, unit="A/(m s)", doc="integral gain")
    KD = Param(3.0, unit="A s/m", doc="derivative gain")
    derivative_time_constant = Param(1e-4, unit="s", above=0.0, doc="filter of the derivative if velocity is unwired")
    initial_displacement = Param(
        [0.0, 0.0], shape=2, unit="m", doc="displacement before the start, for the filter of the derivative"
    )
    integral = State(shape=2, unit="m s", doc="integral of e")
    filtered = State(
        shape=2, unit="m", init="initial_displacement", unless_wired="velocity", doc="displacement behind the filter"
    )

    def equations(self, p: Any, u: Any, x: Any, t: Any) -> Equations:
        error = u.displacement if u.reference is None else u.displacement - u.reference
        derivatives = {"integral": error}
        velocity = u.velocity
        if velocity is None:
            velocity = derivatives["filtered"] = (u.displacement - x.filtered) / p.derivative_time_constant
        current = p.KP * error + p.KI * x.integral + p.KD * velocity
        return Equations(outputs={"current": current}, derivatives=derivatives)
