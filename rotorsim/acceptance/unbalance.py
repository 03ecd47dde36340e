"""API 617: response to unbalance - critical speeds, separation margins, vibration at the probes, running clearances.

The unbalance of an analysis is U_a = 2 U_r, U_r = 6350 W / N [g mm], W: mass of the rotor [kg], N: maximum continuous
speed [rpm]. The standard distributes it as the mode shapes are. Amplitudes: all of it stands in one plane after the
other. At any place the response to any distribution of it is at most the largest of these, since the response is linear
and the parts add up to U_a. Critical speeds and amplification factors, of which that is not so, are read off these
curves, and off those of equal parts in all planes, in phase and opposed in every combination. Modes that no plane
excites are judged by their damping ratio: AF = 1 / (2 z) at the speed at which 1X meets them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from rotorsim.acceptance.conditions import HIGHEST_SHARE, Conditions, campbell_of
from rotorsim.acceptance.criterion import API_684, MET, NOT_MET, UNSURE, Criterion, Part, judged, not_judged
from rotorsim.acceptance.limits import ANALYSED, clearance_scale, residual_unbalance, vibration_limit
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.loop import linear_system
from rotorsim.linear.modes.unbalance_response import UnbalanceResponse, between, plane_entries, unbalance_response
from rotorsim.model.compiled import Model
from rotorsim.signals.orders.resonance import RESPONSIVE, Margin, Peak, peak_in, separation_margin

UNBALANCE_TITLE = "Response to unbalance"
VIBRATION, SEPARATION, CLEARANCE = (f"{API_684}, SP6.8.2.{n}" for n in (8, 10, 12))
LOWEST_SHARE = 0.02  # of the trip speed, from which on the response is computed
SPEED_POINTS = 81  # speeds over all, for the curves; peaks stand at poles, where `NEAR_A_POLE` puts more
NEAR_A_POLE = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])  # half widths of a pole: speeds beside it
BOTH_WHIRLS = 1e-3  # relative: nearer ones are both whirls of one mode, alike in x and y
SPEED_RESOLUTION = 2e-4  # of the largest speed: a mode of AF 500 there is ten of these wide
MOST_OPPOSED = 5  # planes, of which all combinations of signs are tried
POLE_SPEEDS = 3  # at which the poles are looked at: in between these move little, and `_near_maxima` follows
CLEARANCE_SHARE = 0.75  # of the diametral clearance, that the scaled response may use


@dataclass(frozen=True)
class CriticalSpeedOfPlane:
    """A maximum of the response to unbalance, at the probe and distribution with the largest amplification factor.

    case: a plane that all of the unbalance is in, or the signs of equal parts: "+rotor.force[4] -rotor.force[6]".
    """

    case: str
    probe: str
    peak: Peak
    margin: Margin


@dataclass(frozen=True, eq=False)
class UnbalanceCases:
    """All of the unbalance [kg m] in one plane after the other; size (n, places, planes) [m]: 0-peak, major axis.

    places: of ``response.signals``; the first ``probes`` are probes. limit: A_vl [m], peak to peak. ratio (planes,):
    A_vl / A_max, of which S_cc is made. masses: rotor -> [kg]; unbalances (planes,) [kg m]. clearance (places,) [m],
    radial; NaN: none given. operating, trip [rad/s]. critical: maxima of all distributions.
    """

    response: UnbalanceResponse
    size: np.ndarray
    probes: int
    limit: float
    ratio: np.ndarray
    clearance: np.ndarray
    operating: tuple[float, float]
    trip: float
    critical: tuple[CriticalSpeedOfPlane, ...]
    masses: Mapping[str, float]
    unbalances: np.ndarray

    @property
    def scale(self) -> np.ndarray:
        """S_cc (planes,)."""
        return np.array([clearance_scale(ratio) for ratio in self.ratio])

    def scale_text(self, plane: int) -> str:
        """Return S_cc of a plane, and the ratio that it is limited from."""
        ratio, scale = self.ratio[plane], self.scale[plane]
        return f"S_cc {scale:.3g}" + (f", of A_vl / A_max {ratio:.3g}" if scale != ratio else "")


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
    return judged(UNBALANCE_TITLE, VIBRATION, what, lambda: _judged(model, _cases(model, given), given))


def _cases(model: Model, given: Conditions) -> UnbalanceCases:
    rotors = [plane_entries(model.diagram, plane)[0].rpartition(".")[0] for plane in given.planes]
    masses = {name: rotor_mass(model.diagram, name) if given.mass is None else given.mass for name in rotors}
    amounts = ANALYSED * np.array([residual_unbalance(masses[name], given.highest) for name in rotors])
    places = [*given.probes, *(place for place in given.clearance if place not in given.probes)]
    ends = LOWEST_SHARE * given.trip, HIGHEST_SHARE * given.trip
    speeds = _speeds(model, ends, given)
    response = unbalance_response(model, given.planes, places, speeds=speeds, stability=False)
    cases = _distributions(given.planes, amounts)
    near = _near_maxima(speeds, np.stack([response.major_axis(one) for one in cases.values()], axis=-1), ends)
    if len(near):
        response = _merged(response, unbalance_response(model, given.planes, places, speeds=near, stability=False))
    map_of = campbell_of(model, given)  # which looks at the poles
    response = replace(response, stable=between(response.speeds, map_of.speeds, map_of.stable))
    count = len(given.probes)
    curves = {name: response.major_axis(one)[:, :count] for name, one in cases.items()}
    size = np.stack([response.major_axis(one) for one in np.diag(amounts)], axis=-1)
    limit = vibration_limit(given.highest)
    with np.errstate(divide="ignore"):
        largest = 2 * size[_within(response.speeds, given)][:, :count].max(axis=(0, 1))
        ratio = limit / largest
    return UnbalanceCases(
        response=response,
        size=size,
        probes=count,
        limit=limit,
        ratio=ratio,
        clearance=np.array([given.clearance.get(place, np.nan) for place in places]),
        operating=(given.lowest, given.highest),
        trip=given.trip,
        critical=tuple(_critical(response, curves, given)),
        masses=masses,
        unbalances=amounts,
    )


def _distributions(planes: Sequence[str], amounts: np.ndarray) -> dict[str, np.ndarray]:
    """Return unbalances [kg m] by what they are called: all in one plane, and equal parts in phase and opposed."""
    cases = dict(zip(planes, np.diag(amounts), strict=True))
    if 1 < len(planes) <= MOST_OPPOSED:
        for signs in product((1.0, -1.0), repeat=len(planes) - 1):
            every = np.array([1.0, *signs])
            name = " ".join(f"{'+' if sign > 0 else '-'}{plane}" for sign, plane in zip(every, planes, strict=True))
            cases[name] = amounts * every / len(planes)
    return cases


def _within(speeds: np.ndarray, given: Conditions) -> np.ndarray:
    """Return which speeds are operating speeds, the ends among them."""
    return np.asarray((speeds >= given.lowest * (1 - 1e-9)) & (speeds <= given.highest * (1 + 1e-9)))


def _speeds(model: Model, ends: tuple[float, float], given: Conditions) -> np.ndarray:
    """Return speeds between two, those of operation, and others dense at every pole."""
    found = [np.linspace(*ends, SPEED_POINTS), np.linspace(given.lowest, given.highest, 21)]
    for speed in np.linspace(*ends, POLE_SPEEDS):
        poles = linear_system(model, (), (), {"speed": float(speed)}, told=False)[0].poles()
        poles = poles[(poles.imag > 0) & (np.abs(poles.real) < poles.imag)]
        found.append((poles.imag[:, None] + np.abs(poles.real)[:, None] * NEAR_A_POLE).ravel())
    step = SPEED_RESOLUTION * ends[1]
    rounded = np.unique(np.round(np.concatenate(found) / step)) * step
    rounded = rounded[(rounded >= ends[0]) & (rounded <= ends[1])]
    exact = np.array([given.lowest, given.highest, given.trip])
    rounded = rounded[np.abs(rounded[:, None] - exact).min(axis=1) > step / 2]
    return np.unique(np.concatenate([rounded, exact]))


def _near_maxima(speeds: np.ndarray, size: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    """Return more speeds around each maximum of any curve, as far as its half-power speeds."""
    found: list[np.ndarray] = []
    for curve in size.reshape(len(speeds), -1).T:
        for k in _maxima(curve):
            peak = peak_in(speeds, curve, k)
            low, high = (one if np.isfinite(one) else peak.speed for one in (peak.lower, peak.upper))
            found.append(np.linspace(max(low - (high - low) / 4, ends[0]), min(high + (high - low) / 4, ends[1]), 25))
            found.append(np.linspace(speeds[k - 1], speeds[k + 1], 9))
    if not found:
        return np.zeros(0)
    step = SPEED_RESOLUTION * ends[1]
    near = np.unique(np.round(np.concatenate(found) / step)) * step
    near = near[(near >= ends[0]) & (near <= ends[1])]
    return np.asarray(near[np.abs(near[:, None] - speeds).min(axis=1) > step / 2])


def _read(speeds: np.ndarray, curve: np.ndarray, k: int) -> Peak:
    """Return the peak of a curve at a maximum, between the minima beside it.

    A half-power speed that it does not fall to there is as far away as the other.
    """
    falls, rises = np.diff(curve[k:]) > 0, np.diff(curve[: k + 1]) < 0
    last = k + int(np.argmax(falls)) if falls.any() else len(curve) - 1
    first = int(np.flatnonzero(rises)[-1]) + 1 if rises.any() else 0
    own = slice(first, last + 1)
    peak = replace(peak_in(speeds[own], curve[own], k - first), speed=_vertex(speeds, curve, k))
    if np.isnan(peak.upper):
        return replace(peak, upper=2 * peak.speed - peak.lower)
    return replace(peak, lower=2 * peak.speed - peak.upper) if np.isnan(peak.lower) else peak


def _vertex(speeds: np.ndarray, curve: np.ndarray, k: int) -> float:
    """Return where the parabola through a maximum and its neighbours is largest."""
    a, b, _ = np.polyfit(speeds[k - 1 : k + 2] - speeds[k], curve[k - 1 : k + 2] / curve[k], 2)
    top = float(speeds[k] - b / (2 * a)) if a < 0 else float(speeds[k])
    return min(max(top, float(speeds[k - 1])), float(speeds[k + 1]))


def _maxima(curve: np.ndarray) -> list[int]:
    return (np.flatnonzero((curve[1:-1] > curve[:-2]) & (curve[1:-1] >= curve[2:])) + 1).tolist()


def _merged(one: UnbalanceResponse, other: UnbalanceResponse) -> UnbalanceResponse:
    speeds = np.concatenate([one.speeds, other.speeds])
    order = np.argsort(speeds)
    response = np.concatenate([one.response, other.response])[order]
    return replace(one, speeds=speeds[order], response=response)


def _critical(
    response: UnbalanceResponse, curves: Mapping[str, np.ndarray], given: Conditions
) -> Iterator[CriticalSpeedOfPlane]:
    """Yield the critical speeds: maxima within the half-power speeds of one with a larger AF are that one."""
    found = []
    for case, sizes in curves.items():
        for i, probe in enumerate(response.signals[: sizes.shape[1]]):
            for k in _maxima(sizes[:, i]):
                peak = _read(response.speeds, sizes[:, i], k)
                if np.isfinite(peak.amplification):
                    margin = separation_margin(peak.speed, peak.amplification, given.lowest, given.highest)
                    found.append(CriticalSpeedOfPlane(case, probe, peak, margin))
    kept: list[CriticalSpeedOfPlane] = []
    for one in sorted(found, key=lambda item: -item.peak.amplification):
        if not any(other.peak.lower <= one.peak.speed <= other.peak.upper for other in kept):
            kept.append(one)
    yield from sorted(kept, key=lambda item: item.peak.speed)


def _judged(model: Model, found: UnbalanceCases, given: Conditions) -> Part:
    speeds, count = found.response.speeds * 30 / np.pi, found.probes
    rotors = ", ".join(f"{name} of {mass:.4g} kg" for name, mass in found.masses.items())
    amounts = ", ".join(dict.fromkeys(f"{amount * 1e6:.4g}" for amount in found.unbalances))
    words = f"U_a = {amounts} g mm: twice 6350 W / N, {rotors}"
    notes = (words, *found.response.notes)
    ill = speeds[~found.response.stable & (found.response.speeds <= given.trip * (1 + 1e-9))]
    if len(ill):
        said = f"no settled response: unstable from {ill[0]:.5g} to {ill[-1]:.5g} rpm"
        failed = Criterion(VIBRATION, "response to unbalance", stated=NOT_MET, said=said)
        return Part(UNBALANCE_TITLE, (failed,), notes)
    made: list[Criterion] = []
    inside = _within(found.response.speeds, given)
    for j, plane in enumerate(found.response.planes):
        curves = 2 * np.where(inside[:, None], found.size[:, :count, j], -np.inf)
        n, i = map(int, np.unravel_index(int(np.argmax(curves)), curves.shape))
        where = f"{found.response.signals[i]} at {speeds[n]:.5g} rpm, U_a at {plane}"
        said = found.scale_text(j)
        largest, limit = float(curves[n, i]) * 1e6, found.limit * 1e6
        made.append(Criterion(VIBRATION, "A_max, peak to peak", where, largest, limit, "um", said=said))
    made += _separations(found)
    made += _not_excited(model, found, given)
    below = found.response.speeds <= given.trip * (1 + 1e-9)
    for i in np.flatnonzero(np.isfinite(found.clearance)).tolist():
        scaled = 2 * found.size[:, i] * found.scale
        curves = np.where(below[:, None], scaled, -np.inf)
        n, j = map(int, np.unravel_index(int(np.argmax(curves)), curves.shape))
        where = f"{found.response.signals[i]} at {speeds[n]:.5g} rpm, U_a at {found.response.planes[j]}"
        limit = CLEARANCE_SHARE * 2 * found.clearance[i] * 1e6
        largest, what = float(curves[n, j]) * 1e6, "S_cc A, peak to peak"
        made.append(
            Criterion(CLEARANCE, what, where, largest, limit, "um", said=f"{found.scale_text(j)}, 0 to trip speed")
        )
    return Part(UNBALANCE_TITLE, tuple(made), notes, (found,))


def _separations(found: UnbalanceCases) -> Iterator[Criterion]:
    for one in found.critical:
        where = f"{one.probe}, U_a at {one.case}"
        yield _separation(one.peak.speed, one.peak.amplification, one.margin, where)
    if not found.critical:
        top = f"0 to {found.response.speeds[-1] * 30 / np.pi:.5g} rpm"
        yield Criterion(SEPARATION, "separation margin", top, said="no critical speed", stated=MET)


def _separation(speed: float, af: float, margin: Margin, where: str) -> Criterion:
    words = f"N_c {speed * 30 / np.pi:.5g} rpm, AF {af:.3g}, {where}"
    said = f"AF below {RESPONSIVE:g}: no margin needed" if af < RESPONSIVE else ""
    return Criterion(SEPARATION, "separation margin", words, margin.actual, margin.required, "%", False, said=said)


def _not_excited(model: Model, found: UnbalanceCases, given: Conditions) -> Iterator[Criterion]:
    """Yield the separation of modes that 1X meets and that no unbalance brought out, by their damping ratios."""
    crossings = [one for one in campbell_of(model, given).crossings if one.order == 1]
    told = [(other.peak.lower, other.peak.upper) for other in found.critical]
    for one in crossings:
        near = [other for other in crossings if abs(other.speed - one.speed) <= BOTH_WHIRLS * one.speed]
        turns_back = one.whirl == "backward" and len(near) == 1  # of two at one speed the whirl is arbitrary
        seen = any(low <= one.speed <= high for low, high in told)
        if turns_back or seen or not 0 < one.damping_ratio < 1 / (2 * RESPONSIVE):
            continue
        told.append((one.speed * (1 - BOTH_WHIRLS), one.speed * (1 + BOTH_WHIRLS)))
        af = 1 / (2 * one.damping_ratio)
        words = f"mode of {one.frequency_hz:.4g} Hz{one.modulo_text}, by its damping ratio: no plane excites it"
        own = _separation(one.speed, af, separation_margin(one.speed, af, given.lowest, given.highest), words)
        unsure = not np.isnan(one.modulo) and own.verdict == MET  # another image may be met elsewhere
        yield replace(own, stated=UNSURE) if unsure else own


def rotor_mass(diagram: Diagram, block: str) -> float:
    """Return the mass [kg] of a rotor: of its drawing, or its parameter ``mass``.

    Raises RotorsimError for a block that has neither.
    """
    node = diagram.nodes[block]
    drawing = getattr(node.block, "drawing", None)
    if drawing is not None:
        return float(drawing(node.values).mass)
    mass = node.values.get("mass")
    if mass is None or np.size(mass) != 1:
        raise RotorsimError(Problem("its mass is not known", block, hint="give it: --mass '8.2 kg'"))
    return float(mass)
