"""Rows of the catalogue that act on shaft, crack, disc and supports. Each states its equation; q = z at the node."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.integrator import Nodes
from benchmarks.concealed.machines import MASS, SAG, SHAFT_STIFFNESS
from benchmarks.concealed.plant import Plant, switching
from benchmarks.concealed.rows.faults import ROWS, Array, Draw, Fault, row
from benchmarks.concealed.simulate import TURN, Clock, base_forces

SLIP = 5e-6  # m/s: below this speed friction is viscous
SURFACE = 8e-3  # m: radius at which the rotor rubs


@row(ROWS, "breathing_crack", "crack", beam="crack")
def breathing_crack(draw: Draw) -> Fault:
    """s = (1 + cos a) / 2 instead of the switching series."""

    def alter(plant: Plant, speed: float) -> None:
        plant.crack.opening = lambda angle: (1 + np.cos(angle)) / 2

    return Fault("breathing_crack", {"breathing": 1.0}, draw.node, ("crack", "rotor"), alter=alter)


@row(ROWS, "open_crack", "crack", beam="crack")
def open_crack(draw: Draw) -> Fault:
    """s = 1."""

    def alter(plant: Plant, speed: float) -> None:
        plant.crack.opening = np.ones_like

    return Fault("open_crack", {"open": 1.0}, draw.node, ("crack", "rotor"), alter=alter)


@row(ROWS, "crack_location", "crack", beam="off crack", jeffcott=False)
def crack_location(draw: Draw) -> Fault:
    """The crack's force at another node."""

    def alter(plant: Plant, speed: float) -> None:
        plant.crack.node = draw.node

    return Fault("crack_location", {"node": float(draw.node)}, draw.node, ("crack", "rotor"), alter=alter)


@row(ROWS, "second_crack", "crack", beam="off crack")
def second_crack(draw: Draw) -> Fault:
    """f = 1/2 s(a) dk_2 sag (1 + e^{2ia}), a = theta + phase_2, beside the first."""
    size, phase, sag = draw.size(60.0, 1.5e5), draw.angle(), draw.plant.crack.sag

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        a = clock.theta + phase
        return {draw.place[0]: 0.5 * switching(a) * size * sag * (1 + np.exp(2j * a))}

    return Fault(
        "second_crack", {"dk": size, "phase": phase}, draw.node, ("crack", "rotor"), force=force, drives=draw.place[:1]
    )


@row(ROWS, "asymmetric_shaft", "shaft")
def asymmetric_shaft(draw: Draw) -> Fault:
    """f = -dk_a e^{2i(theta + phase)} conj(q + sag)."""
    size, phase = draw.size(8.0, 6e4), draw.angle()

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {"f1": -size * np.exp(2j * (nodes.theta + phase)) * np.conj(motion["z1"] + SAG)}

    return Fault(
        "asymmetric_shaft",
        {"dk": size, "phase": phase},
        1,
        feedback=feedback,
        timed=True,
        reads=("z1",),
        drives=("f1",),
    )


@row(ROWS, "residual_bow", "bow", beam="probe")
def residual_bow(draw: Draw) -> Fault:
    """f = k b e^{i(theta + phase)}, k the static stiffness at the node: the shape that a force there would make."""
    size, phase, k = draw.size(1.5e-9, 3e-6), draw.angle(), draw.stiffness

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        return {draw.place[0]: k * size * np.exp(1j * (clock.theta + phase))}

    return Fault("residual_bow", {"bow": size, "bow_phase": phase}, draw.node, force=force, drives=draw.place[:1])


@row(ROWS, "thermal_bow", "bow", beam="probe")
def thermal_bow(draw: Draw) -> Fault:
    """f = k b(t) e^{i theta}, b = b_0 + b_1 (1 - e^{-t / tau}), t from the first sample of each run."""
    size, phase, tau, k = draw.size(5e-9, 3e-6), draw.angle(), draw.between(0.2, 1.5), draw.stiffness
    first = size * draw.between(0.0, 0.5) * np.exp(1j * draw.angle())

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        t = np.maximum(clock.t, 0.0)
        b = first - size * np.expm1(-t / tau) * np.exp(1j * phase)
        return {draw.place[0]: k * b * np.exp(1j * clock.theta)}

    return Fault(
        "thermal_bow",
        {"b0": abs(first), "b0_phase": float(np.angle(first)), "b1": size, "b1_phase": phase, "tau": tau},
        draw.node,
        force=force,
        drives=draw.place[:1],
        synchronous=False,
    )


