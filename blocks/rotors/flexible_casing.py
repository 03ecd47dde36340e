"""Casing of modes."""

from rotorsim.block import Block, Equations, In, Out, Param, State, matrix, rows


class FlexibleCasing(Block):
    """Move a flexible casing by its modes: what magnets push against and probes stand on, in the place of a casing.

    modal_mass_r (q_r'' + 2 damping_ratio_r w_r q_r' + w_r^2 q_r) = sum_s (mode_shape_x_rs f_sx + mode_shape_y_rs f_sy)
    u_sx = sum_r mode_shape_x_rs q_r,   u_sy = sum_r mode_shape_y_rs q_r,   w_r = natural_frequency_r

    r: modes of the casing without the rotor, from a finite-element model or a modal test; s: stations, where bearings
    push and probes stand. A mode may move in both directions. Mass-normalised shapes have modal masses of 1 kg. Modes
    of a casing without its feet include rigid ones of 0 Hz (shape 1, its mass; shape z - z_G, its moment of inertia);
    every foot is a station then, and a block support. Displacements are those from rest under its own weight. Modes
    that are left out take their flexibility with them: the casing is too stiff below them.
    """

    category = "casing"
    source = "Ewins, Modal Testing (2000), ch. 2 (proportional damping); Friswell et al. (2010), ch. 6 (foundations)"

    force = In(shape=("station", 2), unit="N", additive=True, conjugate="displacement", doc="forces [station, xy]")
    displacement = Out(shape=("station", 2), unit="m", doc="displacement [station, xy]")
    velocity_port = Out(name="velocity", shape=("station", 2), unit="m/s", doc="velocity [station, xy]")
    natural_frequency = Param(shape=("mode",), unit="rad/s", low=0.0, doc="undamped natural frequency of each mode")
    damping_ratio = Param(0.01, shape=("mode",), low=0.0, high=1.0, doc="damping ratio of each mode, or of all")
    modal_mass = Param(1.0, shape=("mode",), unit="kg", above=0.0, doc="modal mass of each mode, with this shape")
    mode_shape_x = Param(shape=("mode", "station"), doc="shape of each mode in x [mode, station]; 0: none moves in x")
    mode_shape_y = Param(shape=("mode", "station"), doc="shape of each mode in y [mode, station]; 0: none moves in y")
    position = State(shape=("mode",), unit="m", doc="modal displacements q")
    velocity = State(shape=("mode",), unit="m/s", doc="their rates")

    def equations(self, p, u, x, t):
        pushed = p.mode_shape_x @ u.force[:, 0] + p.mode_shape_y @ u.force[:, 1]
        held = 2 * p.damping_ratio * p.natural_frequency * x.velocity + p.natural_frequency**2 * x.position

        def seen(q):
            return matrix(list(zip(rows(p.mode_shape_x.T @ q), rows(p.mode_shape_y.T @ q), strict=True)))

        return Equations(
            outputs={"displacement": seen(x.position), "velocity": seen(x.velocity)},
            derivatives={"position": x.velocity, "velocity": pushed / p.modal_mass - held},
        )
