"""PID controller with cross coupling of the two axes."""

from rotorsim.blocks.common import controller as control

from rotorsim.block import Block, Equations, Param, State, vec


class CrossCoupledPid(Block):
    """Control a magnetic bearing by PID action on each axis and cross terms between the axes.

    i_x = KP e_x + KI int e_x dt + KD u_x' + KPC e_y + KDC u_y'
    i_y = KP e_y + KI int e_y dt + KD u_y' - KPC e_x - KDC u_x'

    In complex form, r = x + j y: i = (KP - j KPC) e + KI int e dt + (KD - j KDC) r'. KDC opposes or aids gyroscopic
    moments; KPC adds damping to one whirl direction and takes it from the other (KPC > 0, KDC = 0: from forward to
    backward for a bearing force -k_i i). e = u - reference; u' as in `pid`. With KPC = KDC = 0 this is `pid`.
    """

    source = "Ahrens, Kucera and Larsonneur, IEEE Trans. Control Syst. Technol. 4 (1996) 494-502; thesis eq. (2.24)"

    ports = control.PORTS
    gains = control.GAINS
    KPC = Param(0.0, unit="A/m", doc="proportional cross gain")
    KDC = Param(0.0, unit="A s/m", doc="derivative cross gain")
    integral = State(shape=2, unit="m s", doc="integral of e")
    filter = control.FILTER

    def equations(self, p, u, x, t):
        direct, error, velocity, derivatives = control.pid_of(p, u, x)
        cross = p.KPC * error + p.KDC * velocity
        return Equations(outputs={"current": direct + vec(cross[1], -cross[0])}, derivatives=derivatives)
