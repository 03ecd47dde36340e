"""ISO 14839-2: the largest displacement of the shaft against the clearance, modelled and measured.

D_max is the largest distance of the shaft from the centre of the clearance, of all that it does: static position,
unbalance, crack, and what a recording has besides. Zones A, B, C end at 0.3, 0.4, 0.5 of the clearance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.acceptance.conditions import Conditions
from rotorsim.acceptance.criterion import API_617, ISO_2, Criterion, Part, judged, not_judged
from rotorsim.acceptance.limits import vibration_limit
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.compiled import Model
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.settled.periodic import periodic
from rotorsim.signals.shaft_angle import shaft_angle
from rotorsim.signals.turning import is_run_up

DISPLACEMENT_ZONES = ((0.3, "A"), (0.4, "B"), (0.5, "C"))  # of the least radial clearance
DISPLACEMENT_TITLE, CLAUSE, WHAT = "Displacement against the clearance", f"{ISO_2}, table 1", "D_max / C_min"
SPEEDS = 9  # of the operating range, at which the settled motion is computed
IN_RANGE = 0.005  # of a speed: a machine that runs at its largest operating speed is within the range


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
    places = [name for name in given.probes if name in given.clearance]
    if not places:
        said = "no clearance is given: --clearance" if given.probes else "no controller sees two axes of a displacement"
        return not_judged(DISPLACEMENT_TITLE, CLAUSE, WHAT, said)
    if not np.isfinite(given.highest):
        return not_judged(DISPLACEMENT_TITLE, CLAUSE, WHAT, "no operating speed is given: --operating")
    return judged(DISPLACEMENT_TITLE, CLAUSE, WHAT, lambda: _settled(model, given, places))


def _settled(model: Model, given: Conditions, places: Sequence[str]) -> Part:
    speeds = np.unique(np.linspace(given.lowest, given.highest, SPEEDS))
    motion = periodic(model, speeds=speeds, signals=places)
    largest = np.full((len(speeds), len(places)), np.nan)
    for k, place in enumerate(places):
        if (motion.units[place] or "m") != "m":
            raise RotorsimError(Problem(f"a displacement in {motion.units[place]}, not in m", place))
        largest[:, k] = np.abs(motion.time_history(place)[1]).max(axis=1)
    ill = ~motion.settled | np.array([stable is False for stable in motion.stable])
    largest[ill] = np.nan
    notes = [
        f"{at * 30 / np.pi:.6g} rpm: {said}"
        for at, said in zip(speeds, motion.status, strict=True)
        if said != "settled"
    ]
    clearance = np.array([given.clearance[place] for place in places])
    if ill.any():
        at = ", ".join(f"{speed * 30 / np.pi:.6g}" for speed in speeds[ill])
        said = f"no stable settled motion at {at} rpm"
        failed = Criterion(CLAUSE, WHAT, value=np.inf, limit=_limit(given), said=said)
        return Part(DISPLACEMENT_TITLE, (failed,), tuple(notes))
    made = []
    for k, place in enumerate(places):
        worst = int(np.argmax(largest[:, k]))
        made.append(_criterion(given, largest[worst, k], place, speeds[worst], clearance[k], "modelled"))
    return Part(
        DISPLACEMENT_TITLE,
        tuple(made),
        tuple(notes),
        (Displacement("modelled", speeds, tuple(places), largest, clearance),),
    )


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

    D_max counts from the centre of the clearance, which zero of a channel is; a channel without a mean
    ("coupling": "ac") counts from its mean. The vibration is of all frequencies, as a monitor shows it.
    """
    title = f"Displacement and vibration, {recording.name}"
    notes: list[str] = []
    runs = list(_at_operating_speed(recording, given, notes))
    pairs = list(_pairs(recording))
    if not pairs:
        return not_judged(title, CLAUSE, WHAT, "no displacement was measured in both axes of one place")
    if not runs:
        said = (
            "no run at one speed within the operating speeds"
            if np.isfinite(given.highest)
            else ("no operating speed is given: --operating")
        )
        return not_judged(title, CLAUSE, WHAT, said)
    made: list[Criterion] = []
    limit = vibration_limit(given.highest)
    results = []
    for x, y in pairs:
        place = _place(x)
        clearance = given.clearance.get(place, given.clearance.get("", np.nan))
        blind = "ac" in (x.coupling, y.coupling)
        if blind:
            notes.append(f"{place}: its mean was not measured; D_max counts from the mean")
        sizes = [(_largest(run, x, y, blind), run, speed) for run, speed in runs]
        sizes = [one for one in sizes if np.isfinite(one[0])]
        if not sizes:
            continue
        largest, run, speed = max(sizes, key=lambda one: one[0])
        if np.isfinite(clearance):
            made.append(_criterion(given, largest, place, speed, clearance, "measured", run.id))
            values = np.array([[one[0]] for one in sizes])
            results.append(
                Displacement(
                    recording.name, np.array([one[2] for one in sizes]), (place,), values, np.array([clearance])
                )
            )
        else:
            made.append(Criterion(CLAUSE, WHAT, place, source="measured", said="no clearance is given: --clearance"))
        widest, at, speed, axis = max(
            (float(np.nanmax(run.values[one.column]) - np.nanmin(run.values[one.column])), run.id, speed, one.name)
            for run, speed in runs
            for one in (x, y)
            if np.isfinite(run.values[one.column]).any()
        )
        where = f"{axis} at {speed * 30 / np.pi:.5g} rpm, {at}"
        clause, what = f"{API_617}, mechanical running test", "vibration, peak to peak"
        made.append(Criterion(clause, what, where, widest * 1e6, limit * 1e6, "um", source="measured"))
    return Part(title, tuple(made), tuple(notes), tuple(results))


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


def _pairs(recording: Recording) -> Iterator[tuple[Channel, Channel]]:
    """Yield the channels of displacements x and y of each place."""
    found: dict[tuple[str, int | None, float | None], dict[str, Channel]] = {}
    for one in recording.channels.values():
        if one.signal.endswith("displacement") and one.axis is not None:
            found.setdefault((one.signal, one.node, one.position), {})[one.axis] = one
    for axes in found.values():
        if len(axes) == 2:
            yield axes["x"], axes["y"]


def _place(x: Channel) -> str:
    """Return the two-axis signal of the channel of an x axis: rotor.displacement[3], rotor.displacement."""
    return x.name.removesuffix(",1]") + "]" if x.name.endswith(",1]") else x.name.removesuffix("[1]")


def _largest(run: Run, x: Channel, y: Channel, from_mean: bool) -> float:
    """Return the largest distance from the centre, of samples in which both axes were measured."""
    motion = np.asarray(run.values[x.column]) + 1j * np.asarray(run.values[y.column])
    motion = motion[np.isfinite(motion)]
    if not len(motion):
        return np.nan
    return float(np.abs(motion - (motion.mean() if from_mean else 0.0)).max())
