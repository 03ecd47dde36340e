"""API 617: response to unbalance - critical speeds, separation margins, vibration at the probes, running clearances.

The unbalance of an analysis is U_a = 2 U_r, U_r = 6350 W / N [g mm], W: mass of the rotor [kg], N: maximum continuous
speed [rpm]. The standard distributes it as the mode shapes are; here all of it stands in one plane after the other. At
any place the response to any distribution of it, in phase or opposed, is at most the largest of these, since the
response is linear and the parts add up to U_a.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.acceptance.conditions import Conditions
from rotorsim.acceptance.criterion import API_684, MET, NOT_MET, Criterion, Part, judged, not_judged
from rotorsim.acceptance.limits import ANALYSED, residual_unbalance, vibration_limit
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.free_rotor import free_rotor, mass_of
from rotorsim.linear.loop import linear_system
from rotorsim.linear.unbalance_response import UnbalanceResponse, plane_entries, unbalance_response
from rotorsim.model.compiled import Model
from rotorsim.signals.orders.resonance import RESPONSIVE, Margin, Peak, peak_in, separation_margin

UNBALANCE_TITLE = "Response to unbalance"
VIBRATION, SEPARATION, CLEARANCE = (f"{API_684}, SP6.8.2.{n}" for n in (8, 10, 12))
LOWEST_SHARE, HIGHEST_SHARE = 0.02, 1.5  # of the trip speed, between which the response is computed
SPEED_POINTS = 121  # speeds over all
AROUND_A_POLE = np.linspace(-3, 3, 13)  # half widths: speeds at every pole, and again at every maximum found
POLE_SPEEDS = 5  # at which the poles are looked at
LARGEST_SCALE = 6.0  # S_cc at most
CLEARANCE_SHARE = 0.75  # of the diametral clearance, that the scaled response may use


@dataclass(frozen=True)
class CriticalSpeedOfPlane:
    """A maximum of the response to unbalance in a plane, at the probe with the largest amplification factor there."""

    plane: str
    probe: str
    peak: Peak
    margin: Margin


@dataclass(frozen=True, eq=False)
class UnbalanceCases:
    """All of the unbalance [kg m] in one plane after the other; size (n, places, planes) [m]: 0-peak, major axis.

    places: of ``response.signals``; the first ``probes`` are probes. limit: A_vl [m], peak to peak. scale (planes,):
    S_cc. clearance (places,) [m], radial; NaN: none given. operating, trip [rad/s]. critical: maxima of all planes.
    """

    response: UnbalanceResponse
    size: np.ndarray
    probes: int
    limit: float
    scale: np.ndarray
    clearance: np.ndarray
    operating: tuple[float, float]
    trip: float
    critical: tuple[CriticalSpeedOfPlane, ...]
    mass: float
    unbalance: float


def unbalance_cases(model: Model, given: Conditions) -> Part:
    """Return the response of probes and running clearances to the unbalance of API 617, plane by plane."""
    what = "response to unbalance"
    if not np.isfinite(given.highest):
        return not_judged(UNBALANCE_TITLE, VIBRATION, what, "no operating speed is given: --operating")
    if not given.planes:
        return not_judged(
            UNBALANCE_TITLE, VIBRATION, what, "no plane of unbalance: --unbalance, such as rotor.force[4]"
        )
    if not given.probes:
        return not_judged(UNBALANCE_TITLE, VIBRATION, what, "no controller sees two axes of a displacement")
    return judged(UNBALANCE_TITLE, VIBRATION, what, lambda: _judged(_cases(model, given), given))


def _cases(model: Model, given: Conditions) -> UnbalanceCases:
    mass = rotor_mass(model, given.planes[0]) if given.mass is None else given.mass
    amount = ANALYSED * residual_unbalance(mass, given.highest)
    places = [*given.probes, *(place for place in given.clearance if place not in given.probes)]
    ends = LOWEST_SHARE * given.trip, HIGHEST_SHARE * given.trip
    speeds = _speeds(model, ends, given)
    response = unbalance_response(model, given.planes, places, speeds=speeds)
    near = _near_maxima(speeds, _sizes(response, amount), ends)
    more = unbalance_response(model, given.planes, places, speeds=near) if len(near) else None
    if more is not None:
        response = _merged(response, more)
    size, count = _sizes(response, amount), len(given.probes)
    within = _within(response.speeds, given)
    limit = vibration_limit(given.highest)
    with np.errstate(divide="ignore"):
        scale = np.minimum(limit / (2 * size[within][:, :count].max(axis=(0, 1))), LARGEST_SCALE)
    return UnbalanceCases(
        response=response,
        size=size,
        probes=count,
        limit=limit,
        scale=scale,
        clearance=np.array([given.clearance.get(place, np.nan) for place in places]),
        operating=(given.lowest, given.highest),
        trip=given.trip,
        critical=tuple(_critical(response, size[:, :count], given)),
        mass=mass,
        unbalance=amount,
    )


def _within(speeds: np.ndarray, given: Conditions) -> np.ndarray:
    """Return which speeds are operating speeds, the ends among them."""
    return np.asarray((speeds >= given.lowest * (1 - 1e-9)) & (speeds <= given.highest * (1 + 1e-9)))


def _sizes(response: UnbalanceResponse, amount: float) -> np.ndarray:
    """Return the major axis (n, places, planes) [m], 0-peak, of all the unbalance in each plane."""
    each = np.eye(len(response.planes)) * amount
    return np.stack([response.major_axis(one) for one in each], axis=-1)


def _speeds(model: Model, ends: tuple[float, float], given: Conditions) -> np.ndarray:
    """Return speeds between two, those of operation, and others dense at every pole."""
    found = [np.linspace(*ends, SPEED_POINTS), np.linspace(given.lowest, given.highest, 21), np.array([given.trip])]
    for speed in np.linspace(*ends, POLE_SPEEDS):
        poles = linear_system(model, (), (), {"speed": float(speed)})[0].poles()
        poles = poles[(poles.imag > 0) & (np.abs(poles.real) < poles.imag)]
        found.append((poles.imag[:, None] + np.abs(poles.real)[:, None] * AROUND_A_POLE).ravel())
    speeds = np.unique(np.round(np.concatenate(found), 9))
    return np.asarray(speeds[(speeds >= ends[0] - 1e-6) & (speeds <= ends[1] + 1e-6)])


def _near_maxima(speeds: np.ndarray, size: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    """Return more speeds around each maximum of any curve, as far as its half-power speeds."""
    found: list[np.ndarray] = []
    for curve in size.reshape(len(speeds), -1).T:
        for k in _maxima(curve):
            peak = peak_in(speeds, curve, k)
            low, high = (one if np.isfinite(one) else peak.speed for one in (peak.lower, peak.upper))
            found.append(np.linspace(max(low - (high - low) / 4, ends[0]), min(high + (high - low) / 4, ends[1]), 25))
            found.append(np.linspace(speeds[k - 1], speeds[k + 1], 9))
    near = np.unique(np.round(np.concatenate(found), 9)) if found else np.zeros(0)
    return np.setdiff1d(near, speeds)


def _read(speeds: np.ndarray, curve: np.ndarray, k: int) -> Peak:
    """Return the peak of a curve at a maximum; a half-power speed that it has not is as far away as the other."""
    peak = replace(peak_in(speeds, curve, k), speed=_vertex(speeds, curve, k))
    if np.isnan(peak.upper):
        return replace(peak, upper=2 * peak.speed - peak.lower)
    return replace(peak, lower=2 * peak.speed - peak.upper) if np.isnan(peak.lower) else peak


def _vertex(speeds: np.ndarray, curve: np.ndarray, k: int) -> float:
    """Return where the parabola through a maximum and its neighbours is largest."""
    a, b, _ = np.polyfit(speeds[k - 1 : k + 2] - speeds[k], curve[k - 1 : k + 2] / curve[k], 2)
    return float(speeds[k] - b / (2 * a)) if a < 0 else float(speeds[k])


def _maxima(curve: np.ndarray) -> list[int]:
    return (np.flatnonzero((curve[1:-1] > curve[:-2]) & (curve[1:-1] >= curve[2:])) + 1).tolist()


def _merged(one: UnbalanceResponse, other: UnbalanceResponse) -> UnbalanceResponse:
    speeds = np.concatenate([one.speeds, other.speeds])
    order = np.argsort(speeds)
    response = np.concatenate([one.response, other.response])[order]
    stable = np.concatenate([one.stable, other.stable])[order]
    return replace(one, speeds=speeds[order], response=response, stable=stable)


def _critical(response: UnbalanceResponse, size: np.ndarray, given: Conditions) -> Iterator[CriticalSpeedOfPlane]:
    """Yield the critical speeds of each plane; maxima of several probes within one's half-power speeds are one."""
    for j, plane in enumerate(response.planes):
        found = []
        for i, probe in enumerate(response.signals[: size.shape[1]]):
            for k in _maxima(size[:, i, j]):
                peak = _read(response.speeds, size[:, i, j], k)
                if np.isfinite(peak.amplification):
                    margin = separation_margin(peak.speed, peak.amplification, given.lowest, given.highest)
                    found.append(CriticalSpeedOfPlane(plane, probe, peak, margin))
        kept: list[CriticalSpeedOfPlane] = []
        for one in sorted(found, key=lambda item: -item.peak.amplification):
            if not any(other.peak.lower <= one.peak.speed <= other.peak.upper for other in kept):
                kept.append(one)
        yield from sorted(kept, key=lambda item: item.peak.speed)