@row(ROWS, "parallel_misalignment", "coupling", beam="probe")
def parallel_misalignment(draw: Draw) -> Fault:
    """f = F_2 e^{2i theta}, in half of the cases also F_1 e^{i theta} and F_-2 e^{-2i theta}."""
    size = draw.size(6e-4, 2.5)
    shares = {2: 1.0, 1: 0.3, -2: 0.3} if draw.rng.random() < 0.5 else {2: 1.0}
    amplitudes = {k: share * size * np.exp(1j * draw.angle()) for k, share in shares.items()}

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        return {draw.place[0]: sum(F * np.exp(1j * k * clock.theta) for k, F in amplitudes.items())}

    effect = {f"mis{k}": abs(F) for k, F in amplitudes.items()}
    effect |= {f"mis{k}_phase": float(np.angle(F)) for k, F in amplitudes.items()}
    return Fault("parallel_misalignment", effect, draw.node, force=force, drives=draw.place[:1])


@row(ROWS, "angular_misalignment", "coupling", beam="probe", jeffcott=False)
def angular_misalignment(draw: Draw) -> Fault:
    """Moments M_1 e^{i theta} + M_2 e^{2i theta}."""
    size, phases = draw.size(0.002, 0.3), (draw.angle(), draw.angle())
    second = size * draw.between(0.3, 1.0)
    place = f"m{draw.node}"

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        one, two = np.exp(1j * (clock.theta + phases[0])), np.exp(1j * (2 * clock.theta + phases[1]))
        return {place: size * one + second * two}

    effect = {"mom1": size, "mom1_phase": phases[0], "mom2": second, "mom2_phase": phases[1]}
    return Fault("angular_misalignment", effect, draw.node, force=force, drives=(place,))


@row(ROWS, "anisotropic_support", "support", beam="probe")
def anisotropic_support(draw: Draw) -> Fault:
    """f = -dk conj(q) - dc conj(q'), dk = (k_x - k_y) / 2."""
    size, damping = draw.sign() * draw.size(12.0, 6e4), draw.sign() * draw.size(0.02, 8.0)
    damping *= float(draw.rng.random() < 0.5)
    f, z, v = draw.place

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {f: -size * np.conj(motion[z]) - damping * np.conj(motion[v])}

    effect = {"dk": size, "dc": damping}
    return Fault(
        "anisotropic_support", effect, draw.node, ("rotor", "support"), feedback=feedback, reads=(z, v), drives=(f,)
    )


@row(ROWS, "foundation_mode", "support", alone=True)
def foundation_mode(draw: Draw) -> Fault:
    """The shaft stands on m_f y'' + c_f y' + k_f y = k (q - y); the disc feels -k (q - y)."""
    stiffness, frequency = draw.size(8e9, 1.2e7), 2 * np.pi * draw.between(28.0, 78.0)
    mass, ratio = stiffness / frequency**2, draw.between(0.02, 0.06)

    def alter(plant: Plant, speed: float) -> None:
        j = plant.grow()
        plant.mass[j, j] = mass
        plant.damping[j, j] = 2 * ratio * frequency * mass
        plant.stiffness[0, j] = plant.stiffness[j, 0] = -SHAFT_STIFFNESS
        plant.stiffness[j, j] = SHAFT_STIFFNESS + stiffness

    effect = {"stiffness": stiffness, "mass": mass, "damping": 2 * ratio * frequency * mass}
    return Fault("foundation_mode", effect, 1, ("rotor", "support"), alter=alter)


@row(ROWS, "support_stiffness", "support", beam="off bearing", jeffcott=False)
def support_stiffness(draw: Draw) -> Fault:
    """f = -dk q."""
    size = draw.size(300.0, 6e4)

    def alter(plant: Plant, speed: float) -> None:
        dof = plant.displacement[draw.node]
        plant.stiffness[dof, dof] += size

    return Fault("support_stiffness", {"dk": size}, draw.node, ("rotor", "support"), ("magnetic_pull",), alter=alter)


