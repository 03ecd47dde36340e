"""Probes that do not point along x and y: two of one place, as at +-45 deg, measure the motion along both axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import sin
from typing import Generic, TypeVar

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.recording import AXES, Channel

C = TypeVar("C", bound=Channel)
LEAST_ANGLE = 0.1  # rad, between two directions: below, noise across them grows more than tenfold


@dataclass(frozen=True)
class Pair(Generic[C]):
    """Two probes of one place; [x, y] = inverse [first, second]."""

    first: C
    second: C

    @property
    def inverse(self) -> np.ndarray:
        """What makes motion along x and y of two readings, (2, 2)."""
        angles = np.array([self.first.direction, self.second.direction], float)
        return np.linalg.inv(np.stack([np.cos(angles), np.sin(angles)], axis=1))

    def channels(self) -> tuple[C, C]:
        """Return the two channels as they measure x and y; each keeps its column's name."""
        first, second = (
            replace(one, axis=axis, direction=None) for one, axis in zip((self.first, self.second), AXES, strict=True)
        )
        return first, second

    def readings(self, of_run: Mapping[str, np.ndarray], names: Sequence[str]) -> dict[str, np.ndarray]:
        """Return x and y under the names of the readings (n,) of a run."""
        together = self.inverse @ np.stack([of_run[name] for name in names])
        return dict(zip(names, together, strict=True))


def pairs_of(channels: Mapping[str, C]) -> dict[tuple[str, str], Pair[C]]:
    """Return the pairs of probes with a direction, by the names of both.

    Raises RotorsimError where one stands alone, both point the same way, or differ in unit or coupling.
    """
    of_place: dict[str, list[str]] = {}
    taken = {replace(one, axis=None).label for one in channels.values() if one.axis is not None}
    for name, channel in channels.items():
        if channel.direction is not None:
            of_place.setdefault(replace(channel, direction=None).label, []).append(name)
    found: dict[tuple[str, str], Pair[C]] = {}
    problems: list[Problem] = []
    for label, names in of_place.items():
        some = [channels[name] for name in names]
        subject, place = f"channel {names[-1]}", some[-1].place
        if label in taken or len(some) != 2:
            what = f"{len(some)} probe{'s' * (len(some) > 1)} of {label} with a direction"
            what += " beside one with an axis" if label in taken else ""
            hint = 'two of each place, "direction": "45 deg" and "135 deg" from x towards y'
            problems.append(Problem(what, subject, place, hint))
            continue
        pair = Pair(*some)
        if abs(sin(float(some[0].direction or 0.0) - float(some[1].direction or 0.0))) < LEAST_ANGLE:
            problems.append(Problem(f"points along the same line as '{names[0]}'", subject, place))
        elif (some[0].unit, some[0].coupling) != (some[1].unit, some[1].coupling):
            problems.append(Problem(f"differs from '{names[0]}' in unit or coupling", subject, place))
        else:
            found[names[0], names[1]] = pair
    if problems:
        raise RotorsimError(*problems)
    return found


def along_axes(
    channels: Mapping[str, C], runs: Sequence[Mapping[str, np.ndarray]], ids: Sequence[str]
) -> tuple[dict[str, C], list[dict[str, np.ndarray]]]:
    """Return channels and readings (n,) of runs, by name, with all pairs of probes turned to x and y; ids: of the runs.

    Raises RotorsimError as `pairs_of`, and for a run that has one of two.
    """
    turned, values = dict(channels), [dict(run) for run in runs]
    problems: list[Problem] = []
    for names, pair in pairs_of(channels).items():
        turned.update(zip(names, pair.channels(), strict=True))
        for run, own in zip(ids, values, strict=True):
            there = [name for name in names if name in own]
            if len(there) == 1:
                what = f"'{there[0]}' was measured in this run, and the probe across was not"
                problems.append(Problem(what, f"run {run}", hint="name both in not_measured, or neither"))
            elif there:
                own.update(pair.readings(own, names))
    if problems:
        raise RotorsimError(*problems)
    return turned, values
