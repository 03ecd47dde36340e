"""Where the search for an effect begins: small enough that the runs stay as they were without it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from rotorsim.identification.waveform.search import OutputErrorSearch

AMPLITUDES = tuple(10.0**-k for k in range(0, 25, 2))  # of what is stated, of an effect that is made smaller
NEARBY = (100.0, 30.0, 10.0, 3.0, 0.3, 0.1)  # of that which is small enough: sizes within a step of AMPLITUDES
WORSE = 4.0  # times the cost without the effect, of a start that is taken


def started(
    search: OutputErrorSearch, unknowns: np.ndarray, values: Mapping[str, float], old: Collection[str] = ()
) -> np.ndarray | None:
    """Return a point with some free parameters set, an effect made small enough that the runs stay as they were.

    Blocks state their starts for machines of usual size; an effect that is absent at zero is made smaller until
    its cost is within WORSE times that without it, and from there takes the size of NEARBY that costs least. None
    where no start is found. old: names that are no effect.
    """
    low, high = search.bounds
    index = {item.name: j for j, item in enumerate(search.free)}
    named = {name: index[name] for name in values if name in index}
    stated = search.stated(unknowns, values)
    effects = [j for name, j in named.items() if name not in old and stated[j] != 0 and low[j] <= 0 <= high[j]]

    def scaled(group: Sequence[int], factor: float) -> tuple[float, np.ndarray]:
        point = stated.copy()
        point[group] *= factor
        point = np.clip(point, low, high)
        return search.evaluate(point, search.substeps(point), sensitivities=False).cost, point

    groups = [*([j] for j in effects), *([effects] if len(effects) > 1 else [])]
    absent = [(scaled(group, 0.0)[0], group) for group in groups]
    least, group = min(absent, default=(np.inf, []), key=lambda pair: pair[0])
    if not np.isfinite(least):
        cost, point = scaled([], 1.0)
        return point if np.isfinite(cost) else None
    for factor in AMPLITUDES:
        trials = [scaled(group, factor)]
        if trials[0][0] <= WORSE * least:
            trials += [scaled(group, factor * nearby) for nearby in NEARBY]
            return min(trials, key=lambda pair: pair[0])[1]
    return None
