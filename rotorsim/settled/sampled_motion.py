"""Settled motion of linear diagrams with sampled blocks: exact, at every phase of the samplers against the shaft.

Forcing of order k, exp(i k W t), makes s_k(t) = p_k(t) exp(i k W t) with p_k periodic in the common period T of all
samplers (`rotorsim.linear.sampled_data`). Its mean over T is the harmonic R_k; the rest are images, k W + 2 pi j / T.
Where T and the turn have no common multiple the motion comes to every shaft angle at every phase of the samplers, so
that its largest value is that of sum p_k(t) exp(i k a) over all t and a; where they have one it is at most that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import matrix_balance

from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.drift import drifting_states, shift_of, shifts
from rotorsim.linear.exponentials import exponential
from rotorsim.linear.linear_model import LinearModel, LinearPart
from rotorsim.linear.linearisation import entry_names, state_names
from rotorsim.linear.loop import growing_poles, linear_part, sampled_data
from rotorsim.linear.sampled_data import SampledData, SettledMotion
from rotorsim.model.compiled import Model
from rotorsim.settled.equations import FIRST_SAMPLES, MOST_PERIOD_SAMPLES, RESOLVED
from rotorsim.settled.forcing import NOISE_MARGIN, PROBE, ZERO_COEFFICIENT, size_beyond

PARTS = 8  # of an interval between hits, at which the motion is looked at
ANGLES = 256  # of the shaft, as in `Periodic.time_history`
RETURNS = 1e-7  # relative: what differs by less one period later is the same
WHOLE_SAMPLES = 1e-6  # samples in a turn that are so near to a whole number make images that are orders
NO_MOTION = "failed: undamped resonance, the motion grows without bound"


@dataclass(frozen=True, eq=False)
class SampledMotion:
    """Harmonics Y (n, H+1, channels) of orders 0..H at n speeds; NaN: no motion. truncation (n,) as in `Periodic`.

    largest, images: signal -> (n,): largest magnitude of the motion, and of what it has beside its harmonics.
    """

    Y: np.ndarray
    truncation: np.ndarray
    status: tuple[str, ...]
    stable: tuple[bool | None, ...]
    drifting: tuple[str, ...]
    largest: Mapping[str, np.ndarray]
    images: Mapping[str, np.ndarray]
    samples: int


def sampled_motion(
    model: Model,
    names: Sequence[str],
    base: np.ndarray,
    given: Sequence[Mapping[str, Any]],
    signals: Callable[[np.ndarray], Mapping[str, np.ndarray]],
    *,
    harmonics: int | None = None,
    stability: bool = True,
    progress: Callable[[float], None] | None = None,
) -> SampledMotion:
    """Return the settled motion at base frequencies [rad/s] with parameters given for each.

    names: of the outputs; signals: harmonics of the channels at orders -H..H -> of signals by name.
    Raises RotorsimError where the diagram is not linear, has random signals, or forcing that jumps or does not return.
    """
    part = linear_part(model, (), names)
    _refuse_random(part)
    entries = _entries(model)
    found: list[_At] = []
    for speed, parameters in zip(base, given, strict=True):
        p = part.part.parameter_vector(parameters)
        linear = part.at(p)
        system = sampled_data(linear, model)
        forcing = _forcing(part, linear, p, float(speed), (entries[: len(linear.A)], names))
        found.append(_at(system, forcing, float(speed), signals, stability))
        if progress is not None:
            progress(len(found) / len(base))
    count = max(len(one.Y) for one in found)
    H = count - 1 if harmonics is None else harmonics
    Y = np.stack([np.pad(one.Y, ((0, max(count, H + 1) - len(one.Y)), (0, 0))) for one in found])
    seeds = sorted({k for one in found for k in one.seeds})
    return SampledMotion(
        Y=Y[:, : H + 1],
        truncation=size_beyond(Y, H),
        status=tuple(one.status for one in found),
        stable=tuple(one.stable for one in found),
        drifting=tuple(entries[k] for k in seeds if k < len(entries)),
        largest={name: np.array([one.largest[name] for one in found]) for name in found[0].largest},
        images={name: np.array([one.images[name] for one in found]) for name in found[0].images},
        samples=max(one.samples for one in found),
    )


def sampled_start(model: Model, base: float, parameters: Mapping[str, Any] | None = None) -> np.ndarray:
    """Return the states (n_x + n_z,) of the settled motion at t = 0, those of sampled blocks before their hit there.

    Whatever samples are in a turn. Before its hits at t = 0 the motion is s(0) = s_0 + 2 Re sum_k before_k, (1 - M) s_0
    = what constant forcing adds in a period, but for what that makes grow. States that nothing returns are where a
    run from the start of the diagram would have brought them: W' s, W' M = W', only follows what drives it.

    Raises RotorsimError as `sampled_motion`, where the motion grows, and where it is not stable.
    """
    part = linear_part(model, (), ())
    _refuse_random(part)
    p = part.part.parameter_vector(parameters)
    linear = part.at(p)
    system, entries = sampled_data(linear, model), _entries(model)
    forcing = _forcing(part, linear, p, base, (entries, ()))
    name = model.diagram.name
    if len(growing_poles(system)):
        what = "its settled motion is not stable: no run stays there"
        raise RotorsimError(Problem(what, name, hint="`rotorsim modes` shows what grows"), exit_code=1)
    turning = np.zeros(len(linear.A))
    for k in (np.flatnonzero(np.any(forcing.rates[1:] != 0, axis=1) | _any_jump(forcing)) + 1).tolist():
        turning += 2 * _at_order(system, forcing, k, 1j * k * base).before[..., 0].mean(axis=0).real
    if not np.isfinite(turning).all():
        raise RotorsimError(Problem(f"no settled motion: {NO_MOTION}", name), exit_code=1)
    return _from_start(system, forcing, turning, np.concatenate(part.part.initial(p)), name)


def _from_start(
    system: SampledData, forcing: _Forcing, turning: np.ndarray, start: np.ndarray, name: str
) -> np.ndarray:
    """Return the states at t = 0 of a motion that turns, with its mean, and where a start would have brought it."""
    n, M = len(turning), system.monodromy
    added = _a_period(system, forcing, _with_means(system, forcing))[0][:n, n]
    scale = matrix_balance(M, permute=False, separate=True)[1][0]
    N, W = shifts(M - np.eye(n), 1.0)
    grows = shift_of(W.T @ added, N, W)  # in a period, and does not return
    if (np.abs(W.T @ (added - grows)) > RETURNS * (np.abs(W.T) @ np.abs(added))).any():
        what = "no settled motion: constant forcing drives what nothing returns, faster from turn to turn"
        raise RotorsimError(Problem(what, name, hint="`rotorsim run` it without a settled start"), exit_code=1)
    own = (np.eye(n) - M) * scale / scale[:, None]
    bordered = np.block([[own, W * scale[:, None]], [(N / scale[:, None]).T, np.zeros((N.shape[1],) * 2)]])
    rest = np.linalg.solve(bordered, np.append((added - grows) / scale, np.zeros(N.shape[1])))[:n] * scale
    states = turning + rest
    return np.asarray(states + shift_of(W.T @ (start - states), N, W))


def _entries(model: Model) -> list[str]:
    """Return the names of the states, entry by entry, of sampled blocks behind the others."""
    held = model.trace.discrete_states.values()
    return [*state_names(model), *(name for state in held for name in entry_names(state.name, state.shape))]


def _refuse_random(part: LinearPart) -> None:
    drawing = [sampler.block for sampler in part.part.trace.samplers if sampler.draws.stop > sampler.draws.start]
    if drawing:
        hint = "leave it out: --without, or `rotorsim run` and `rotorsim spectrum`"
        raise RotorsimError(*(Problem("random signals have no settled motion", block, hint=hint) for block in drawing))


@dataclass(frozen=True, eq=False)
class _Forcing:
    """Coefficients of orders 0..H: of rates (H+1, n), of outputs (H+1, c), and of the jumps at each hit (H+1, n)."""

    rates: np.ndarray
    outputs: np.ndarray
    jumps: tuple[np.ndarray, ...]
    samples: int


def _forcing(
    part: LinearPart, linear: LinearModel, p: np.ndarray, base: float, names: tuple[Sequence[str], Sequence[str]]
) -> _Forcing:
    """Return the Fourier coefficients of what drives the diagram, of as many samples of a turn as it takes.

    names: of states and outputs. Entries of one vector have one unit, and the rounding of the largest of them: gravity
    makes that of an unbalance.
    """
    hits = linear.period_hits()
    kinds = list(dict.fromkeys(linear.due(t) for t in hits))
    turn, n = 2 * np.pi / base, len(linear.A)
    vectors = [name.partition("[")[0] for name in (*names[0], *names[1])]
    vectors += [f"{name} at a hit of {due}" for due in kinds for name in vectors[:n]]
    of_vector = np.unique(vectors, return_inverse=True)[1]

    def driving(times: np.ndarray) -> np.ndarray:
        return np.concatenate([*part.forcing(p, times), *(part.forcing_at_hit(p, times, due) for due in kinds)], axis=1)

    probed = driving(turn * np.array([PROBE, 1 + PROBE]))
    returned = np.zeros(of_vector.max() + 1)
    np.maximum.at(returned, of_vector, np.abs(probed).max(axis=0))
    changed = np.abs(probed[1] - probed[0]) > RETURNS * returned[of_vector]
    if changed.any():
        what = f"the forcing at {base:.6g} rad/s is not the same one period later: the motion is not periodic"
        hint = "use a constant speed; for a longer period give its number of turns (subharmonic)"
        raise RotorsimError(Problem(what, part.part.diagram.name, hint=hint))
    m = FIRST_SAMPLES
    while True:
        F = np.fft.rfft(driving(turn * np.arange(m) / m), axis=0)[: m // 2] / m
        size, largest = np.abs(F), np.abs(F).max(axis=0)
        units = np.zeros(of_vector.max() + 1)
        np.maximum.at(units, of_vector, largest)
        rounding = ZERO_COEFFICIENT * units[of_vector]
        wave = np.exp(2j * np.pi * PROBE * np.arange(m // 2))
        wave[1:] *= 2
        error = np.abs((wave @ F).real - probed[0])
        tail = np.all(size[3 * m // 8 :] <= np.maximum(RESOLVED * largest, rounding))
        ended = bool(tail and np.all(error <= np.maximum(1e-9 * largest, m * rounding)))
        if ended or m >= MOST_PERIOD_SAMPLES:
            break
        m *= 2
    if not ended:
        what = f"forcing with jumps or corners, of more than {m // 2} orders: with sampled blocks it is not told"
        raise RotorsimError(Problem(what, part.part.diagram.name, hint="`rotorsim run` it until it has settled"))
    F[size <= np.maximum(rounding, NOISE_MARGIN * size[3 * m // 8 :].max(axis=0))] = 0.0
    F = F[: int(np.flatnonzero(np.any(F != 0, axis=1)).max(initial=0)) + 1]
    c = len(linear.C)
    by_kind = {due: F[:, n + c + k * n : n + c + (k + 1) * n] for k, due in enumerate(kinds)}
    return _Forcing(F[:, :n], F[:, n : n + c], tuple(by_kind[linear.due(t)] for t in hits), m)


@dataclass(frozen=True, eq=False)
class _At:
    Y: np.ndarray
    status: str
    stable: bool | None
    seeds: list[int]
    largest: Mapping[str, float]
    images: Mapping[str, float]
    samples: int


def _at(
    system: SampledData,
    forcing: _Forcing,
    base: float,
    signals: Callable[[np.ndarray], Mapping[str, np.ndarray]],
    stability: bool,
) -> _At:
    """Return the motion at one speed. Along the period of the samplers: harmonics that change with the phase."""
    (count, c), n = forcing.outputs.shape, len(system.flow.A)
    steps = _with_means(system, forcing)
    along = np.zeros((len(steps) * (PARTS + 1), count, c), complex)
    Y = np.zeros((count, c), complex)
    Y[0], along[:, 0], seeds = _rest(system, forcing, steps)
    with np.errstate(all="ignore"):
        for k in (np.flatnonzero(np.any(forcing.rates[1:] != 0, axis=1) | _any_jump(forcing)) + 1).tolist():
            Y[k], along[:, k] = _turning(system, forcing, k, 1j * k * base, [step[:n, :n] for step in steps])
    Y[1:] += forcing.outputs[1:]
    along[:, 1:] += forcing.outputs[1:]
    status = "settled" if np.isfinite(Y[1:]).all() else NO_MOTION
    stable = not len(growing_poles(system)) if stability else None
    if status != "settled":
        Y[:], along[:] = np.nan, np.nan
    elif stable is False:
        status = "unstable: a disturbance of this motion grows"
    at_all = np.concatenate([along[:, :0:-1].conj(), along], axis=1)
    means = np.concatenate([Y[:0:-1].conj(), Y])[None]
    waves = np.exp(1j * np.outer(np.arange(-count + 1, count), np.arange(ANGLES) * (2 * np.pi / ANGLES)))
    largest, images = {}, {}
    mean_by_name = signals(means)
    for name, values in signals(at_all).items():
        drifts = ~np.isfinite(values[:, count - 1]).all()  # the motion of what drifts is told without its mean
        if drifts and status != NO_MOTION:
            values = values.copy()
            values[:, count - 1] = 0.0
        mean = np.where(np.isfinite(mean_by_name[name]), mean_by_name[name], 0.0)
        largest[name] = float(np.abs(values @ waves).max())
        images[name] = float(np.abs((values - mean) @ waves).max())
    in_a_turn = 2 * np.pi / (base * system.shortest)
    if status == "settled" and abs(in_a_turn - round(in_a_turn)) < WHOLE_SAMPLES * in_a_turn and in_a_turn < 2 * count:
        status += f"; {round(in_a_turn)} samples in a period: images fall on its orders, and are not counted there"
    return _At(Y, status, stable, seeds, largest, images, forcing.samples)


def _any_jump(forcing: _Forcing) -> np.ndarray:
    return np.asarray(np.any([np.any(K[1:] != 0, axis=1) for K in forcing.jumps], axis=0))


def _lengths(system: SampledData) -> list[float]:
    return [float(length) for length in system.lengths]


def _turning(
    system: SampledData, forcing: _Forcing, k: int, s: complex, steps: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the harmonic (c,) of the outputs at s = i k W, and the same at every phase of the samplers (parts, c)."""
    motion = _at_order(system, forcing, k, s)
    at, C, found = motion.s, system.flow.C, []
    for start, length, after, step in zip(system.times, _lengths(system), motion.after, steps, strict=True):
        xi = after - motion.R * np.exp(at * start)[:, None, None]
        for part in range(PARTS + 1):
            back = np.exp(-at * (start + part * length / PARTS))[:, None, None]
            found.append((C @ (motion.R + xi * back))[..., 0].mean(axis=0))
            xi = step @ xi
    return (C @ motion.mean)[..., 0].mean(axis=0), np.array(found)


