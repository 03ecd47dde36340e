"""ISO 14839-2: the largest displacement of the shaft against the clearance, modelled and measured.

D_max is the largest distance of the shaft from the centre of the clearance, of all that it does: static position,
unbalance, crack, and what a recording has besides. Zones A, B, C end at 0.3, 0.4, 0.5 of the clearance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.acceptance.conditions import Conditions
from rotorsim.acceptance.criterion import ISO_2, MET, RUNNING_TEST, UNSURE, Criterion, Part, judged, not_judged
from rotorsim.acceptance.limits import vibration_limit
from rotorsim.acceptance.probes import examined
from rotorsim.errors import RotorsimError
from rotorsim.linear.loop import linear_system
from rotorsim.model.compiled import Model
from rotorsim.recordings.recording import AXES, Channel, Recording, Run
from rotorsim.settled.periodic import periodic
from rotorsim.signals.orders.resonance import IN_RANGE
from rotorsim.signals.shaft_angle import shaft_angle
from rotorsim.signals.turning import is_run_up

DISPLACEMENT_ZONES = ((0.3, "A"), (0.4, "B"), (0.5, "C"))  # of the least radial clearance
DISPLACEMENT_TITLE, CLAUSE, WHAT = "Displacement against the clearance", f"{ISO_2}, table 1", "D_max / C_min"
NO_CLEARANCE = "no clearance is given: --clearance"
NEAR_HIGHEST = 0.02  # of the largest operating speed, within which it counts as recorded
SPEEDS = 9  # of the operating range, at which the settled motion is computed


def displacement_zone(share: float) -> str:
    """Return the zone of D_max / C_min: A to 0.3, B to 0.4, C to 0.5, else D. Source: ISO 14839-2:2004, table 1."""
    return next((zone for limit, zone in DISPLACEMENT_ZONES if share <= limit), "D")


@dataclass(frozen=True, eq=False)
class Displacement:
    """D_max (n, places) [m] over speeds (n,) [rad/s]; NaN: no settled motion. clearance (places,) [m]."""

    source: str
    speeds: np.ndarray
    places: tuple[str, ...]
    largest: np.ndarray
    clearance: np.ndarray


def modelled_displacement(model: Model, given: Conditions) -> Part:
    """Return D_max of the settled motion of the diagram over its operating speeds, as it stands there."""
    blind = [
        Criterion(CLAUSE, WHAT, place, said=NO_CLEARANCE) for place in given.probes if place not in given.clearance
    ]
    places = [name for name in given.clearance if name]
    if not (places or blind):
        return not_judged(DISPLACEMENT_TITLE, CLAUSE, WHAT, "no controller sees two axes of a displacement")
    if not np.isfinite(given.highest):
        return not_judged(DISPLACEMENT_TITLE, CLAUSE, WHAT, "no operating speed is given: --operating")
    if not places:
        return Part(DISPLACEMENT_TITLE, tuple(blind))
    found = judged(DISPLACEMENT_TITLE, CLAUSE, WHAT, lambda: _settled(model, given, places))
    return replace(found, criteria=(*found.criteria, *blind))


def _operating_speeds(model: Model, given: Conditions) -> np.ndarray:
    """Return speeds of the operating range: equal steps, and those at which 1X or 2X meets a mode."""
    found = [np.linspace(given.lowest, given.highest, SPEEDS)]
    if given.highest > given.lowest:
        for speed in (given.lowest, given.highest):
            poles = linear_system(model, (), (), {"speed": float(speed)}, told=False)[0].poles()
            poles = poles[(poles.imag > 0) & (-poles.real < poles.imag)]
            near = (poles.imag[:, None] + np.abs(poles.real)[:, None] * np.array([-0.5, 0.0, 0.5])).ravel()
            found += [near, near / 2]
    speeds = np.unique(np.round(np.concatenate(found), 9))
    inside = (speeds >= given.lowest) & (speeds <= given.highest)
    return np.unique(np.concatenate([found[0], speeds[inside]]))


def _settled(model: Model, given: Conditions, places: Sequence[str]) -> Part:
    speeds = _operating_speeds(model, given)
    motion = periodic(model, speeds=speeds, signals=places)
    largest = np.stack([motion.largest(place) for place in places], axis=1)
    ill = ~motion.settled | np.array([stable is False for stable in motion.stable])
    largest[ill] = np.nan
    notes = [
        f"{at * 30 / np.pi:.6g} rpm: {said}"
        for at, said in zip(speeds, motion.status, strict=True)
        if said != "settled"
    ]
    clearance = np.array([given.clearance[place] for place in places])
    if ill.any():
        ends = speeds[ill][[0, -1]] * 30 / np.pi
        said = f"no stable settled motion at {ill.sum()} of {len(speeds)} speeds, {ends[0]:.6g} to {ends[1]:.6g} rpm"
        failed = Criterion(CLAUSE, WHAT, value=np.inf, limit=_limit(given), said=said)
        return Part(DISPLACEMENT_TITLE, (failed,), tuple(notes))
    made = []
    for k, place in enumerate(places):
        worst = int(np.argmax(largest[:, k]))
        made.append(_criterion(given, largest[worst, k], place, speeds[worst], clearance[k], "modelled"))
    result = Displacement("modelled", speeds, tuple(places), largest, clearance)
    return Part(DISPLACEMENT_TITLE, tuple(made), tuple(notes), (result,))


def _limit(given: Conditions) -> float:
    return next(limit for limit, zone in DISPLACEMENT_ZONES if zone == given.zone)


def _criterion(
    given: Conditions, largest: float, place: str, speed: float, clearance: float, source: str, run: str = ""
) -> Criterion:
    share = float(largest / clearance)
    return Criterion(
        CLAUSE,
        WHAT,
        f"{place} at {speed * 30 / np.pi:.5g} rpm{f', {run}' if run else ''}",
        share,
        _limit(given),
        source=source,
        said=f"zone {displacement_zone(share)}: {largest * 1e6:.3g} um of {clearance * 1e6:.4g} um",
    )


def measured_displacement(recording: Recording, given: Conditions) -> Part:
    """Return D_max, and the vibration peak to peak, of all runs of a recording at one operating speed.

    D_max counts from the centre of the clearance, which zero of a channel is. A channel without a mean
    ("coupling": "ac") counts from its mean, and what it says is a lower bound. The vibration is of all frequencies, as
    a monitor shows it, of each channel.
    """
    title = f"Displacement and vibration, {recording.name}"
    return judged(title, CLAUSE, WHAT, lambda: _measured(title, recording, given))


def _measured(title: str, recording: Recording, given: Conditions) -> Part:
    notes: list[str] = []
    _, faults = examined(recording)
    runs = list(_at_operating_speed(recording, given, notes))
    places = _places(recording)
    if not places:
        return not_judged(title, CLAUSE, WHAT, "no displacement was measured")
    if not runs:
        missing = "no run at one speed within the operating speeds"
        said = missing if np.isfinite(given.highest) else "no operating speed is given: --operating"
        return not_judged(title, CLAUSE, WHAT, said)
    made: list[Criterion] = []
    results: list[Displacement] = []
    for place, axes in places.items():
        made += _of_place(recording, given, runs, place, axes, faults, results)
    near = max(speed for _, speed in runs)
    if near < given.highest * (1 - NEAR_HIGHEST):
        said = f"{near * 30 / np.pi:.5g} rpm is the largest operating speed that was recorded"
        made.append(Criterion(CLAUSE, WHAT, f"at {given.highest * 30 / np.pi:.5g} rpm", source="measured", said=said))
    return Part(title, tuple(made), tuple(notes), tuple(results))


def _of_place(
    recording: Recording,
    given: Conditions,
    runs: Sequence[tuple[Run, float]],
    place: str,
    axes: Sequence[Channel],
    faults: Mapping[tuple[str, str], str],
    results: list[Displacement],
) -> Iterator[Criterion]:
    """Yield D_max and the vibration at a place."""
    clearance = given.clearance.get(place, given.clearance.get("", np.nan))
    own = [(run, one, faults.get((run.id, one.column))) for run, _ in runs for one in axes]
    blind = [f"{run.id}, {one.name}: {what}" for run, one, what in own if what]
    required = place in given.probes or not given.probes  # others than the probes of the diagram are shown
    sizes = [(_largest(run, axes), run, speed) for run, speed in runs]
    sizes = [one for one in sizes if np.isfinite(one[0])]
    if not np.isfinite(clearance):
        yield Criterion(CLAUSE, WHAT, place, source="measured", required=required, said=NO_CLEARANCE)
    elif not sizes:
        yield Criterion(CLAUSE, WHAT, place, source="measured", said="nothing finite was measured")
    else:
        largest, run, speed = max(sizes, key=lambda one: one[0])
        found = _criterion(given, largest, place, speed, clearance, "measured", run.id)
        lacks = [f"its {axis} axis was not measured" for axis in AXES if axis not in {one.axis for one in axes}]
        lacks += [f"the mean of {one.name} was not measured" for one in axes if one.coupling == "ac"]
        lacks += blind
        if lacks and found.verdict == MET:
            found = replace(found, stated=UNSURE)
        yield replace(found, said="; ".join([found.said, *lacks]))
        values, speeds = np.array([[one[0]] for one in sizes]), np.array([one[2] for one in sizes])
        results.append(Displacement(recording.name, speeds, (place,), values, np.array([clearance])))
    wide = [
        (float(np.nanmax(run.values[one.column]) - np.nanmin(run.values[one.column])), run.id, speed, one.name)
        for run, speed in runs
        for one in axes
        if np.isfinite(run.values[one.column]).any()
    ]
    if wide:
        widest, at, speed, axis = max(wide)
        where = f"{axis} at {speed * 30 / np.pi:.5g} rpm, {at}"
        limit, what = vibration_limit(given.highest) * 1e6, "vibration, peak to peak"
        found = Criterion(RUNNING_TEST, what, where, widest * 1e6, limit, "um", source="measured", required=required)
        unsure = blind and found.verdict == MET
        yield replace(found, stated=UNSURE, said="; ".join(blind)) if unsure else found


def _at_operating_speed(recording: Recording, given: Conditions, notes: list[str]) -> Iterator[tuple[Run, float]]:
    """Yield the runs at one speed within the operating speeds, with it [rad/s]; note those that are left out."""
    for run in recording.runs:
        if is_run_up(recording, run):
            notes.append(f"{run.id}: its speed changes; not counted")
            continue
        try:
            speed = abs(shaft_angle(recording, run).speed)
        except RotorsimError:
            speed = abs(run.speed) if run.speed is not None else np.nan
        if not np.isfinite(speed):
            notes.append(f"{run.id}: its speed is not known; not counted")
        elif given.lowest * (1 - IN_RANGE) <= speed <= given.highest * (1 + IN_RANGE):
            yield run, float(speed)
        else:
            notes.append(f"{run.id}: {speed * 30 / np.pi:.5g} rpm, outside of the operating speeds; not counted")


def _places(recording: Recording) -> dict[str, list[Channel]]:
    """Return the channels of displacements at each place: two-axis signal -> x and y, or the one that there is."""
    found: dict[str, dict[str, Channel]] = {}
    for one in recording.channels.values():
        if one.signal.endswith("displacement") and one.axis is not None:
            number = AXES.index(one.axis) + 1
            place = (
                one.name.removesuffix(f",{number}]") + "]" if "," in one.name else one.name.removesuffix(f"[{number}]")
            )
            found.setdefault(place, {})[one.axis] = one
    return {place: [axes[axis] for axis in AXES if axis in axes] for place, axes in found.items()}


def _largest(run: Run, axes: Sequence[Channel]) -> float:
    """Return the largest distance from the centre; where an axis is missing, of the other alone."""
    squares = np.zeros(len(run.time))
    told = np.zeros(len(run.time), bool)
    for one in axes:
        values = np.asarray(run.values[one.column], float)
        there = np.isfinite(values)
        if there.any():
            mean = values[there].mean() if one.coupling == "ac" else 0.0
            squares += np.where(there, np.nan_to_num(values) - mean, 0.0) ** 2
            told |= there
    return float(np.sqrt(squares[told].max())) if told.any() else np.nan
