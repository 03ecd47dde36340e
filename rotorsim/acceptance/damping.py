"""API 617: logarithmic decrement of the damped modes, also with an anticipated cross coupling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rotorsim.acceptance.conditions import Conditions, campbell_of
from rotorsim.acceptance.criterion import API_617, API_684, MET, Criterion, Part, judged
from rotorsim.acceptance.limits import HIGHEST_MODE
from rotorsim.errors import RotorsimError
from rotorsim.linear.linearisation import as_model, flat_names, linearise, speed_of
from rotorsim.linear.modes.campbell import Campbell
from rotorsim.linear.modes.eigenmodes import RESONANT, modes
from rotorsim.linear.modes.unbalance_response import plane_entries
from rotorsim.linear.stability import growing
from rotorsim.linear.state_space import StateSpace
from rotorsim.model.compiled import Model

DAMPING_TITLE = "Damping of the modes"
LEVEL_1, STABILITY = f"{API_617}, 4.8.5 (level I)", f"{API_684}, 3"
COUPLINGS = 40  # between 0.001 and 1000 times the anticipated one, at which stability is looked at
LEAST_DECREMENT = 0.1  # of the first forward mode, API 617 level I
LEAST_RATIO = 2.0  # of the cross coupling at the limit of stability to that which is anticipated, API 617 level I
WEAKLY_DAMPED = 0.2  # damping ratio below which 2X may bring a mode to resonance: AF 2.5
FIRST_PAIR = 1.05  # of the first frequency, up to which modes of two planes are one: the less damped one counts
MOST_COUPLING = 1e3  # times the anticipated one, up to which the limit of stability is looked for


@dataclass(frozen=True)
class DampedMode:
    """frequency [Hz], damped; decrement: 2 pi z / sqrt(1 - z^2), negative where it grows."""

    frequency: float
    decrement: float
    whirl: str


@dataclass(frozen=True)
class DampedModes:
    """Modes that force may bring to resonance, ascending."""

    modes: tuple[DampedMode, ...]


def decrement_of(pole: complex) -> float:
    """Return the logarithmic decrement -2 pi Re(s) / Im(s) of a pole s [1/s]."""
    return float(-2 * np.pi * pole.real / abs(pole.imag))


def damped_modes(model: Model, given: Conditions) -> Part:
    """Return the logarithmic decrement of the modes of the closed loop, at the largest operating speed."""
    return judged(DAMPING_TITLE, LEVEL_1, "log decrement", lambda: _damped(model, given))


def _damped(model: Model, given: Conditions) -> Part:
    speed = given.highest if np.isfinite(given.highest) else None
    turning = {} if speed is None or speed_of(model, model.p0) is None else {"speed": speed}
    at = f" at {speed * 30 / np.pi:.5g} rpm" if turning and speed is not None else ""
    every, notes, stable = _modes(model, turning)
    found = tuple(mode for mode in every if mode.frequency <= HIGHEST_MODE)
    made = [_stable(stable, at)]
    low = [mode for mode in every if mode.whirl != "backward"]  # the first one may be above
    if low:
        alike = [mode for mode in low if mode.frequency <= FIRST_PAIR * low[0].frequency]
        first = min(alike, key=lambda mode: mode.decrement)
        words = f"first {first.whirl} mode, {first.frequency:.4g} Hz{at}"
        made.append(Criterion(LEVEL_1, "log decrement", words, first.decrement, LEAST_DECREMENT, at_most=False))
    else:
        said, stated = "no mode is brought to resonance", MET if stable else ""
        made.append(Criterion(LEVEL_1, "log decrement", f"forward modes{at}", said=said, stated=stated))
    weak = [mode for mode in found if mode.decrement < LEAST_DECREMENT and mode is not (first if low else None)]
    for mode in weak:
        words = f"{mode.whirl} mode, {mode.frequency:.4g} Hz{at}"
        made.append(
            Criterion(LEVEL_1, "log decrement", words, mode.decrement, LEAST_DECREMENT, at_most=False, required=False)
        )
    results: list[object] = [DampedModes(found)]
    if turning:
        map_of = campbell_of(model, given)
        results.append(map_of)
        made.append(_over_speed(map_of, given))
        notes += _twice(map_of, given)
    if given.cross_coupling:
        made += _coupled(model, turning, given.cross_coupling, at)
    return Part(DAMPING_TITLE, tuple(made), tuple(notes), tuple(results))


def _stable(stable: bool, at: str) -> Criterion:
    said = "stable" if stable else "unstable"
    return Criterion(STABILITY, "poles that grow", f"closed loop{at}", float(not stable), 0.0, said=said)


def _over_speed(result: Campbell, given: Conditions) -> Criterion:
    """Judge whether a pole grows at any speed up to the trip speed."""
    below = result.speeds <= given.trip * (1 + 1e-9)
    ill = result.speeds[below & ~result.stable] * 30 / np.pi
    said = f"unstable at {', '.join(f'{speed:.5g}' for speed in ill[:5])} rpm" if len(ill) else "stable"
    where = f"0 to {given.trip * 30 / np.pi:.5g} rpm, {int(below.sum())} speeds"
    return Criterion(STABILITY, "poles that grow", where, float(len(ill)), 0.0, said=said)


def _twice(result: Campbell, given: Conditions) -> list[str]:
    """Return where 2X meets a mode within the operating speeds."""
    return [
        f"2X meets a {one.whirl} mode of {one.frequency_hz:.4g} Hz{one.modulo_text}, log decrement "
        f"{2 * np.pi * one.damping_ratio / np.sqrt(1 - one.damping_ratio**2):.3g}, at {one.speed * 30 / np.pi:.5g} rpm"
        for one in result.crossings
        if one.order == 2 and given.lowest <= one.speed <= given.highest and one.damping_ratio < WEAKLY_DAMPED
    ]


def _modes(model: Model, turning: dict[str, float]) -> tuple[tuple[DampedMode, ...], list[str], bool]:
    """Return the modes, ascending, that force may bring to resonance; notes; whether no pole grows."""
    found = modes(model, parameters=turning)
    listed = [
        DampedMode(mode.frequency_hz, decrement_of(mode.eigenvalue), mode.whirl)
        for mode in found.modes
        if mode.resonant
    ]
    return tuple(listed), list(found.notes), found.stable


def _coupled(model: Model, turning: dict[str, float], couplings: Mapping[str, float], at: str) -> list[Criterion]:
    """Judge the damping with cross-coupled stiffnesses Q, all at once: f = Q (-y, x), which drives forward whirl."""
    where = f"Q = {', '.join(f'{value:.4g} N/m at {plane}' for plane, value in couplings.items())}{at}"
    try:
        opened = {plane: _open_plane(model, turning, plane) for plane in couplings}
    except RotorsimError as error:
        return [Criterion(LEVEL_1, "log decrement", where, said=error.problems[0].what)]
    turned = np.array([[0.0, -1.0], [1.0, 0.0]])
    across = sum(value * (opened[plane][0].B @ turned @ opened[plane][1]) for plane, value in couplings.items())
    system, rows = next(iter(opened.values()))
    first = _first_forward(system.A + across, rows)
    if first is None:
        return [Criterion(LEVEL_1, "log decrement", where, said="no forward mode")]
    decrement = decrement_of(first)
    words = f"first forward mode, {abs(first.imag) / (2 * np.pi):.4g} Hz, {where}"
    made = [Criterion(LEVEL_1, "log decrement", words, decrement, LEAST_DECREMENT, at_most=False)]

    def is_stable(ratio: float) -> bool:
        return not growing(system.A + ratio * across)

    low, high = 0.0, MOST_COUPLING
    if is_stable(high):
        low, said = high, f"stable beyond {MOST_COUPLING:g} times"
    else:
        grid = np.concatenate([[0.0], np.geomspace(1e-3, MOST_COUPLING, COUPLINGS)])
        outside = next((k for k, ratio in enumerate(grid) if not is_stable(float(ratio))), len(grid) - 1)
        low, high = (float(grid[outside - 1]), float(grid[outside])) if outside else (0.0, 0.0)
        while high - low > 1e-6 * high:
            middle = (low + high) / 2
            low, high = (middle, high) if is_stable(middle) else (low, middle)
        said = f"stable up to {low:.4g} times these"
    return [*made, Criterion(LEVEL_1, "Q_0 / Q_A", where, low, LEAST_RATIO, at_most=False, said=said)]


def _first_forward(A: np.ndarray, rows: np.ndarray) -> complex | None:
    """Return the pole of the lowest mode that whirls forward at a plane and may resonate; None without one."""
    values, vectors = np.linalg.eig(A)
    motion = rows @ vectors
    forward = np.abs(motion[0] + 1j * motion[1]) >= np.abs(motion[0] - 1j * motion[1]) * (1 - 1e-6)
    there = (values.imag > 0) & (-values.real < RESONANT * np.abs(values)) & forward
    return complex(values[there][np.argmin(values[there].imag)]) if there.any() else None


def _open_plane(model: Model, turning: dict[str, float], plane: str) -> tuple[StateSpace, np.ndarray]:
    """Return the closed loop from a force in a plane, and the rows of the displacement there (2, n)."""
    port, entries = plane_entries(model.diagram, plane)
    declared = model.diagram.nodes[port.rpartition(".")[0]].inputs[port.rpartition(".")[2]]
    seen = declared.declaration.conjugate or "displacement"  # type: ignore[union-attr]
    opened = as_model(model, (port,))
    name = f"{port.rpartition('.')[0]}.{seen}{plane[len(port) :]}"
    system = linearise(opened, parameters=turning, inputs=(port,), outputs=(name,))
    columns = [system.inputs.index(entry) for entry in entries]
    assert len(flat_names(opened, name)) == len(columns)
    return StateSpace(system.A, system.B[:, columns], system.C, system.D[:, columns]), system.C
