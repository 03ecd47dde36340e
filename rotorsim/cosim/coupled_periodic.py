"""The settled motion of a diagram with parts that hide their equations: co-simulated, and extrapolated to its end.

`rotorsim.settled.periodic.periodic` hands such diagrams over.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorsim.cosim.coupled_run import coupling_of, rows_of
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import provenance
from rotorsim.model.compiled import Model
from rotorsim.settled.balance import harmonics_of
from rotorsim.settled.periodic import Channels
from rotorsim.settled.result import Periodic

# Periods that are run: doubled until what is extrapolated stays. From the last 12 of 24 terms ten modes are eliminated,
# five that swing, which are those of a flexible rotor in its bearings; after six doublings a run takes minutes.
FIRST_TURNS, MOST_TURNS = 24, 1536
# Of the largest harmonic of a channel, what may change from extrapolating earlier: a tenth of the error of a coupling
# of first order with 10 000 steps a period.
STAYS = 1e-5
KEPT = 1e-6  # of the largest harmonic of a channel: orders above all such are left out; a tenth of STAYS
# Of the change from period to period, how constant it is where a signal drifts: a transient like that would have a time
# constant of a million periods, and MOST_TURNS are run.
DRIFTS = 1e-6


@dataclass(frozen=True)
class _Settled:
    """Coefficients (H+1, channels) of orders 0..H; status; whether it is come to; periods that were run."""

    values: np.ndarray
    status: str
    stable: bool | None
    turns: int


def periodic_coupled(
    model: Model,
    names: Sequence[str] | None,
    speeds: np.ndarray,
    p: np.ndarray,
    parameters: Mapping[str, Any] | None,
    *,
    harmonics: int | None,
    subharmonic: int,
) -> Periodic:
    """Return the result that `periodic` returns, for speeds (n,) with parameters p (n, n_p).

    From rest, signals are exchanged m times a period as in `run`; the harmonics of each period make a sequence whose
    limit is extrapolated from its last terms (reduced rank extrapolation). ``provenance["coupling_error"]`` (n,): twice
    the difference to half the step, relative to the largest harmonic, worst channel; NaN where one of both has not
    settled. Raises RotorsimError, also for a step with which the coupling must diverge.
    Source: Sidi, Vector Extrapolation Methods with Applications (SIAM, 2017), ch. 1.
    """
    asked = names is not None
    wanted = model.record_names(names)
    found, finer, lost = [], [], set[str]()
    for speed, values in zip(speeds, p, strict=True):
        period = 2 * np.pi * subharmonic / speed
        m = max(int(np.ceil(period / model.diagram.solver.step - 1e-9)), 8)
        pair = []
        for parts in (1, 2):
            made, drifting = _settle(model, wanted, values, period, m * parts, m // 2, check=parts == 1)
            pair.append(made)
            if drifting and asked:
                what = "this signal does not return after one period: it has no harmonics"
                raise RotorsimError(*[Problem(what, name) for name in drifting])
            lost |= {*drifting}
        found.append(pair[0])
        finer.append(pair[1])
    channels = Channels(model, tuple(name for name in wanted if name not in lost))
    columns = _columns(model, wanted, channels)
    H = min(len(one.values) for one in found) - 1
    Y, Z = (np.stack([one.values[: H + 1][:, columns] for one in every]) for every in (found, finer))
    size = np.nan_to_num(np.abs(Y)).max(axis=1, keepdims=True, initial=0.0)  # largest harmonic, (n, 1, channels)
    scale = np.where(size > 0, size, np.inf)
    shares = np.nan_to_num(np.abs(Y) / scale)
    error = (np.abs(2 * (Y - Z)) / scale).max(axis=(1, 2), initial=0.0)  # NaN: there is none without both
    needed = np.flatnonzero((shares > KEPT).any(axis=(0, 2))).max(initial=1)
    kept_orders = int(min(H, needed if harmonics is None else harmonics))
    left = shares[:, kept_orders + 1 :].max(axis=(1, 2), initial=0.0)
    Y = Y[:, : kept_orders + 1]
    both = np.concatenate([Y[:, :0:-1].conj(), Y], axis=1)
    orders = np.arange(-kept_orders, kept_orders + 1)
    return Periodic(
        speeds=speeds,
        orders=orders if subharmonic == 1 else orders / subharmonic,
        harmonics=channels.signals(both),
        units=channels.units,
        status=tuple(one.status for one in found),
        stable=tuple(one.stable for one in found),
        truncation=left,
        truncation_error=np.zeros(len(speeds)),
        counters={"turns": max(one.turns for one in found)},
        provenance={
            **provenance(model, parameters, "periodic"),
            "method": "co-simulation, extrapolated",
            "harmonics": kept_orders,
            "turns": subharmonic,
            "coupling_error": error.tolist(),
        },
    )


def _settle(
    model: Model, names: Sequence[str], p: np.ndarray, period: float, m: int, H: int, *, check: bool
) -> tuple[_Settled, list[str]]:
    """Return the harmonics 0..H of the settled motion with m steps a period, and the signals that drift."""
    turns = FIRST_TURNS
    while True:
        result = coupling_of(model, names, p, step=period / m, stop=turns * period, check=check)
        count = sum(int(np.prod(model.shape_of(name), dtype=int)) for name in names)
        if result.status != "finished":
            nothing = np.full((H + 1, count), np.nan + 0j)
            return _Settled(nothing, f"failed: {result.message.partition(chr(10))[0]}", None, turns), []
        times = np.arange(turns * m) * (period / m)
        rows = rows_of(model, result, names, times, period / m).reshape(turns, m, count)
        drifting = _drifting(rows)
        Y = harmonics_of(rows[:, :, :], H)
        scale = np.abs(Y[-1]).max(axis=0)
        scale[(scale == 0) | drifting] = np.inf
        vectors = (Y / scale).reshape(turns, -1)
        limit, earlier = _limit(vectors[turns // 2 :]), _limit(vectors[turns // 4 : 3 * turns // 4])
        change = float(np.abs(limit - earlier).max(initial=0.0))
        if change <= STAYS or 2 * turns > MOST_TURNS:
            said = "settled" if change <= STAYS else f"failed: not settled after {turns} periods"
            scale[~np.isfinite(scale)] = 0.0
            values = limit.reshape(H + 1, count) * scale
            lost = np.repeat(names, [int(np.prod(model.shape_of(name), dtype=int)) for name in names])[drifting]
            if said != "settled":
                return _Settled(values * np.nan, said, None, turns), list(dict.fromkeys(lost))
            return _Settled(values, said, _comes_to(vectors, limit), turns), list(dict.fromkeys(lost))
        turns *= 2


def _drifting(rows: np.ndarray) -> np.ndarray:
    """Return which channels of rows (periods, m, channels) grow by the same in every period, as an angle does."""
    grown = np.diff(rows[-3:], axis=0).reshape(-1, rows.shape[2])
    mean = grown.mean(axis=0)
    return np.asarray((mean != 0) & (np.ptp(grown, axis=0) <= DRIFTS * np.abs(mean)))


def _limit(terms: np.ndarray) -> np.ndarray:
    """Return the limit of a sequence of vectors (n, size): the mean of its terms, with weights that sum up to 1,
    whose differences come nearest to zero."""
    steps = np.diff(terms, axis=0)
    n = len(steps)
    basis = np.diff(np.eye(n), axis=0)  # (n - 1, n): changes of the weights that keep their sum
    A = (basis @ steps).T
    system, right = np.concatenate([A.real, A.imag]), np.concatenate([steps[-1].real, steps[-1].imag])
    w = np.linalg.lstsq(system, -right, rcond=1e-12)[0]
    weights = np.eye(n)[-1] + w @ basis
    return np.asarray(weights @ terms[1:])


def _comes_to(vectors: np.ndarray, limit: np.ndarray) -> bool:
    """Return whether a sequence comes closer to its limit: that of one that grows is a motion that is never reached."""
    distance = np.abs(vectors - limit).max(axis=1, initial=0.0)
    half = len(distance) // 2
    return bool(distance[half:].max() <= max(distance[:half].max(), STAYS))


def _columns(model: Model, names: Sequence[str], channels: Channels) -> list[int]:
    """Return the columns of the channels among those of all names."""
    every = Channels(model, tuple(names)).names
    return [every.index(name) for name in channels.names]
