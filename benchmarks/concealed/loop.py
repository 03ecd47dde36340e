"""Rows of the catalogue in magnetic bearing, amplifier, controller, probes, converter, drive; and the aliases."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.faults import ALIASES, AMB, CONTROLLER, ROWS, Array, Draw, Fault, per_axis, row
from benchmarks.concealed.integrator import Nodes
from benchmarks.concealed.mechanical import EVERY
from benchmarks.concealed.plant import CurrentPath, Plant
from benchmarks.concealed.simulate import Clock

PADE = 8


@row(ROWS, "magnetic_nonlinearity", "amb", fe=(3,))
def magnetic_nonlinearity(draw: Draw) -> Fault:
    """f = K [((i0 - i) / (g0 - x))^2 - ((i0 + i) / (g0 + x))^2] per axis, K = k_i g0^2 / 4 i0, g0 = k_i i0 / k_s."""
    ks, ki = draw.parameters["ks"], draw.parameters["ki"]
    least = max(draw.peaks["all i"] / 0.8, 1.6 * draw.peaks[f"all z{draw.node}"] * ks / ki)
    i0 = least * draw.size(10.0, 1.0)
    g0 = ki * i0 / ks
    K = ki * g0**2 / (4 * i0)

    def law(x: Array, i: Array) -> Array:
        return K * (((i0 - i) / (g0 - x)) ** 2 - ((i0 + i) / (g0 + x)) ** 2) - ks * x + ki * i

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {draw.place[0]: per_axis(law, motion[draw.place[1]], motion["i"])}

    return Fault(
        "magnetic_nonlinearity",
        {"i0": i0, "g0": g0},
        draw.node,
        AMB,
        feedback=feedback,
        reads=(draw.place[1], "i"),
        drives=draw.place[:1],
        corner=1e-15,
    )


@row(ROWS, "magnetic_saturation", "amb", fe=(3,))
def magnetic_saturation(draw: Draw) -> Fault:
    """f = k_s x - k_i i_s tanh(i / i_s) per axis: the field of the control current saturates."""
    ki, limit = draw.parameters["ki"], draw.peaks["i"] * draw.size(30.0, 1.2)

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        lost = per_axis(lambda i, _: ki * (i - limit * np.tanh(i / limit)), motion["i"], motion["i"])
        return {draw.place[0]: lost}

    return Fault(
        "magnetic_saturation",
        {"is": limit},
        draw.node,
        AMB,
        feedback=feedback,
        reads=("i",),
        drives=draw.place[:1],
        corner=1e-15,
    )


@row(ROWS, "eddy_current_lag", "amb", fe=(3,))
def eddy_current_lag(draw: Draw) -> Fault:
    """k_i i [(1 - a) + a / (1 + s tau)]: part of the force comes late; the current is recorded before it."""
    tau, part = draw.lag(1.5e-6, 6e-4), draw.between(0.3, 0.9)

    def alter(plant: Plant, speed: float) -> None:
        plant.path = CurrentPath(1 - part, (-1 / tau,), (part / tau,))

    return Fault("eddy_current_lag", {"tau": tau, "part": part}, draw.node, AMB, alter=alter)


@row(ROWS, "amplifier_bandwidth", "amb", fe=(3,))
def amplifier_bandwidth(draw: Draw) -> Fault:
    """i = i_c / (1 + s / w_a); the force follows i, i_c is recorded: an eddy current lag of the whole force."""
    tau = draw.lag(1e-6, 3e-4)

    def alter(plant: Plant, speed: float) -> None:
        plant.path = CurrentPath(0.0, (-1 / tau,), (1 / tau,))

    places = ("amb", "controller", "amplifier")
    return Fault("amplifier_bandwidth", {"wa": 1 / tau}, draw.node, places, ("eddy_current_lag",), alter=alter)


@row(ROWS, "amb_cross_coupling", "amb", fe=(3,))
def amb_cross_coupling(draw: Draw) -> Fault:
    """k_i (i + eps conj i)."""
    eps, ki = draw.sign() * draw.size(1e-4, 0.12), draw.parameters["ki"]

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {draw.place[0]: -ki * eps * np.conj(motion["i"])}

    return Fault(
        "amb_cross_coupling", {"eps": eps}, draw.node, AMB, feedback=feedback, reads=("i",), drives=draw.place[:1]
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


@row(ROWS, "control_delay", "controller", fe=(3,))
def control_delay(draw: Draw) -> Fault:
    """i = C e^{-s tau} x."""
    tau = draw.lag(6e-7, 3e-4)

    def alter(plant: Plant, speed: float) -> None:
        plant.path = late(tau)

    return Fault("control_delay", {"delay": tau}, draw.node, CONTROLLER, alter=alter)


@row(ROWS, "controller_gain_error", "controller", fe=(3,))
def controller_gain_error(draw: Draw) -> Fault:
    """One gain of the controller is not the stated one."""
    which = int(draw.rng.integers(2)) * 2  # K_P or K_D
    factor = 1 + draw.sign() * draw.size(1e-3, 0.15)

    def alter(plant: Plant, speed: float) -> None:
        gains = list(plant.gains)
        gains[which] *= factor
        plant.gains = (gains[0], gains[1], gains[2])

    name = ("KP", "KI", "KD")[which]
    return Fault("controller_gain_error", {f"{name}_factor": factor}, draw.node, CONTROLLER, alter=alter)


@row(ROWS, "current_clipping", "amb", fe=(3,))
def current_clipping(draw: Draw) -> Fault:
    """i = sat(i_c, +-i_max) per axis; i is recorded and makes the force."""
    ki, limit = draw.parameters["ki"], draw.peaks["i"] * (0.995 - 0.45 * draw.strength)

    def clip(i: Array) -> Array:
        return np.asarray(np.clip(i.real, -limit, limit) + 1j * np.clip(i.imag, -limit, limit))

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {draw.place[0]: ki * (motion["i"] - clip(motion["i"]))}

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        signals["current"] = clip(signals["current"])

    return Fault(
        "current_clipping",
        {"imax": limit},
        draw.node,
        ("controller", "amb", "amplifier"),
        feedback=feedback,
        measure=measure,
        reads=("i",),
        drives=draw.place[:1],
        corner=2e-16,
    )


@row(ROWS, "current_sensor_gain", "current sensor", fe=(3,))
def current_sensor_gain(draw: Draw) -> Fault:
    """i_m = (1 + eps) i; a controller all of whose gains are wrong alike is the same."""
    eps = draw.sign() * draw.size(4e-4, 0.12)

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        signals["current"] = signals["current"] * (1 + eps)

    return Fault(
        "current_sensor_gain", {"eps": eps}, draw.node, CONTROLLER, ("controller_gain_error",), measure=measure
    )


@row(ROWS, "sensor_gain", "sensor", jeffcott=False, fe=EVERY)
def sensor_gain(draw: Draw) -> Fault:
    """x_s = (1 + eps) x at one of several probes."""
    eps = draw.sign() * draw.size(1e-3, 0.12)

    def alter(plant: Plant, speed: float) -> None:
        plant.probes[draw.node] = plant.probes[draw.node] * (1 + eps)

    return Fault("sensor_gain", {"eps": eps}, draw.node, alter=alter)


@row(ROWS, "sensor_gain_mismatch", "sensor", fe=EVERY)
def sensor_gain_mismatch(draw: Draw) -> Fault:
    """x_s = x + eps conj(x), at every order."""
    eps = draw.sign() * draw.size(3e-5, 0.06)
    _, z, v = draw.place
    if draw.node == draw.amb:  # the controller follows it

        def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
            return {"e": eps * np.conj(motion[z]), "edot": eps * np.conj(motion[v])}

        return Fault(
            "sensor_gain_mismatch", {"eps": eps}, draw.node, feedback=feedback, reads=(z, v), drives=("e", "edot")
        )

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        seen = signals[f"p{draw.node}"]
        signals[f"p{draw.node}"] = seen + eps * np.conj(seen)

    return Fault("sensor_gain_mismatch", {"eps": eps}, draw.node, measure=measure)


@row(ROWS, "sensor_rotation", "sensor", fe=EVERY)
def sensor_rotation(draw: Draw) -> Fault:
    """x_s = e^{ia} x."""
    angle = draw.sign() * draw.size(5e-4, 0.1)

    def alter(plant: Plant, speed: float) -> None:
        plant.probes[draw.node] = plant.probes[draw.node] * np.exp(1j * angle)

    return Fault("sensor_rotation", {"angle": angle}, draw.node, alter=alter)


@row(ROWS, "non_collocation", "sensor", jeffcott=False, fe=EVERY)
def non_collocation(draw: Draw) -> Fault:
    """x_s = u + d theta."""
    size = draw.sign() * draw.size(2e-4, 0.025)

    def alter(plant: Plant, speed: float) -> None:
        row_of = plant.probes[draw.node].copy()
        row_of[plant.tilt[draw.node]] += size
        plant.probes[draw.node] = row_of

    return Fault("non_collocation", {"distance": size}, draw.node, alter=alter)


@row(ROWS, "runout", "sensor", fe=EVERY)
def runout(draw: Draw) -> Fault:
    """x_s = x + r_1 e^{i theta} + r_2 e^{2i theta}, in half of the cases also r_3."""
    size = draw.size(1e-9, 2e-6)
    shares = (1.0, draw.between(0.1, 0.5), draw.between(0.1, 0.3) * float(draw.rng.random() < 0.5))
    r = {k + 1: share * size * np.exp(1j * draw.angle()) for k, share in enumerate(shares) if share}
    effect = {f"run{k}": abs(a) for k, a in r.items()} | {f"run{k}_phase": float(np.angle(a)) for k, a in r.items()}

    def seen(clock: Clock) -> tuple[Array, Array]:
        turns = {k: a * np.exp(1j * k * clock.theta) for k, a in r.items()}
        return sum(turns.values()), sum(1j * k * clock.rate * a for k, a in turns.items())

    if draw.node == draw.amb:

        def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
            return dict(zip(("e", "edot"), seen(clock), strict=True))

        return Fault("runout", effect, draw.node, force=force, drives=("e", "edot"))

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        signals[f"p{draw.node}"] = signals[f"p{draw.node}"] + seen(clock)[0]

    return Fault("runout", effect, draw.node, measure=measure)


@row(ROWS, "sensor_offset", "sensor", fe=EVERY)
def sensor_offset(draw: Draw) -> Fault:
    """x_s = x + d; on one node the constant force of a misalignment is the same."""
    size, phase = draw.size(2e-9, 4e-6), draw.angle()
    offset, effect = size * np.exp(1j * phase), {"offset": size, "direction": phase}
    if draw.node == draw.amb:

        def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
            return {"e": offset + 0 * clock.theta, "edot": 0 * clock.theta}

        alias = ("parallel_misalignment",) if draw.machine == "jeffcott" else ()
        return Fault("sensor_offset", effect, draw.node, alias=alias, force=force, drives=("e", "edot"))

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        signals[f"p{draw.node}"] = signals[f"p{draw.node}"] + offset

    return Fault("sensor_offset", effect, draw.node, measure=measure)


@row(ROWS, "quantisation", "converter", fe=(3,))
def quantisation(draw: Draw) -> Fault:
    """round(x / LSB): the converter of the displacements is coarser than stated."""
    size = draw.size(4e-8, 1e-6)
    return Fault("quantisation", {"lsb": size}, None, lsb=size)


@row(ROWS, "base_excitation", "drive", fe=(3,))
def base_excitation(draw: Draw) -> Fault:
    """f = -M r a_b cos(w_b t + phase), of one frequency at every speed, along one direction."""
    size, frequency, direction = draw.size(4e-4, 0.5), draw.between(9.0, 90.0), draw.angle()
    phases = draw.phases

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        return {"base": size * np.exp(1j * direction) * np.cos(2 * np.pi * frequency * clock.t + phases)}

    effect = {"acceleration": size, "frequency": frequency, "direction": direction}
    return Fault("base_excitation", effect, None, force=force, drives=("base",), synchronous=False)


@row(ROWS, "speed_fluctuation", "drive", fe=(3,), alone=True)
def speed_fluctuation(draw: Draw) -> Fault:
    """theta = W t + eps sin(nu t + phase)."""
    size, nu, phases = draw.size(8e-5, 0.05), 2 * np.pi * draw.between(1.5, 18.0), draw.phases

    def wobble(t: Array) -> tuple[Array, Array, Array]:
        a = nu * t + phases
        return size * np.sin(a), size * nu * np.cos(a), -size * nu**2 * np.sin(a)

    effect = {"eps": size, "frequency": nu / (2 * np.pi)}
    return Fault("speed_fluctuation", effect, None, ("clock", "rotor"), wobble=wobble)


@row(ROWS, "torsion_coupling", "drive", fe=(3,), alone=True)
def torsion_coupling(draw: Draw) -> Fault:
    """The disc, with crack and unbalance, turns by phi = phi_0 sin(w_t t + phase) against the tacho.

    theta + phi stands for theta in the crack, and m e ((W + phi')^2 - i phi'') e^{i(theta + phi + beta)} for unbalance.
    """
    size, nu, phases = draw.size(2e-5, 0.05), 2 * np.pi * draw.between(25.0, 140.0), draw.phases

    def twist(t: Array) -> tuple[Array, Array, Array]:
        a = nu * t + phases
        return size * np.sin(a), size * nu * np.cos(a), -size * nu**2 * np.sin(a)

    effect = {"phi": size, "frequency": nu / (2 * np.pi)}
    return Fault("torsion_coupling", effect, None, ("clock", "rotor", "unbalance"), ("speed_fluctuation",), twist=twist)


@row(ROWS, "blade_pass", "excitation", fe=EVERY)
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
    return Fault(physics, effect, draw.node, ("rotor", "amb", "support"), others, alter=alter)


@row(ALIASES, "sensor_gain", "alias", fe=(3,))
def every_sensor_gain(draw: Draw) -> Fault:
    """x_s = (1 + eps) x at every probe: k_i, dk and e grow by 1 + eps."""
    eps = draw.sign() * draw.size(5e-3, 0.15)
    return _alias("sensor_gain", {"eps": eps}, draw, ("probes", eps))


@row(ALIASES, "mass_error", "alias")
def whole_mass_error(draw: Draw) -> Fault:
    """f = -dm q'' on the only mass: everything else scales."""
    size = draw.sign() * draw.size(0.01, 0.3)
    return _alias("mass_error", {"dm": size}, draw, ("mass", size))


@row(ALIASES, "support_stiffness", "alias", fe=(3,))
def stiffness_at_the_bearing(draw: Draw) -> Fault:
    """f = -dk q where k_s q acts."""
    size = draw.size(1e3, 5e4)
    return _alias("support_stiffness", {"dk": size}, draw, ("stiffness", size))


@row(ALIASES, "magnetic_pull", "alias", fe=(3,))
def pull_at_the_bearing(draw: Draw) -> Fault:
    """f = +k_m q where k_s q acts."""
    size = draw.size(1e3, 5e4)
    return _alias("magnetic_pull", {"km": size}, draw, ("stiffness", -size))