@row(ROWS, "magnetic_pull", "support", beam="off bearing", jeffcott=False)
def magnetic_pull(draw: Draw) -> Fault:
    """f = +k_m q."""
    size = draw.size(300.0, 3e4)

    def alter(plant: Plant, speed: float) -> None:
        dof = plant.displacement[draw.node]
        plant.stiffness[dof, dof] -= size

    return Fault("magnetic_pull", {"km": size}, draw.node, ("rotor", "support"), ("support_stiffness",), alter=alter)


@row(ROWS, "mass_error", "disc", beam="probe", jeffcott=False)
def mass_error(draw: Draw) -> Fault:
    """f = -dm q''."""
    size = draw.size(0.004, 0.4)

    def alter(plant: Plant, speed: float) -> None:
        dof = plant.displacement[draw.node]
        plant.mass[dof, dof] += size
        plant.base[dof] += size

    return Fault("mass_error", {"dm": size}, draw.node, alter=alter)


@row(ROWS, "gyroscopic_error", "disc", beam="disc", jeffcott=False)
def gyroscopic_error(draw: Draw) -> Fault:
    """Moment +i W dG theta' on the tilt of the disc."""
    size = draw.sign() * draw.size(4e-4, 4e-3)

    def alter(plant: Plant, speed: float) -> None:
        dof = plant.tilt[draw.node]
        plant.gyroscopic[dof, dof] += size

    return Fault("gyroscopic_error", {"dG": size}, draw.node, alter=alter)


@row(ROWS, "moment_unbalance", "unbalance", beam="disc", jeffcott=False)
def moment_unbalance(draw: Draw) -> Fault:
    """Moment (I_p - I_d) tau W^2 e^{i(theta + phase)}; the truth holds (I_p - I_d) tau."""
    size, phase = draw.size(2e-8, 5e-6), draw.angle()
    place = f"m{draw.node}"

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        return {place: size * clock.rate**2 * np.exp(1j * (clock.theta + phase))}

    return Fault(
        "moment_unbalance",
        {"moment": size, "phase": phase},
        draw.node,
        ("rotor", *draw.unbalances),
        force=force,
        drives=(place,),
    )


@row(ROWS, "unbalance_elsewhere", "unbalance", beam="off disc", jeffcott=False)
def unbalance_elsewhere(draw: Draw) -> Fault:
    """f = m e W^2 e^{i(theta + phase)} at another node."""
    size, phase = draw.size(2e-7, 4e-5), draw.angle()

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        return {draw.place[0]: size * clock.rate**2 * np.exp(1j * (clock.theta + phase))}

    effect = {"mass_eccentricity": size, "phase": phase}
    return Fault(
        "unbalance_elsewhere", effect, draw.node, ("rotor", *draw.unbalances), force=force, drives=draw.place[:1]
    )


@row(ROWS, "internal_damping", "shaft")
def internal_damping(draw: Draw) -> Fault:
    """f = -c_i (q' - i W q)."""
    size = draw.size(0.8, 15.0)

    def alter(plant: Plant, speed: float) -> None:
        plant.damping[0, 0] += size
        plant.stiffness[0, 0] -= 1j * speed * size

    return Fault("internal_damping", {"ci": size}, 1, alter=alter)


@row(ROWS, "hysteretic_damping", "shaft", alone=True)
def hysteretic_damping(draw: Draw) -> Fault:
    """f = -i eta sgn(k W) K Z_k at each harmonic: the harmonics that solve the settled motion with this force in it."""
    eta = draw.size(3e-4, 0.04)
    order = np.fft.fftfreq(TURN, 1 / TURN)
    found: dict[int, Array] = {}

    def harmonics(clock: Clock, plants: list[Plant]) -> Array:
        if id(plants) not in found:
            speed = clock.speed.reshape(-1, 1)
            turn = 2 * np.pi * np.arange(TURN) / TURN + 0 * speed
            one = Clock(0 * turn, turn, speed + 0 * turn, 0 * turn, speed)
            F = np.fft.fft(base_forces(plants[0], one, None)["f1"], axis=-1) / TURN
            s = 1j * order * speed
            gains = np.array([plant.bearings[0].gains for plant in plants])[:, :, None]
            with np.errstate(divide="ignore", invalid="ignore"):
                C = gains[:, 0] + gains[:, 1] / s + gains[:, 2] * s
                D = MASS * s**2 + draw.parameters["c"] * s + SHAFT_STIFFNESS * (1 + 1j * eta * np.sign(order))
                Z = F / (D - draw.parameters["ks"] + draw.parameters["ki"] * C)
            found[id(plants)] = np.where(order == 0, 0, Z)
        return found[id(plants)]

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        Z = harmonics(clock, plants) * -1j * eta * SHAFT_STIFFNESS * np.sign(order)
        total = np.zeros_like(clock.theta, dtype=complex)
        for k in range(-15, 16):  # the crack's series ends at 11
            total += Z[:, k].reshape(-1, *[1] * (total.ndim - 1)) * np.exp(1j * k * clock.theta)
        return {"f1": total}

    return Fault("hysteretic_damping", {"eta": eta}, 1, force=force)


