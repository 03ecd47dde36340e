"""What is suspicious between the channels and the runs of a recording."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, groupby, product

import numpy as np

from rotorsim.errors import Place, Problem
from rotorsim.recordings.recording import Recording, Run

_ALIKE = 1e-3  # two speeds


def missing_channels(recording: Recording) -> Iterator[Problem]:
    there = {(c.signal, c.node, c.position, c.axis) for c in recording.channels.values()}
    for column, channel in recording.channels.items():
        partner = {"x": "y", "y": "x"}.get(channel.axis or "")
        if partner and (channel.signal, channel.node, channel.position, partner) not in there:
            what = f"missing channel: {channel.name} is measured, its {partner} axis is not"
            hint = "forward and backward whirl cannot be separated with one axis"
            yield Problem(what, f"channel {column}", Place(str(recording.folder)), hint, "warning", "missing_channel")


def alike_runs(runs: Sequence[Run]) -> Iterator[Problem]:
    """Find runs with the same data, and runs to be fitted that repeat another one's conditions."""
    prints = {run.id: _fingerprint(run) for run in runs}
    for one, other in combinations(runs, 2):
        if prints[one.id] == prints[other.id]:
            what = f"two runs alike: the data of {one.id} and {other.id} are identical"
            hint = f"leave one of {one.file} and {other.file} out"
            yield Problem(what, other.id, other.place, hint, code="two_runs_alike")

    def conditions(run: Run) -> list[tuple[str, str]]:
        return sorted((name, repr(value)) for name, value in run.settings.items())

    repeats = sorted((run for run in runs if run.use == "identify" and run.speed is not None), key=conditions)
    for _, group in groupby(repeats, key=conditions):
        for one, other in combinations(group, 2):
            speeds = one.speed or 0.0, other.speed or 0.0
            same = abs(speeds[0] - speeds[1]) <= _ALIKE * max(map(abs, speeds))
            if same and prints[one.id] != prints[other.id]:
                what = f"two runs alike: {one.id} and {other.id} have the same speed and set"
                hint = "they average noise, but add no new equations; vary the speed or a gain"
                yield Problem(what, other.id, other.place, hint, "warning", "two_runs_alike")


def _fingerprint(run: Run) -> str:
    digest = hashlib.sha256()
    for column in sorted(run.values):
        digest.update(column.encode("utf-8", "replace") + np.ascontiguousarray(run.values[column]).tobytes())
    return digest.hexdigest()


def swapped_axes(recording: Recording, runs: Sequence[Run]) -> Iterator[Problem]:
    """Find a pair of axes that is exchanged: a current follows its displacement's axis, not the other one.

    A circular orbit with a quarter turn between displacement and current looks alike, but then one of the two
    crossed correlations is negative where an exchange leaves both with the same sign.
    """
    pairs: dict[tuple[str, int | None, float | None], dict[str, str]] = {}
    for column, channel in recording.channels.items():
        if channel.axis is not None:
            pairs.setdefault((channel.signal, channel.node, channel.position), {})[channel.axis] = column
    moved, currents = (
        [axes for where, axes in pairs.items() if where[0].endswith(kind) and len(axes) == 2]
        for kind in (".displacement", ".current")
    )
    for d, i in product(moved, currents):
        votes = [_vote(run.values, d, i) for run in runs]
        if votes.count(1) > 0 and votes.count(-1) == 0 and votes.count(1) >= 0.3 * len(votes):
            follows = f"{d['x']} follows {i['y']} and {d['y']} follows {i['x']}"
            what = f"swapped axes? {follows} in {votes.count(1)} of {len(votes)} runs"
            hint = f"exchange {d['x']} and {d['y']}, or {i['x']} and {i['y']}"
            yield Problem(what, f"column {d['x']}", Place(str(recording.folder)), hint, "warning", "swapped_axes")


def _vote(values: Mapping[str, np.ndarray], axes: Mapping[str, str], currents: Mapping[str, str]) -> int:
    """Return 1 if a run speaks for exchanged axes, -1 if against, 0 if it tells nothing."""
    signals = np.array([values[axes["x"]], values[axes["y"]], values[currents["x"]], values[currents["y"]]])
    if not np.all(np.isfinite(signals)) or np.any(np.ptp(signals, axis=1) == 0):
        return 0
    c = np.corrcoef(signals)
    straight, crossed = (c[0, 2], c[1, 3]), (c[0, 3], c[1, 2])
    if min(map(abs, crossed)) > 0.8 and max(map(abs, straight)) < 0.5 and crossed[0] * crossed[1] > 0:
        return 1
    return -1 if min(map(abs, straight)) > 0.7 else 0
