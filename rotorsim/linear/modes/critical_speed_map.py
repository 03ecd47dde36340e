"""Undamped critical speeds over the stiffness of the supports (critical speed map)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import eig
from scipy.optimize import brentq

from rotorsim._shown import Shown
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import as_model, entry_names, linearise, provenance
from rotorsim.linear.modes.free_rotor import FreeRotor, free_rotor, real_basis
from rotorsim.linear.state_space import StateSpace
from rotorsim.model.compiled import Model

DEFAULT_STIFFNESS = np.geomspace(1e4, 1e10, 73)  # N/m, 12 a decade: from a soft magnetic bearing to a rigid pedestal
MOST_DOF = 60  # in both planes, beyond which the modes of the softest and of the stiffest supports span the motion
SPANNING = 24  # modes of each
LEAST_SPEED = 0.1  # rad/s, about 1 rpm: below, a body that nothing holds is free but for rounding
REAL_ROOT = 1e-6  # of |W^2|: imaginary part below which a root is a speed
EQUAL_SPEEDS = 1e-5  # relative distance of equal critical speeds: of two planes that no gyroscopic moment tells apart
MOVING = ("rotor", "casing", "bearing")  # categories of blocks that may move
GRID = np.geomspace(0.1, 1e4, 501)  # Hz, at which the stiffness of a bearing is shown


@dataclass(frozen=True, repr=False)
class CriticalSpeedMap(Shown):
    """Critical speeds [rad/s] (n, m), ascending, over the stiffness [N/m] (n,) of each bearing; NaN: no more there.

    bearings: name -> (frequencies [Hz] (j,), dynamic stiffness [N/m] (j,), complex): force over minus the displacement
    that the bearing and its controller see, in x, where the rotor is moved as a whole. crossings: (bearing, stiffness
    [N/m], speed [rad/s]) where all bearings have the stiffness that this one has at the frequency of the speed.
    """

    stiffness: np.ndarray
    speeds: np.ndarray
    bearings: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    crossings: tuple[tuple[str, float, float], ...] = ()
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.acceptance:critical_speed_map_figure"

    def __repr__(self) -> str:
        ends = f"{self.stiffness[0]:.3g}..{self.stiffness[-1]:.3g} N/m"
        return f"CriticalSpeedMap({self.provenance.get('diagram', '')}: {self.speeds.shape[1]} speeds, {ends})"


def critical_speed_map(
    diagram: Diagram | Model,
    *,
    stiffness: Sequence[float] | np.ndarray = DEFAULT_STIFFNESS,
    parameters: Mapping[str, Any] | None = None,
    highest: float = np.inf,
    count: int = 8,
) -> CriticalSpeedMap:
    """Return the undamped critical speeds of forward whirl over the stiffness [N/m] of the supports.

    Every bearing is a spring k in both axes. With q = Re v exp(i W t), q'' = W G q' - S q becomes

        S(k) v = W^2 (I + i G) v,

    whose real roots W > 0 are the critical speeds; those of backward whirl, which unbalance does not excite, are left
    out. highest [rad/s]: of all that are kept; count: at most so many.

    Raises RotorsimError as `free_rotor`, and for stiffnesses that are not positive and ascending.
    Source: API RP 684 (2005), 2.4; Vance, Zeidan & Murphy, Machinery Vibration and Rotordynamics (2010), ch. 5.
    """
    values = np.atleast_1d(np.asarray(stiffness, float)).ravel()
    if not (len(values) and np.isfinite(values).all() and (values > 0).all() and (np.diff(values) > 0).all()):
        raise RotorsimError(Problem("stiffnesses must be positive and ascending [N/m]", "stiffness"))
    rotor = free_rotor(diagram, parameters=parameters)
    springs = rotor.springs
    stiff, turning, left, right = rotor.S, np.eye(len(rotor.S)) + 1j * rotor.G, None, None
    if len(stiff) > MOST_DOF:
        left, right = _spanning(rotor, values[[0, -1]])
        stiff, turning, springs = (left.T @ matrix @ right for matrix in (stiff, turning, springs))
    pairs = rotor.C if right is None else rotor.C @ right

    def forward(k: float) -> np.ndarray:
        return _forward(stiff + k * springs, turning, pairs, highest)[:count]

    found = [forward(k) for k in values]
    most = max(map(len, found))
    speeds = np.full((len(values), most), np.nan)
    for row, one in zip(speeds, found, strict=True):
        row[: len(one)] = one
    own, notes = bearing_stiffness(diagram, rotor, parameters)
    return CriticalSpeedMap(
        stiffness=values,
        speeds=speeds,
        bearings={name: (GRID, of(GRID)) for name, of in own.items()},
        crossings=tuple(_crossings(values, speeds, forward, own)),
        notes=notes,
        provenance=provenance(as_model(diagram), parameters, "critical_speed_map"),
    )


Stiffness = Callable[[Any], np.ndarray]  # frequencies [Hz] (n,) -> dynamic stiffness [N/m] (n,), complex


def _crossings(
    stiffness: np.ndarray, speeds: np.ndarray, forward: Callable[[float], np.ndarray], own: Mapping[str, Stiffness]
) -> Iterator[tuple[str, float, float]]:
    """Yield where the real part of a bearing's stiffness, at the frequency of a critical speed, is that of its map."""
    log_k = np.log(stiffness)

    def excess(hz: Any, of: Stiffness) -> np.ndarray:
        real = of(np.where(np.isfinite(hz), hz, 1.0)).real
        return np.asarray(np.log(np.where((real > 0) & np.isfinite(hz), real, np.nan)))

    for name, of in own.items():
        for m in range(speeds.shape[1]):
            away = excess(speeds[:, m] / (2 * np.pi), of) - log_k
            for j in np.flatnonzero(np.sign(away[:-1]) * np.sign(away[1:]) < 0):

                def at(log: float, m: int = m, of: Stiffness = of) -> float:
                    found = forward(float(np.exp(log)))
                    return float(excess(found[[m]] / (2 * np.pi), of)[0] - log) if m < len(found) else np.nan

                try:
                    root = float(brentq(at, log_k[j], log_k[j + 1], rtol=1e-12))
                except ValueError:  # a branch ends between the two
                    continue
                if abs(at(root)) < 1e-6:  # and not a change of sign through a pole of the stiffness
                    k = float(np.exp(root))
                    yield name, k, float(forward(k)[m])


