"""Rows of the catalogue in probes, the current's sensor, and converters."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.integrator import Nodes
from benchmarks.concealed.plant import Plant
from benchmarks.concealed.rows.faults import ROWS, Array, Draw, Fault, row
from benchmarks.concealed.simulate import Clock


def followed(draw: Draw) -> tuple[str, ...]:
    """Return the inputs of what the probe at the node adds for the controller that follows it, none if none does."""
    bearing = draw.follower
    return () if bearing is None else (f"e{bearing.mark}", f"edot{bearing.mark}")


@row(ROWS, "current_sensor_gain", "current sensor", beam="bearing")
def current_sensor_gain(draw: Draw) -> Fault:
    """i_m = (1 + eps) i; a controller all of whose gains are wrong alike is the same."""
    eps, bearing = draw.sign() * draw.size(4e-4, 0.12), draw.bearing
    current, blocks = f"current{bearing.mark}", (bearing.controller,)

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        signals[current] = signals[current] * (1 + eps)

    alias = ("controller_gain_error",)
    return Fault("current_sensor_gain", {"eps": eps}, bearing.probe, blocks, alias, measure=measure)


@row(ROWS, "sensor_gain", "sensor", beam="probe", jeffcott=False)
def sensor_gain(draw: Draw) -> Fault:
    """x_s = (1 + eps) x at one of several probes."""
    eps = draw.sign() * draw.size(1e-3, 0.12)

    def alter(plant: Plant, speed: float) -> None:
        plant.probes[draw.node] = plant.probes[draw.node] * (1 + eps)

    return Fault("sensor_gain", {"eps": eps}, draw.node, alter=alter)


@row(ROWS, "sensor_gain_mismatch", "sensor", beam="probe")
def sensor_gain_mismatch(draw: Draw) -> Fault:
    """x_s = x + eps conj(x), at every order."""
    eps = draw.sign() * draw.size(3e-5, 0.06)
    _, z, v = draw.place
    added = followed(draw)
    if added:

        def feedback(nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
            return dict(zip(added, (eps * np.conj(motion[z]), eps * np.conj(motion[v])), strict=True))

        return Fault("sensor_gain_mismatch", {"eps": eps}, draw.node, feedback=feedback, reads=(z, v), drives=added)

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        seen = signals[f"p{draw.node}"]
        signals[f"p{draw.node}"] = seen + eps * np.conj(seen)

    return Fault("sensor_gain_mismatch", {"eps": eps}, draw.node, measure=measure)


@row(ROWS, "sensor_rotation", "sensor", beam="probe")
def sensor_rotation(draw: Draw) -> Fault:
    """x_s = e^{ia} x."""
    angle = draw.sign() * draw.size(5e-4, 0.1)

    def alter(plant: Plant, speed: float) -> None:
        plant.probes[draw.node] = plant.probes[draw.node] * np.exp(1j * angle)

    return Fault("sensor_rotation", {"angle": angle}, draw.node, alter=alter)


@row(ROWS, "non_collocation", "sensor", beam="probe", jeffcott=False)
def non_collocation(draw: Draw) -> Fault:
    """x_s = u + d theta."""
    size = draw.sign() * draw.size(2e-4, 0.025)

    def alter(plant: Plant, speed: float) -> None:
        row_of = plant.probes[draw.node].copy()
        row_of[plant.tilt[draw.node]] += size
        plant.probes[draw.node] = row_of

    return Fault("non_collocation", {"distance": size}, draw.node, alter=alter)


@row(ROWS, "runout", "sensor", beam="probe")
def runout(draw: Draw) -> Fault:
    """x_s = x + r_1 e^{i theta} + r_2 e^{2i theta}, in half of the cases also r_3."""
    size = draw.size(1e-9, 2e-6)
    shares = (1.0, draw.between(0.1, 0.5), draw.between(0.1, 0.3) * float(draw.rng.random() < 0.5))
    r = {k + 1: share * size * np.exp(1j * draw.angle()) for k, share in enumerate(shares) if share}
    effect = {f"run{k}": abs(a) for k, a in r.items()} | {f"run{k}_phase": float(np.angle(a)) for k, a in r.items()}

    def seen(clock: Clock) -> tuple[Array, Array]:
        turns = {k: a * np.exp(1j * k * clock.theta) for k, a in r.items()}
        return sum(turns.values()), sum(1j * k * clock.rate * a for k, a in turns.items())

    added = followed(draw)
    if added:

        def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
            return dict(zip(added, seen(clock), strict=True))

        return Fault("runout", effect, draw.node, force=force, drives=added)

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        signals[f"p{draw.node}"] = signals[f"p{draw.node}"] + seen(clock)[0]

    return Fault("runout", effect, draw.node, measure=measure)


@row(ROWS, "sensor_offset", "sensor", beam="probe")
def sensor_offset(draw: Draw) -> Fault:
    """x_s = x + d; on one node the constant force of a misalignment is the same."""
    size, phase = draw.size(2e-9, 4e-6), draw.angle()
    offset, effect = size * np.exp(1j * phase), {"offset": size, "direction": phase}
    added = followed(draw)
    if added:

        def force(clock: Clock, plants: list[Plant]) -> dict[str, Array]:
            return dict(zip(added, (offset + 0 * clock.theta, 0 * clock.theta), strict=True))

        alias = ("parallel_misalignment",) if draw.machine == "jeffcott" else ()
        return Fault("sensor_offset", effect, draw.node, alias=alias, force=force, drives=added)

    def measure(clock: Clock, signals: dict[str, Array]) -> None:
        signals[f"p{draw.node}"] = signals[f"p{draw.node}"] + offset

    return Fault("sensor_offset", effect, draw.node, measure=measure)


@row(ROWS, "quantisation", "converter", beam="machine")
def quantisation(draw: Draw) -> Fault:
    """round(x / LSB): the converter of the displacements is coarser than stated."""
    size = draw.size(4e-8, 1e-6)
    return Fault("quantisation", {"lsb": size}, None, lsb=size)
