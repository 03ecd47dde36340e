"""PID control of the rigid modes of a rotor in two bearings."""

from rotorsim.block import Block, Equations, In, Out, Param, State, matrix


class ModalPid(Block):
    """Control two magnetic bearings by PID action on the translation and on the tilt of the rotor.

    q = T u,   T = [1, s_1 / l; 1, s_2 / l]^-1     translation, and tilt times the half distance l of the magnets
    c = KP e + KI int e dt + KD q',   e = q - T reference,   for each of the two
    i = 2 B (B^T B)^-1 c,   B = [1, m_1 / l; 1, m_2 / l],   l = |m_2 - m_1| / 2

    u: displacements of the two probes at s_1, s_2; i: currents of the two magnets at m_1, m_2, along the shaft from the
    centre of gravity. Forces k_i i of equal k_i then drive translation and tilt apart, wherever probes and magnets
    stand, and gains of both are those of one bearing: with magnets at the probes, at equal distances, and equal gains
    this is a `pid` in each bearing. q' is of the wired velocities, else through a filter as in `pid`.
    """

    source = "Schweitzer & Maslen (2009), 8.4 (tilt and translation control); thesis eq. (2.24)"

    displacement = In(shape=(2, 2), unit="m", by_parts=True, doc="displacements of the two probes [probe, xy]")
    velocity = In(
        shape=(2, 2),
        unit="m/s",
        optional=True,
        by_parts=True,
        doc="velocities at the probes; unwired: filtered derivative",
    )
    reference = In(
        shape=(2, 2), unit="m", optional=True, by_parts=True, doc="set-points of the displacements; unwired: zero"
    )
    current = Out(shape=(2, 2), unit="A", doc="control currents of the two magnets [magnet, xy]")
    probe_positions = Param([-0.2, 0.2], shape=2, unit="m", doc="s_1, s_2 from the centre of gravity")
    magnet_positions = Param([-0.2, 0.2], shape=2, unit="m", doc="m_1, m_2 from the centre of gravity")
    KP = Param([12200.0, 12200.0], shape=2, unit="A/m", doc="proportional gains of translation and tilt")
    KI = Param([2000.0, 2000.0], shape=2, unit="A/(m s)", doc="integral gains of translation and tilt")
    KD = Param([3.0, 3.0], shape=2, unit="A s/m", doc="derivative gains of translation and tilt")
    derivative_time_constant = Param(1e-4, unit="s", above=0.0, doc="filter of the derivative if velocity is unwired")
    integral = State(shape=(2, 2), unit="m s", doc="integral of e [mode, xy]")
    filtered = State(shape=(2, 2), unit="m", unless_wired="velocity", doc="q behind the filter [mode, xy]")

    def check(self, values):
        """Refuse probes or magnets that stand at one place."""
        return [
            f"{name} are {values[name][0]:g} m and {values[name][1]:g} m: two places tell translation from tilt"
            for name in ("probe_positions", "magnet_positions")
            if values[name][0] == values[name][1]
        ]

    def equations(self, p, u, x, t):
        s, m = p.probe_positions, p.magnet_positions
        half = ((m[1] - m[0]) ** 2) ** 0.5 / 2
        span = s[1] - s[0]
        to_modes = matrix([[s[1] / span, -s[0] / span], [-half / span, half / span]])
        first, second = m[0] / half, m[1] / half
        # B^T B = [2, first + second; first + second, first^2 + second^2], of determinant (second - first)^2
        a, b, d = 2.0, first + second, first**2 + second**2
        of = (second - first) ** 2 / 2
        to_magnets = matrix(
            [[(d - first * b) / of, (first * a - b) / of], [(d - second * b) / of, (second * a - b) / of]]
        )
        q = to_modes @ u.displacement
        error = q if u.reference is None else q - to_modes @ u.reference
        derivatives = {"integral": error}
        if u.velocity is not None:
            rate = to_modes @ u.velocity
        else:
            rate = (q - x.filtered) / p.derivative_time_constant
            derivatives["filtered"] = rate
        wanted = [
            [p.KP[k] * error[k, axis] + p.KI[k] * x.integral[k, axis] + p.KD[k] * rate[k, axis] for axis in (0, 1)]
            for k in (0, 1)
        ]
        return Equations(outputs={"current": to_magnets @ matrix(wanted)}, derivatives=derivatives)