def _forward(stiff: np.ndarray, turning: np.ndarray, pairs: np.ndarray, highest: float) -> np.ndarray:
    """Return the critical speeds of forward whirl, ascending; of two that are equal, one in each plane, one."""
    squared, vectors = np.linalg.eig(np.linalg.solve(turning, stiff))  # which is balanced, as a pair is not
    real = (squared.real > LEAST_SPEED**2) & (np.abs(squared.imag) <= REAL_ROOT * np.abs(squared))
    order = np.flatnonzero(real)[np.argsort(squared.real[real])]
    speeds, motion = np.sqrt(squared.real[order]), pairs @ vectors[:, order]
    kept: list[float] = []
    j = 0
    while j < len(speeds):
        same = [j]
        while same[-1] + 1 < len(speeds) and speeds[same[-1] + 1] - speeds[j] <= EQUAL_SPEEDS * speeds[j]:
            same.append(same[-1] + 1)
        shape = motion[:, same]
        forward, backward = (np.linalg.norm(shape[0::2] + sign * shape[1::2]) for sign in (1j, -1j))
        if (len(same) > 1 or forward >= backward) and speeds[j] <= highest:
            kept.append(float(speeds[j]))
        j = same[-1] + 1
    return np.array(kept)


def _spanning(rotor: FreeRotor, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return left and right vectors (n, j) of the lowest modes on the softest and on the stiffest supports.

    Left vectors of M^-1 K are M times the right ones: the projection is Galerkin's, with M and K symmetric.
    """
    sides: list[list[np.ndarray]] = [[], []]
    for k in ends:
        values, left, right = eig(rotor.S + k * rotor.springs, left=True)
        lowest = np.argsort(np.abs(values))[:SPANNING]
        sides[0].append(real_basis(left[:, lowest]))
        sides[1].append(real_basis(right[:, lowest]))
    left, right = (np.column_stack(side) for side in sides)
    independent = np.linalg.svd(left.T @ right)
    keep = independent[1] > 1e-10 * independent[1][0]
    return left @ independent[0][:, keep], right @ independent[2][keep].T


def bearing_stiffness(
    diagram: Diagram | Model, rotor: FreeRotor, parameters: Mapping[str, Any] | None = None
) -> tuple[dict[str, Stiffness], tuple[str, ...]]:
    """Return the dynamic stiffness of every bearing in x, K = -F / u, with the rotor moved as a whole; and notes.

    Its controller's probes move as its magnets do: displacements by u, velocities by i w u. Casings stand still.
    """
    drawn = diagram.diagram if isinstance(diagram, Model) else diagram
    moved = [
        f"{name}.{port}"
        for name, node in drawn.nodes.items()
        for port, one in node.outputs.items()
        if node.block.category in MOVING and one.unit in ("m", "m/s") and one.shape[-1:] == (2,)
    ]
    model = as_model(drawn, (), tuple(moved))
    if model.n_z:
        return {}, ("the stiffness of bearings with sampled controllers is not drawn over the critical speed map",)
    at = None if model.linear else model.x0(model.parameter_vector(parameters))
    forces = [bearing.force for bearing in rotor.bearings]
    system = linearise(model, parameters=parameters, inputs=moved, outputs=forces, at=at, open_loop=True)
    rates = np.array([unit == "m/s" for unit in system.input_units])
    turning = [drawn.nodes[name.partition(".")[0]].block.category == "rotor" for name in system.inputs]
    along_x = np.array(turning) & [name.endswith(("[1]", ",1]")) for name in system.inputs]

    def of(row: int) -> Stiffness:
        one = StateSpace(system.A, system.B, system.C[[row]], system.D[[row]]).connected()

        def stiffness(hz: np.ndarray) -> np.ndarray:
            moving = np.where(rates, 2j * np.pi * hz[:, None], 1.0) * along_x
            return np.asarray(-(one.response(hz)[:, 0] * moving).sum(axis=1))

        return stiffness

    rows = [system.outputs.index(entry_names(bearing.force, (2,))[0]) for bearing in rotor.bearings]
    return {bearing.name: of(row) for bearing, row in zip(rotor.bearings, rows, strict=True)}, ()
