"""Laws that are in no row of the catalogue."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.integrator import Nodes
from benchmarks.concealed.machines import SHAFT_STIFFNESS
from benchmarks.concealed.plant import Plant
from benchmarks.concealed.rows.faults import OUTSIDE, Array, Draw, Fault, row
from benchmarks.concealed.simulate import Clock

NAME = "outside_catalogue"


@row(OUTSIDE, "dahl", "outside", beam="probe")
def dahl(draw: Draw) -> Fault:
    """f = -a w, w' = q' - |q'| w / b: friction with memory, isotropic."""
    f, _, v = draw.place
    b = draw.peaks[f"z{draw.node}"] * draw.between(0.15, 0.5)
    a = draw.size(6e-4, 0.3) / b

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        w, q_dot = motion["aux0"], motion[v]
        return {f: -a * w, "aux0": q_dot - np.abs(q_dot) * w / b}

    return Fault(
        NAME,
        {"a": a, "b": b},
        draw.node,
        law="dahl",
        feedback=feedback,
        reads=(v, "aux0"),
        drives=(f, "aux0"),
        integrators=1,
        corner=1e-13,
    )


@row(OUTSIDE, "bouc_wen", "outside", beam="probe")
def bouc_wen(draw: Draw) -> Fault:
    """f = -a w, w' = q' (1 - |w / b|^2 (1 + sgn(q' w)) / 2) per axis."""
    f, _, v = draw.place
    b = draw.peaks[f"z{draw.node}"] * draw.between(0.15, 0.5)
    a = draw.size(6e-4, 0.3) / b

    def rate(w: Array, u: Array) -> Array:
        return np.asarray(u * (1 - (w / b) ** 2 * (1 + np.sign(u * w)) / 2))

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        w, u = motion["aux0"], motion[v]
        return {f: -a * w, "aux0": rate(w.real, u.real) + 1j * rate(w.imag, u.imag)}

    return Fault(
        NAME,
        {"a": a, "b": b},
        draw.node,
        law="bouc_wen",
        feedback=feedback,
        reads=(v, "aux0"),
        drives=(f, "aux0"),
        integrators=1,
        corner=3e-15,
    )


@row(OUTSIDE, "quadratic_drag", "outside", beam="probe")
def quadratic_drag(draw: Draw) -> Fault:
    """f = -c2 |q'| q'."""
    f, z, v = draw.place
    size = draw.size(0.05, 90.0) / (300.0 * draw.peaks[z])

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {f: -size * np.abs(motion[v]) * motion[v]}

    return Fault(
        NAME, {"c2": size}, draw.node, law="quadratic_drag", feedback=feedback, reads=(v,), drives=(f,), corner=1e-14
    )


@row(OUTSIDE, "fractional_stiffness", "outside", beam="probe")
def fractional_stiffness(draw: Draw) -> Fault:
    """f = -k_p |q|^(p - 1) q, p = 1.4 ... 1.7."""
    f, z, _ = draw.place
    power = draw.between(1.4, 1.7)
    size = draw.size(1e-4, 0.2) * SHAFT_STIFFNESS / draw.peaks[f"all {z}"] ** (power - 1)

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {f: -size * np.abs(motion[z]) ** (power - 1) * motion[z]}

    effect = {"kp": size, "power": power}
    return Fault(
        NAME, effect, draw.node, law="fractional_stiffness", feedback=feedback, reads=(z,), drives=(f,), corner=1e-14
    )


@row(OUTSIDE, "hertz_contact", "outside", beam="probe")
def hertz_contact(draw: Draw) -> Fault:
    """f = -k_h (rho - g)_+^(3/2) q / rho."""
    f, z, _ = draw.place
    gap = draw.peaks[z] * (0.97 - 0.5 * draw.strength)
    size = draw.size(5e3, 5e5) / np.sqrt(draw.peaks[z] - gap)

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        radius = np.maximum(np.abs(motion[z]), 1e-12)
        return {f: -size * np.maximum(radius - gap, 0.0) ** 1.5 * motion[z] / radius}

    effect = {"gap": gap, "kh": float(size)}
    return Fault(NAME, effect, draw.node, law="hertz_contact", feedback=feedback, reads=(z,), drives=(f,), corner=1e-16)


@row(OUTSIDE, "pulse", "outside", beam="probe")
def pulse(draw: Draw) -> Fault:
    """f = F e^{20 (cos(theta - theta_p) - 1)} e^{i direction}: one knock a turn, in a direction of the stator."""
    size, angle, direction = draw.size(1e-3, 3.0), draw.angle(), draw.angle()

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        return {draw.place[0]: size * np.exp(20 * (np.cos(clock.theta - angle) - 1) + 1j * direction)}

    effect = {"force": size, "angle": angle, "direction": direction}
    return Fault(NAME, effect, draw.node, law="pulse", force=force, drives=draw.place[:1])


@row(OUTSIDE, "delayed_feedback", "outside", beam="probe")
def delayed_feedback(draw: Draw) -> Fault:
    """f = -k_d q(t - tau), tau a whole number of integration steps of 0.8 ms."""
    f, z, _ = draw.place
    size, delay = draw.sign() * draw.size(60.0, 2.5e4), 0.8e-3 * int(draw.rng.integers(2, 11))

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {f: -size * motion[f"late {z}"]} if f"late {z}" in motion else {}

    effect = {"kd": size, "tau": delay}
    return Fault(
        NAME, effect, draw.node, law="delayed_feedback", feedback=feedback, reads=(z,), drives=(f,), late=delay
    )


@row(OUTSIDE, "parametric_stiffness", "outside", beam="probe")
def parametric_stiffness(draw: Draw) -> Fault:
    """f = -k_p cos(3 theta + phase) q."""
    f, z, _ = draw.place
    size, phase = draw.size(60.0, 6e4), draw.angle()

    def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        return {f: -size * np.cos(3 * nodes.theta + phase) * motion[z]}

    effect = {"kp": size, "phase": phase}
    return Fault(
        NAME, effect, draw.node, law="parametric_stiffness", feedback=feedback, timed=True, reads=(z,), drives=(f,)
    )


@row(OUTSIDE, "whirl_force", "outside", beam="probe")
def whirl_force(draw: Draw) -> Fault:
    """f = F e^{i(n theta + phase)}, n = 0.42 ... 0.48: follows the speed, but not as a harmonic."""
    size, order, phases = draw.size(8e-4, 0.8), draw.between(0.42, 0.48), draw.phases

    def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
        return {draw.place[0]: size * np.exp(1j * (order * clock.theta + phases))}

    effect = {"force": size, "order": order}
    return Fault(NAME, effect, draw.node, law="whirl_force", force=force, drives=draw.place[:1], synchronous=False)
