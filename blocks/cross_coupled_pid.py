"""PID controller with cross coupling of the two axes."""

from typing import Any

from rotorsim.block import Block, Equations, In, Out, Param, State, vec


class CrossCoupledPid(Block):
    """Control a magnetic bearing by PID action on each axis and cross terms between the axes.

    i_x = KP e_x + KI int e_x dt + KD u_x' + KPC e_y + KDC u_y'
    i_y = KP e_y + KI int e_y dt + KD u_y' - KPC e_x - KDC u_x'

    In complex form, r = x + j y: i = (KP - j KPC) e + KI int e dt + (KD - j KDC) r'. KDC opposes or aids gyroscopic
    moments; KPC adds damping to one whirl direction and takes it from the other (KPC > 0, KDC = 0: from forward to
    backward for a bearing force -k_i i). e = u - reference; u' as in `pid`. With KPC = KDC = 0 this is `pid`.
    """

    source = "Ahrens, Kucera and Larsonneur, IEEE Trans. Control Syst. Technol. 4 (1996) 494-502; thesis eq. (2.24)"
    category = "controller"

    displacement = In(shape=2, unit="m", doc="rotor displacement [x, y] at the bearing")
    velocity = In(shape=2, unit="m/s", optional=True, doc="rotor velocity [x, y]; unwired: filtered derivative")
    reference = In(shape=2, unit="m", optional=True, doc="set-point of the displacement; unwired: zero")
    current = Out(shape=2, unit="A", doc="control current [x, y]")
    KP = Param(12200.0, unit="A/m", doc="proportional gain")
    KI = Param(2000.0, unit="A/(m s)", doc="integral gain")
    KD = Param(3.0, unit="A s/m", doc="derivative gain")
    KPC = Param(0.0, unit="A/m", doc="proportional cross gain")
    KDC = Param(0.0, unit="A s/m", doc="derivative cross gain")
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
        direct = p.KP * error + p.KI * x.integral + p.KD * velocity
        cross = p.KPC * error + p.KDC * velocity
        return Equations(outputs={"current": direct + vec(cross[1], -cross[0])}, derivatives=derivatives)