def _judged(found: UnbalanceCases, given: Conditions) -> Part:
    speeds, count = found.response.speeds * 30 / np.pi, found.probes
    words = f"U_a = {found.unbalance * 1e6:.4g} g mm: twice 6350 W / N, rotor of {found.mass:.4g} kg"
    ill = speeds[~found.response.stable & (found.response.speeds <= given.trip * (1 + 1e-9))]
    if len(ill):
        said = f"no settled response: unstable from {ill[0]:.5g} to {ill[-1]:.5g} rpm"
        failed = Criterion(VIBRATION, "response to unbalance", stated=NOT_MET, said=said)
        return Part(UNBALANCE_TITLE, (failed,), (words, *found.response.notes))
    made: list[Criterion] = []
    inside = (found.response.speeds >= given.lowest * (1 - 1e-9)) & (
        found.response.speeds <= given.highest * (1 + 1e-9)
    )
    for j, plane in enumerate(found.response.planes):
        curves = 2 * np.where(inside[:, None], found.size[:, :count, j], -np.inf)
        n, i = map(int, np.unravel_index(int(np.argmax(curves)), curves.shape))
        where = f"{found.response.signals[i]} at {speeds[n]:.5g} rpm, U_a at {plane}"
        said = f"S_cc {found.scale[j]:.3g}"
        largest, limit = float(curves[n, i]) * 1e6, found.limit * 1e6
        made.append(Criterion(VIBRATION, "A_max, peak to peak", where, largest, limit, "um", said=said))
    made += _separations(found)
    below = found.response.speeds <= given.trip * (1 + 1e-9)
    for i in np.flatnonzero(np.isfinite(found.clearance)).tolist():
        scaled = 2 * found.size[:, i] * found.scale
        curves = np.where(below[:, None], scaled, -np.inf)
        n, j = map(int, np.unravel_index(int(np.argmax(curves)), curves.shape))
        where = f"{found.response.signals[i]} at {speeds[n]:.5g} rpm, U_a at {found.response.planes[j]}"
        limit = CLEARANCE_SHARE * 2 * found.clearance[i] * 1e6
        largest, what = float(curves[n, j]) * 1e6, "S_cc A, peak to peak"
        made.append(Criterion(CLEARANCE, what, where, largest, limit, "um", said="0 to trip speed"))
    return Part(UNBALANCE_TITLE, tuple(made), (words, *found.response.notes), (found,))


