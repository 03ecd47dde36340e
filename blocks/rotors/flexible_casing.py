"""Casing of modes."""

import numpy as np

from rotorsim.block import Block, Equations, In, Option, Out, Param, State, matrix, rows

SYMMETRIC = 1e-6  # of the largest entry: what is written with seven digits


class FlexibleCasing(Block):
    """Move a flexible casing by its modes: what magnets push against and probes stand on, in the place of a casing.

    modal_mass_r (q_r'' + 2 damping_ratio_r w_r q_r' + w_r^2 q_r) = sum_s (mode_shape_x_rs f_sx + mode_shape_y_rs f_sy)
    u_sx = sum_r mode_shape_x_rs q_r,   u_sy = sum_r mode_shape_y_rs q_r,   w_r = natural_frequency_r

    r: modes of the casing without the rotor, from a finite-element model or a modal test; s: stations, where bearings
    push and probes stand. A mode may move in both directions. Mass-normalised shapes have modal masses of 1 kg. Modes
    of a casing without its feet include rigid ones of 0 Hz (shape 1, its mass; shape z - z_G, its moment of inertia);
    every foot is a station then, and a block support. Displacements are those from rest under its own weight. Modes
    that are left out take their flexibility with them: the casing is too stiff below them. With option residual

    u = sum_r mode_shape_r q_r + e,   e'' + 2 residual_damping_ratio w e' + w^2 (e - R f) = 0,   w = residual_frequency

    R in x and in y: residual_flexibility, sum phi_r phi_r^T / (m_r w_r^2) of the modes left out, which is the static
    flexibility less that of the modes given. It is exact at rest, in error by the order of (frequency / w)^2 of R, w
    about that of the first mode left out, and exact where all that are left out have the frequency w. That forces act
    on e'' and not on e keeps bearings free of algebraic loops, and what R moves passive.
    """

    category = "casing"
    source = "Ewins, Modal Testing (2000), ch. 2 (damping), 4 (residuals); Friswell et al. (2010), ch. 6 (foundations)"

    force = In(shape=("station", 2), unit="N", additive=True, conjugate="displacement", doc="forces [station, xy]")
    displacement = Out(shape=("station", 2), unit="m", doc="displacement [station, xy]")
    velocity_port = Out(name="velocity", shape=("station", 2), unit="m/s", doc="velocity [station, xy]")
    residual = Option(False, kind=bool, doc="with the flexibility of the modes that are left out")
    natural_frequency = Param(shape=("mode",), unit="rad/s", low=0.0, doc="undamped natural frequency of each mode")
    damping_ratio = Param(0.01, shape=("mode",), low=0.0, high=1.0, doc="damping ratio of each mode, or of all")
    modal_mass = Param(1.0, shape=("mode",), unit="kg", above=0.0, doc="modal mass of each mode, with this shape")
    mode_shape_x = Param(shape=("mode", "station"), doc="shape of each mode in x [mode, station]; 0: none moves in x")
    mode_shape_y = Param(shape=("mode", "station"), doc="shape of each mode in y [mode, station]; 0: none moves in y")
    residual_flexibility_x = Param(
        0.0, shape=("station", "station"), unit="m/N", doc="R in x [station, station], option residual"
    )
    residual_flexibility_y = Param(
        0.0, shape=("station", "station"), unit="m/N", doc="R in y [station, station], option residual"
    )
    residual_frequency = Param(0.0, unit="rad/s", low=0.0, doc="w, about that of the first mode left out")
    residual_damping_ratio = Param(0.01, low=0.0, high=1.0, doc="damping ratio of what R moves")
    position = State(shape=("mode",), unit="m", doc="modal displacements q")
    velocity = State(shape=("mode",), unit="m/s", doc="their rates")
    sway = State(
        shape=("station", 2), unit="m", when=lambda o: o.residual, doc="e, of the modes left out [station, xy]"
    )
    sway_rate = State(shape=("station", 2), unit="m/s", when=lambda o: o.residual, doc="its rate")

    def check(self, values):
        """Refuse a residual without a frequency, or of a matrix that no casing has."""
        if not self.option.residual:
            return []
        said = []
        if not values["residual_frequency"] > 0:
            said.append("option residual needs residual_frequency above 0: about that of the first mode left out")
        for name in ("residual_flexibility_x", "residual_flexibility_y"):
            R = np.asarray(values[name])
            size = np.abs(R).max(initial=0.0)
            if np.abs(R - R.T).max(initial=0.0) > SYMMETRIC * size:
                said.append(f"{name} must be symmetric: what one station does to another")
            elif np.linalg.eigvalsh((R + R.T) / 2).min(initial=0.0) < -SYMMETRIC * size:
                said.append(f"{name} must have no negative eigenvalue: static flexibility less that of the modes given")
        return said

    def equations(self, p, u, x, t):
        pushed = p.mode_shape_x @ u.force[:, 0] + p.mode_shape_y @ u.force[:, 1]
        held = 2 * p.damping_ratio * p.natural_frequency * x.velocity + p.natural_frequency**2 * x.position

        def seen(q):
            return matrix(list(zip(rows(p.mode_shape_x.T @ q), rows(p.mode_shape_y.T @ q), strict=True)))

        outputs = {"displacement": seen(x.position), "velocity": seen(x.velocity)}
        derivatives = {"position": x.velocity, "velocity": pushed / p.modal_mass - held}
        if self.option.residual:
            w = p.residual_frequency
            bent = zip(
                rows(p.residual_flexibility_x @ u.force[:, 0]),
                rows(p.residual_flexibility_y @ u.force[:, 1]),
                strict=True,
            )
            derivatives["sway"] = x.sway_rate
            derivatives["sway_rate"] = (
                w**2 * (matrix(list(bent)) - x.sway) - 2 * p.residual_damping_ratio * w * x.sway_rate
            )
            outputs = {"displacement": outputs["displacement"] + x.sway, "velocity": outputs["velocity"] + x.sway_rate}
        return Equations(outputs=outputs, derivatives=derivatives)