def _at_order(system: SampledData, forcing: _Forcing, k: int, s: complex) -> SettledMotion:
    """Return the motion of order k at s = i k W."""
    at = system.clear_of_poles(s)
    B = np.broadcast_to(forcing.rates[k, :, None], (len(at), *forcing.rates[k, :, None].shape))
    return system.motion(at, B, [K[None, k, :, None] for K in forcing.jumps])


def _with_means(system: SampledData, forcing: _Forcing) -> list[np.ndarray]:
    """Return exp(A h / `PARTS`) of each interval, of a system with two more kinds of states.

    They are 1, which carries what is constant, and the integrals of the outputs.
    """
    (c, n), b, d = system.flow.C.shape, forcing.rates[0].real, forcing.outputs[0].real
    A = np.block(
        [
            [system.flow.A, b[:, None], np.zeros((n, c))],
            [np.zeros((1, n + 1 + c))],
            [system.flow.C, d[:, None], np.zeros((c, c))],
        ]
    )
    made = {f"{length:.9e}": length for length in _lengths(system)}
    known = {key: exponential(A, length / PARTS) for key, length in made.items()}
    return [known[f"{length:.9e}"] for length in _lengths(system)]


def _a_period(
    system: SampledData, forcing: _Forcing, steps: Sequence[np.ndarray]
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return by what these states change in a period of the samplers, and at each hit, of what is constant."""
    n, turn, jumps = len(system.flow.A), np.eye(len(steps[0])), []
    for (J, _), K, step in zip(system.jumps, forcing.jumps, steps, strict=True):
        whole = np.eye(len(turn))
        whole[:n, :n], whole[:n, n] = J, K[0].real
        jumps.append(whole)
        turn = np.linalg.matrix_power(step, PARTS) @ whole @ turn
    return turn, jumps


def _rest(
    system: SampledData, forcing: _Forcing, steps: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return the means (c,) of the outputs, their values at every phase of the samplers, and states that drift."""
    (c, n), d = system.flow.C.shape, forcing.outputs[0].real
    pattern = (system.flow.A != 0) | np.any([np.eye(n) != J for J, _ in system.jumps], axis=0)
    M = system.monodromy
    seeds, held = drifting_states(M - np.eye(n), pattern, 1.0)
    turn, jumps = _a_period(system, forcing, steps)
    free = np.setdiff1d(np.arange(n), held)
    state = np.zeros(n + 1 + c)
    state[n] = 1.0
    state[free] = np.linalg.solve(np.eye(len(free)) - M[np.ix_(free, free)], turn[free, n])
    found = []
    for jump, step in zip(jumps, steps, strict=True):
        state = jump @ state
        for part in range(PARTS + 1):
            found.append(system.flow.C @ state[:n] + d)
            state = step @ state if part < PARTS else state
    mean, along = state[n + 1 :] / system.period, np.array(found)
    lost = np.any(system.flow.C[:, held] != 0, axis=1)
    mean[lost], along[:, lost] = np.nan, np.nan
    return mean, along, seeds