def _separations(found: UnbalanceCases) -> Iterator[Criterion]:
    for one in found.critical:
        af, margin = one.peak.amplification, one.margin
        where = f"N_c {one.peak.speed * 30 / np.pi:.5g} rpm, AF {af:.3g}, {one.probe}, U_a at {one.plane}"
        said = f"AF below {RESPONSIVE:g}: no margin needed" if af < RESPONSIVE else ""
        what, needed = "separation margin", margin.required
        yield Criterion(SEPARATION, what, where, margin.actual, needed, "%", at_most=False, said=said)
    if not found.critical:
        top = f"0 to {found.response.speeds[-1] * 30 / np.pi:.5g} rpm"
        yield Criterion(SEPARATION, "separation margin", top, said="no critical speed", stated=MET)


def rotor_mass(model: Model, plane: str) -> float:
    """Return the mass [kg] of the rotor that a plane is on, from its traced equations.

    Of one that is free without its bearings from its rigid modes; else from the accelerations that forces and moments
    at all of its degrees of freedom make, M = (dq''/df)^-1. Raises RotorsimError where neither tells it.
    """
    port = plane_entries(model.diagram, plane)[0]
    block = port.rpartition(".")[0]
    node = model.diagram.nodes[block]
    ask = RotorsimError(Problem("its equations do not tell its mass", block, hint="give it: --mass '8.2 kg'"))
    if "displacement" not in node.outputs:
        raise ask
    has_tilt = "moment" in node.inputs and "tilt" in node.outputs
    signals = [f"{block}.displacement", *([f"{block}.tilt"] if has_tilt else [])]
    forces = [port, *([f"{block}.moment"] if has_tilt else [])]
    rotor = free_rotor(model, signals=signals, forces=forces)
    if has_tilt and any(mode.rigid for mode in rotor.modes()):
        first = "1,1" if len(node.outputs["displacement"].shape) == 2 else "1"
        return mass_of(rotor, *(f"{name}[{first}]" for name in (*forces, *signals)))
    along = [k for k, name in enumerate(rotor.forces) if name.startswith(tuple(f"{one}[" for one in forces))]
    along = [k for k in along if rotor.forces[k].endswith(("[1]", ",1]")) and rotor.B[:, k].any()]
    columns = rotor.B[:, along]
    moved = columns.any(axis=1)
    if np.count_nonzero(moved) != len(along):
        raise ask
    rows = [name for name in rotor.names if name.startswith(f"{block}.displacement") and name.endswith(("[1]", ",1]"))]
    C = rotor.rows(rows)[:, moved]
    if not C.any(axis=1).all():  # pinned nodes carry what the equations do not show
        raise ask
    translation = np.linalg.lstsq(C, np.ones(len(C)), rcond=None)[0] if has_tilt else np.ones(len(along))
    return float(translation @ np.linalg.solve(columns[moved], translation))