@row(ROWS, "seal_cross_coupling", "support", beam="probe")
def seal_cross_coupling(draw: Draw) -> Fault:
    """f = +-i k_c q - k_d q - c_d q'."""
    cross, k, c = draw.sign() * draw.size(120.0, 3e4), draw.size(60.0, 1e4), draw.size(0.06, 10.0)

    def alter(plant: Plant, speed: float) -> None:
        dof = plant.displacement[draw.node]
        plant.stiffness[dof, dof] += k - 1j * cross
        plant.damping[dof, dof] += c

    return Fault("seal_cross_coupling", {"kc": cross, "kd": k, "cd": c}, draw.node, alter=alter)


def _contact(draw: Draw, physics: str, friction: float, alias: tuple[str, ...]) -> Fault:
    f, z, v = draw.place
    gap = draw.peaks[z] * (0.99 - 0.42 * draw.strength * draw.between(0.7, 1.0))
    k = draw.size(5e3, 5e5)

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        q, q_dot = motion[z], motion[v]
        radius = np.maximum(np.abs(q), 1e-12)
        slide = nodes.rate * SURFACE + (q.conj() * q_dot).imag / radius
        return {f: -(1 + 1j * friction * np.sign(slide)) * k * np.maximum(radius - gap, 0.0) * q / radius}

    effect = {"gap": gap, "k": k} | ({"mu": friction} if friction else {})
    return Fault(
        physics,
        effect,
        draw.node,
        ("rotor", "support"),
        alias,
        feedback=feedback,
        timed=True,
        reads=(z, v),
        drives=(f,),
        corner=1e-15,
    )


@row(ROWS, "rub", "contact", beam="probe")
def rub(draw: Draw) -> Fault:
    """f = -(1 + i mu sgn v_t) k (rho - c)_+ q / rho, v_t = W R + Im(conj(q) q') / rho."""
    return _contact(draw, "rub", draw.between(0.08, 0.3), ())


@row(ROWS, "clearance", "contact", beam="probe")
def clearance(draw: Draw) -> Fault:
    """f = -k (rho - g)_+ q / rho; a rub without friction is the same."""
    return _contact(draw, "clearance", 0.0, ("rub",))


@row(ROWS, "cubic_stiffness", "support", beam="probe")
def cubic_stiffness(draw: Draw) -> Fault:
    """f = -k3 |q|^2 q; the size is a share of the shaft's stiffness at the largest motion of all runs."""
    f, z, _ = draw.place
    size = draw.size(1e-4, 0.25) * SHAFT_STIFFNESS / draw.peaks[f"all {z}"] ** 2

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        q = motion[z]
        return {f: -size * (q.real**2 + q.imag**2) * q}

    return Fault(
        "cubic_stiffness", {"k3": size}, draw.node, ("rotor", "support"), feedback=feedback, reads=(z,), drives=(f,)
    )


@row(ROWS, "coulomb_friction", "contact", beam="probe")
def coulomb_friction(draw: Draw) -> Fault:
    """f = -F_c q' / sqrt(|q'|^2 + v_0^2): F_c q' / |q'| but for very slow sliding, v_0 = 5 um/s."""
    f, _, v = draw.place
    size = draw.size(6e-4, 0.1)

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        q_dot = motion[v]
        return {f: -size * q_dot / np.sqrt(q_dot.real**2 + q_dot.imag**2 + SLIP**2)}

    return Fault(
        "coulomb_friction",
        {"Fc": size},
        draw.node,
        ("rotor", "support"),
        feedback=feedback,
        reads=(v,),
        drives=(f,),
        corner=1e-13,
    )
