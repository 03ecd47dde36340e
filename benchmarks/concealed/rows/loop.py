"""Rows of the catalogue in magnetic bearing, amplifier, controller, drive; and the aliases."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.integrator import Nodes
from benchmarks.concealed.plant import Bearing, CurrentPath, Plant
from benchmarks.concealed.rows.faults import ALIASES, ROWS, Array, Draw, Fault, per_axis, row
from benchmarks.concealed.simulate import Clock

PADE = 8


def bearing_at(plant: Plant, node: int) -> Bearing:
    """Return the bearing of a plant at a node."""
    return next(bearing for bearing in plant.bearings if bearing.node == node)


@row(ROWS, "magnetic_nonlinearity", "amb", beam="bearing")
def magnetic_nonlinearity(draw: Draw) -> Fault:
    """f = K [((i0 - i) / (g0 - x))^2 - ((i0 + i) / (g0 + x))^2] per axis, K = k_i g0^2 / 4 i0, g0 = k_i i0 / k_s."""
    bearing = draw.bearing
    ks, ki, current = bearing.ks, bearing.ki, f"i{bearing.mark}"
    least = max(draw.peaks[f"all {current}"] / 0.8, 1.6 * draw.peaks[f"all z{bearing.probe}"] * ks / ki)
    i0 = least * draw.size(10.0, 1.0)
    g0 = ki * i0 / ks
    K = ki * g0**2 / (4 * i0)

    def law(x: Array, i: Array) -> Array:
        return K * (((i0 - i) / (g0 - x)) ** 2 - ((i0 + i) / (g0 + x)) ** 2) - ks * x + ki * i

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {draw.place[0]: per_axis(law, motion[draw.place[1]], motion[current])}

    return Fault(
        "magnetic_nonlinearity",
        {"i0": i0, "g0": g0},
        draw.node,
        (bearing.amb,),
        feedback=feedback,
        reads=(draw.place[1], current),
        drives=draw.place[:1],
        corner=1e-15,
    )


@row(ROWS, "magnetic_saturation", "amb", beam="bearing")
def magnetic_saturation(draw: Draw) -> Fault:
    """f = k_s x - k_i i_s tanh(i / i_s) per axis: the field of the control current saturates."""
    bearing = draw.bearing
    ki, current = bearing.ki, f"i{bearing.mark}"
    limit = draw.peaks[current] * draw.size(30.0, 1.2)

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        lost = per_axis(lambda i, _: ki * (i - limit * np.tanh(i / limit)), motion[current], motion[current])
        return {draw.place[0]: lost}

    return Fault(
        "magnetic_saturation",
        {"is": limit},
        draw.node,
        (bearing.amb,),
        feedback=feedback,
        reads=(current,),
        drives=draw.place[:1],
        corner=1e-15,
    )


@row(ROWS, "eddy_current_lag", "amb", beam="bearing")
def eddy_current_lag(draw: Draw) -> Fault:
    """k_i i [(1 - a) + a / (1 + s tau)]: part of the force comes late; the current is recorded before it."""
    tau, part = draw.lag(1.5e-6, 6e-4), draw.between(0.3, 0.9)

    def alter(plant: Plant, speed: float) -> None:
        bearing_at(plant, draw.node).path = CurrentPath(1 - part, (-1 / tau,), (part / tau,))

    return Fault("eddy_current_lag", {"tau": tau, "part": part}, draw.node, (draw.bearing.amb,), alter=alter)


@row(ROWS, "amplifier_bandwidth", "amb", beam="bearing")
def amplifier_bandwidth(draw: Draw) -> Fault:
    """i = i_c / (1 + s / w_a); the force follows i, i_c is recorded: an eddy current lag of the whole force."""
    tau = draw.lag(1e-6, 3e-4)

    def alter(plant: Plant, speed: float) -> None:
        bearing_at(plant, draw.node).path = CurrentPath(0.0, (-1 / tau,), (1 / tau,))

    places = (draw.bearing.amb, draw.bearing.controller, "amplifier")
    return Fault("amplifier_bandwidth", {"wa": 1 / tau}, draw.loop_node, places, ("eddy_current_lag",), alter=alter)


@row(ROWS, "amb_cross_coupling", "amb", beam="bearing")
def amb_cross_coupling(draw: Draw) -> Fault:
    """k_i (i + eps conj i)."""
    eps, bearing = draw.sign() * draw.size(1e-4, 0.12), draw.bearing
    current = f"i{bearing.mark}"

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {draw.place[0]: -bearing.ki * eps * np.conj(motion[current])}

    return Fault(
        "amb_cross_coupling",
        {"eps": eps},
        draw.node,
        (bearing.amb,),
        feedback=feedback,
        reads=(current,),
        drives=draw.place[:1],
    )


def late(delay: float) -> CurrentPath:
    """Return e^{-s delay} as partial fractions of its diagonal Pade approximant of order 8."""
    n = PADE
    terms = np.ones(n + 1, np.longdouble)  # of (s delay)^k
    for k in range(n):
        terms[k + 1] = terms[k] * (n - k) / ((2 * n - k) * np.longdouble(k + 1))
    slopes = terms[1:] * np.arange(1, n + 1)

    def value(coefficients: Array, x: Array) -> Array:
        total = np.zeros_like(x)
        for c in coefficients[::-1]:
            total = total * x + c
        return total

    x = np.polynomial.Polynomial(terms.astype(float)).roots().astype(np.clongdouble)
    for _ in range(4):  # the roots are ill-conditioned in double precision
        x = x - value(terms, x) / value(slopes, x)
    poles = x.astype(complex)
    residues = (value(terms * (-1) ** np.arange(n + 1), x) / value(slopes, x)).astype(complex)
    return CurrentPath((-1.0) ** n, tuple(poles / delay), tuple(residues / delay), recorded=True)


@row(ROWS, "control_delay", "controller", beam="bearing")
def control_delay(draw: Draw) -> Fault:
    """i = C e^{-s tau} x."""
    tau = draw.lag(6e-7, 3e-4)

    def alter(plant: Plant, speed: float) -> None:
        bearing_at(plant, draw.node).path = late(tau)

    return Fault("control_delay", {"delay": tau}, draw.bearing.probe, (draw.bearing.controller,), alter=alter)


@row(ROWS, "controller_gain_error", "controller", beam="bearing")
def controller_gain_error(draw: Draw) -> Fault:
    """One gain of the controller is not the stated one."""
    which = int(draw.rng.integers(2)) * 2  # K_P or K_D
    factor = 1 + draw.sign() * draw.size(1e-3, 0.15)

    def alter(plant: Plant, speed: float) -> None:
        bearing = bearing_at(plant, draw.node)
        gains = list(bearing.gains)
        gains[which] *= factor
        bearing.gains = (gains[0], gains[1], gains[2])

    name = ("KP", "KI", "KD")[which]
    blocks = (draw.bearing.controller,)
    return Fault("controller_gain_error", {f"{name}_factor": factor}, draw.bearing.probe, blocks, alter=alter)


@row(ROWS, "current_clipping", "amb", beam="bearing")
def current_clipping(draw: Draw) -> Fault:
    """i = sat(i_c, +-i_max) per axis; i is recorded and makes the force."""
    bearing = draw.bearing
    ki, current = bearing.ki, f"i{bearing.mark}"
    limit = draw.peaks[current] * (0.995 - 0.45 * draw.strength)

    def clip(i: Array) -> Array:
        return np.asarray(np.clip(i.real, -limit, limit) + 1j * np.clip(i.imag, -limit, limit))

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {draw.place[0]: ki * (motion[current] - clip(motion[current]))}

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        signals[f"current{bearing.mark}"] = clip(signals[f"current{bearing.mark}"])

    return Fault(
        "current_clipping",
        {"imax": limit},
        draw.loop_node,
        (bearing.controller, bearing.amb, "amplifier"),
        feedback=feedback,
        measure=measure,
        reads=(current,),
        drives=draw.place[:1],
        corner=2e-16,
    )


@row(ROWS, "base_excitation", "drive", beam="machine")
def base_excitation(draw: Draw) -> Fault:
    """f = -M r a_b cos(w_b t + phase), of one frequency at every speed, along one direction."""
    size, frequency, direction = draw.size(4e-4, 0.5), draw.between(9.0, 90.0), draw.angle()
    phases = draw.phases

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        return {"base": size * np.exp(1j * direction) * np.cos(2 * np.pi * frequency * clock.t + phases)}

    effect = {"acceleration": size, "frequency": frequency, "direction": direction}
    return Fault("base_excitation", effect, None, force=force, drives=("base",), synchronous=False)


@row(ROWS, "speed_fluctuation", "drive", beam="machine", alone=True)
def speed_fluctuation(draw: Draw) -> Fault:
    """theta = W t + eps sin(nu t + phase)."""
    size, nu, phases = draw.size(8e-5, 0.05), 2 * np.pi * draw.between(1.5, 18.0), draw.phases

    def wobble(t: Array) -> tuple[Array, Array, Array]:
        a = nu * t + phases
        return size * np.sin(a), size * nu * np.cos(a), -size * nu**2 * np.sin(a)

    effect = {"eps": size, "frequency": nu / (2 * np.pi)}
    return Fault("speed_fluctuation", effect, None, ("clock", "rotor"), wobble=wobble)


@row(ROWS, "torsion_coupling", "drive", beam="machine", alone=True)
def torsion_coupling(draw: Draw) -> Fault:
    """The disc, with crack and unbalance, turns by phi = phi_0 sin(w_t t + phase) against the tacho.

    theta + phi stands for theta in the crack, and m e ((W + phi')^2 - i phi'') e^{i(theta + phi + beta)} for unbalance.
    """
    size, nu, phases = draw.size(2e-5, 0.05), 2 * np.pi * draw.between(25.0, 140.0), draw.phases

    def twist(t: Array) -> tuple[Array, Array, Array]:
        a = nu * t + phases
        return size * np.sin(a), size * nu * np.cos(a), -size * nu**2 * np.sin(a)

    effect, blocks = {"phi": size, "frequency": nu / (2 * np.pi)}, ("clock", "rotor", *draw.unbalances)
    return Fault("torsion_coupling", effect, None, blocks, ("speed_fluctuation",), twist=twist)


@row(ROWS, "blade_pass", "excitation", beam="probe")
def blade_pass(draw: Draw) -> Fault:
    """f e^{+-i(N theta + phase)}."""
    size, N, phase = draw.size(3e-4, 0.8), int(draw.rng.integers(6, 13)) * draw.sign(), draw.angle()

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        return {draw.place[0]: size * np.exp(1j * (N * clock.theta + phase))}

    return Fault("blade_pass", {"force": size, "N": N, "phase": phase}, draw.node, force=force, drives=draw.place[:1])


SAME = ("sensor_gain", "mass_error", "support_stiffness", "magnetic_pull")


def _alias(physics: str, effect: dict[str, float], draw: Draw, change: tuple[str, float]) -> Fault:
    what, size = change

    def alter(plant: Plant, speed: float) -> None:
        dof = plant.displacement[draw.node]
        if what == "probes":
            plant.probes = {node: row_of * (1 + size) for node, row_of in plant.probes.items()}
        else:
            getattr(plant, what)[dof, dof] += size

    others = SAME if draw.machine == "jeffcott" else tuple(name for name in SAME if name != "mass_error")
    return Fault(physics, effect, draw.node, ("rotor", draw.bearing.amb, "support"), others, alter=alter)


@row(ALIASES, "sensor_gain", "alias", beam="bearing")
def every_sensor_gain(draw: Draw) -> Fault:
    """x_s = (1 + eps) x at every probe: k_i, dk and e grow by 1 + eps."""
    eps = draw.sign() * draw.size(5e-3, 0.15)
    return _alias("sensor_gain", {"eps": eps}, draw, ("probes", eps))


@row(ALIASES, "mass_error", "alias")
def whole_mass_error(draw: Draw) -> Fault:
    """f = -dm q'' on the only mass: everything else scales."""
    size = draw.sign() * draw.size(0.01, 0.3)
    return _alias("mass_error", {"dm": size}, draw, ("mass", size))


@row(ALIASES, "support_stiffness", "alias", beam="bearing")
def stiffness_at_the_bearing(draw: Draw) -> Fault:
    """f = -dk q where k_s q acts."""
    size = draw.size(1e3, 5e4)
    return _alias("support_stiffness", {"dk": size}, draw, ("stiffness", size))


@row(ALIASES, "magnetic_pull", "alias", beam="bearing")
def pull_at_the_bearing(draw: Draw) -> Fault:
    """f = +k_m q where k_s q acts."""
    size = draw.size(1e3, 5e4)
    return _alias("magnetic_pull", {"km": size}, draw, ("stiffness", -size))
