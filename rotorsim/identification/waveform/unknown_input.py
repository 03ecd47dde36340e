"""The unknown signal at a place that would explain what a diagram leaves, by Kalman filter and smoother.

x_(k+1) = F_k x_k + G_k d_k + 0,   d_(k+1) = d_k + w_k,  w ~ N(0, q^2 dt),   e_k = H_k x_k + D_k d_k + S_k theta + v_k

e: residual of the run; d: the unknown signal, a random walk whose strength q is that of greatest likelihood; theta:
changes of the free parameters, without a prior (the augmented filter of de Jong); v: noise of known variance. The
likelihood of the innovations says how well a free signal at that place explains all outputs of all runs.

Source: Kristensen, Madsen & Jorgensen, Automatica 40 (2004) 225-237; de Jong, Ann. Stat. 19 (1991) 1073-1083; Durbin
& Koopman, Time Series Analysis by State Space Methods (2012), 4.4 (smoothing) and 5.7 (augmented filter).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rotorsim.identification.waveform.linearised import LinearisedRun
from rotorsim.linear.kalman import Systems, Whitening

STRENGTHS = 10.0 ** np.arange(-2.0, 4.5, 0.5)  # of the signal, in noise of the outputs and root seconds; of
# nonlinear diagrams, whose filters change from sample to sample, every fourth
STRONGEST = 1e9  # that is tried while the strongest so far is the best: what two integrators attenuate is strong
RESPONSE_FREQUENCIES = 60  # at which the largest response to a signal is looked for
TIMES_FORGOTTEN = (1.0, 3.0, 10.0)  # times in a run that a signal is forgotten, where it has no steady filter else
FROZEN = 5  # samples of each run whose transfer vectors are compared
PARALLEL = 1e-9  # less than one: cosine between transfer vectors that are equal but for rounding
LEAST_RESPONSE = 1e-12  # of the largest of all places: what has less does not show
STATE_STRENGTHS = (0.1, 1.0, 10.0, 100.0)  # strengths of what drives all states, in noise of the outputs a sample
REGULAR = 1e-3  # of the noise, by states that are driven at every sample: what nothing drives has no steady filter
INFORMATION_RANK = 1e-12  # of the information on parameters


@dataclass(frozen=True, eq=False)
class SignalEstimate:
    """A free signal at one place. misfit: squares of innovations, in units of the noise; deviance: -2 log likelihood.

    scale: of the signal, so that its largest response in the outputs is their noise. strength: q of `STRENGTHS`.
    change (m,): of the free parameters.
    """

    place: int
    misfit: float
    deviance: float
    strength: float
    scale: float
    change: np.ndarray


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A signal at a place in each run: added (N,) with its standard deviation std, and what all places carry, wires."""

    place: int
    added: list[np.ndarray]
    std: list[np.ndarray]
    wires: list[np.ndarray]

    @property
    def wire(self) -> list[np.ndarray]:
        """What the place itself carries in each run, (N,)."""
        return [wires[:, self.place] for wires in self.wires]


def smoothed_motion(runs: Sequence[LinearisedRun], noise: np.ndarray) -> list[np.ndarray]:
    """Return the states (N, n) of each run, given all samples, where whatever is missing may drive every state.

    So much as is likeliest; noise (c,): standard deviation of each output. As simulated where there is no such filter.
    """
    return UnknownInputs(runs, noise).motion([Hypothesis(0, 0.0, strength) for strength in STATE_STRENGTHS])


class Hypothesis(NamedTuple):
    """A signal of some strength (q) is missing at a place; regular: what drives all states besides, in responses of the
    size of the noise at each sample."""

    place: int
    strength: float
    regular: float = REGULAR


class UnknownInputs:
    """Runs in which a signal is missing at one of P places; noise (c,): standard deviation of each output."""

    def __init__(self, runs: Sequence[LinearisedRun], noise: np.ndarray) -> None:
        self.runs, self.noise = runs, np.asarray(noise)
        F, G, H, D = (M.mean(axis=0) for M in (runs[0].F, runs[0].G, runs[0].H, runs[0].D))
        self.scales = self._scales(F, G, H, D)
        states = self._scales(F, np.eye(len(F)), H, np.zeros_like(H))
        self.states = np.where(np.isfinite(states), states, 0.0)

    def motion(self, items: Sequence[Hypothesis]) -> list[np.ndarray]:
        """Return the smoothed states (N, n) of each run by the likeliest of some; as simulated where none has a filter.

        The parameters stay as they are.
        """
        sums, log_dets, kept = self._innovations(items)
        deviances = sums[:, 0, 0] + log_dets if kept else np.array([np.inf])
        if not np.isfinite(deviances).any():
            return [run.states for run in self.runs]
        likeliest, weights = kept[int(np.nanargmin(deviances))], np.eye(1, 1 + self.runs[0].by_output.shape[2])
        of_runs = (self._smoothed(run, [likeliest], weights)[0] for run in self.runs)
        return [run.states + states[:, 0, :-1] for run, states in zip(self.runs, of_runs, strict=True)]

    def _scales(self, F: np.ndarray, G: np.ndarray, H: np.ndarray, D: np.ndarray) -> np.ndarray:
        """Return the amplitudes of a sine whose largest response is the noise, infinite where none shows."""
        size = np.linalg.norm(self._gains(F, G, H, D), axis=1).max(axis=0)
        shows = size > LEAST_RESPONSE * size.max(initial=0.0)
        return np.where(shows, 1 / np.where(shows, size, 1.0), np.inf)

    def _gains(self, F: np.ndarray, G: np.ndarray, H: np.ndarray, D: np.ndarray) -> np.ndarray:
        """Return what sines at the places make in the outputs, in their noise, (frequencies, c, places)."""
        z = np.exp(2j * np.pi * np.geomspace(1 / len(self.runs[0].residual), 0.45, RESPONSE_FREQUENCIES))
        answers = H @ np.linalg.solve(z[:, None, None] * np.eye(len(F)) - F, G) + D
        return np.asarray(answers / self.noise[:, None])

    def classes(self) -> list[list[int]]:
        """Return the places that show, those together whose signals change all outputs alike.

        So they do where their transfer vectors are parallel at every frequency, along all of the runs: what a signal at
        one explains, another signal at the other explains as well.
        """
        unit = []
        for run in self.runs:
            for k in np.unique(np.linspace(0, len(run.F) - 1, FROZEN).astype(int)):
                gains = self._gains(run.F[k], run.G[k], run.H[k], run.D[k])
                unit.append(gains / np.maximum(np.linalg.norm(gains, axis=1, keepdims=True), 1e-300))
        vectors = np.concatenate(unit)
        found: list[list[int]] = []
        for place in np.flatnonzero(np.isfinite(self.scales)).tolist():
            for others in found:
                aligned = np.abs((vectors[:, :, place].conj() * vectors[:, :, others[0]]).sum(axis=1))
                if (aligned > 1 - PARALLEL).all():
                    others.append(place)
                    break
            else:
                found.append([place])
        return found

    def estimates(self, places: Sequence[int] | None = None) -> list[SignalEstimate]:
        """Return the best free signal at every place (default: all) that shows in the outputs, the likeliest first."""
        places = [k for k in (range(len(self.scales)) if places is None else places) if np.isfinite(self.scales[k])]
        strengths = (STRENGTHS if all(run.constant for run in self.runs) else STRENGTHS[::4]).tolist()
        same: dict[int, list[int]] = {}
        for place, (first, _) in zip(places, self.proportional(places), strict=True):
            same.setdefault(first, []).append(place)
        best: dict[int, SignalEstimate] = {}
        left = [*same]
        while left and strengths[-1] <= STRONGEST:
            sums, log_dets, kept = self._innovations([Hypothesis(place, q) for place in left for q in strengths])
            for (place, q, _), G, log_det in zip(kept, sums, log_dets, strict=True):
                if not (np.isfinite(G).all() and np.isfinite(log_det)):
                    continue  # a filter that does not hold motion that grows overflows
                size = np.sqrt(np.maximum(np.diag(G)[1:], 0.0))  # or units decide what can be told
                size[size == 0] = 1.0
                scaled = np.linalg.lstsq(G[1:, 1:] / np.outer(size, size), G[1:, 0] / size, rcond=INFORMATION_RANK)
                change = scaled[0] / size
                misfit = float(G[0, 0] - G[0, 1:] @ change)
                found = SignalEstimate(place, misfit, misfit + float(log_det), q, float(self.scales[place]), change)
                if np.isfinite(found.deviance) and (place not in best or found.deviance < best[place].deviance):
                    best[place] = found
            left = [place for place in left if place in best and best[place].strength == strengths[-1]]
            strengths = [strengths[-1] * strengths[-1] / strengths[-2]]
            strengths += [strengths[-1] * 10.0]
        every = (replace(best[k], place=p, scale=float(self.scales[p])) for k in best for p in same[k])
        return sorted(every, key=lambda item: item.deviance)

    def proportional(self, places: Sequence[int]) -> list[tuple[int, float]]:
        """Return of each place the first that acts on states and outputs in proportion, and the factor of its signals.

        Signals that are larger by the factor than those at the first change the outputs as much; both are as likely.
        """
        enters = [np.concatenate([run.G, run.D], axis=1).reshape(-1, len(self.scales)) for run in self.runs]
        columns = np.concatenate(enters)[:, places]
        sizes = np.linalg.norm(columns, axis=0)
        unit = columns / np.where(sizes > 0, sizes, 1.0)
        found: list[tuple[int, float]] = []
        firsts: list[int] = []
        for k in range(len(places)):
            signs = np.sign(unit[:, firsts].T @ unit[:, k])
            off = np.abs(unit[:, firsts] * signs - unit[:, [k]]).max(axis=0, initial=0.0)
            near = off <= PARALLEL * np.abs(unit[:, k]).max(initial=0.0)
            if sizes[k] > 0 and near.any():
                n = int(np.argmax(near))
                found.append((places[firsts[n]], float(signs[n] * sizes[firsts[n]] / sizes[k])))
            else:
                firsts.append(k)
                found.append((places[k], 1.0))
        return found

    def _innovations(self, pairs: Sequence[Hypothesis]) -> tuple[np.ndarray, np.ndarray, list[Hypothesis]]:
        """Return the products (B, 1 + m, 1 + m) of the innovations of residual and sensitivities, and log variances."""
        kept, columns = list(pairs), 1 + self.runs[0].by_output.shape[2]
        total, log_dets = np.zeros((len(kept), columns, columns)), np.zeros(len(kept))
        for run in self.runs:
            systems, P, steady = self._started(run, kept, (0.0, *TIMES_FORGOTTEN))
            products, log_det = systems.of(steady).products(P[steady], self._columns(run))
            total, log_dets = total[steady] + products, log_dets[steady] + log_det
            kept = [pair for pair, found in zip(kept, steady, strict=True) if found]  # without one in one run: in none
        return total, log_dets, kept

    def _columns(self, run: LinearisedRun) -> np.ndarray:
        """Return residual and derivatives of a run in units of the noise, (N, c, 1 + m)."""
        return np.asarray(np.concatenate([run.residual[:, :, None], run.by_output], axis=2) / self.noise[:, None])

    def _systems(self, run: LinearisedRun, pairs: Sequence[Hypothesis], kept: np.ndarray) -> Systems:
        """Return a run with a signal for each pair, outputs in their noise; kept (B,): its part a sample later."""
        place = [item.place for item in pairs]
        scale = np.where(np.isfinite(self.scales[place]), self.scales[place], 0.0)  # what does not show drives nothing
        noise = self.noise[:, None]
        enters = [[*(item.regular * self.states) ** 2, item.strength**2 * run.dt] for item in pairs]
        G, D = run.G[:, :, place] * scale, run.D[:, :, place] * scale / noise
        return Systems(run.F, G, run.H / noise, D, kept, np.reshape(enters, (len(pairs), len(self.states) + 1)))

    def _started(
        self, run: LinearisedRun, pairs: Sequence[Hypothesis], times: Sequence[float]
    ) -> tuple[Systems, np.ndarray, np.ndarray]:
        """Return a run with a signal for each pair, the variances P of the steady filters, and which have one.

        times: in the run that a signal is forgotten; the first that leaves it a steady filter, else never.
        """
        size = len(self.states) + 1
        kept, P, found = np.ones(len(pairs)), np.zeros((len(pairs), size, size)), np.zeros(len(pairs), bool)
        for forgotten in times:
            left = np.flatnonzero(~found)
            part = np.full(len(left), np.exp(-forgotten / len(run.residual)))
            first, steady = self._systems(run, [pairs[k] for k in left.tolist()], part).steady()
            now = left[steady]
            kept[now], P[now], found[now] = part[steady], first[steady], True
            if found.all():
                break
        return self._systems(run, pairs, kept), P, found

    def whitening(self, place: int, strength: float) -> list[Whitening] | None:
        """Return the filters of a signal of some strength at a place in each run; None where there is none."""
        found = []
        for run in self.runs:
            systems, P, steady = self._started(run, [Hypothesis(place, strength)], (0.0, *TIMES_FORGOTTEN))
            if not steady.all():
                return None
            gain, root, [log_det] = systems.gains(P, len(run.residual))
            if not np.isfinite(log_det):
                return None
            gain, root = gain[:, 0], root[:, 0]
            F, H = (np.concatenate(parts) for parts in zip(*map(systems.augmented, range(len(gain))), strict=True))
            found.append(Whitening(F - gain @ H, gain, H, root, float(log_det), self.noise))
        return found

    def smoothed(self, items: Sequence[SignalEstimate]) -> list[Smoothed]:
        """Return the estimated signals of some places, each alone, given all samples of the runs.

        They are forgotten within a run (`TIMES_FORGOTTEN`): a constant that a state makes up for (an angle that nothing
        measures) is zero then, with the standard deviation that it may have.
        """
        pairs = [Hypothesis(item.place, item.strength) for item in items]
        weights = np.array([[1.0, *-item.change] for item in items])
        of_runs = [self._smoothed(run, pairs, weights) for run in self.runs]
        found = []
        for b, item in enumerate(items):
            added, std, wires = [], [], []
            for run, (states, spread) in zip(self.runs, of_runs, strict=True):
                signal = states[:, b, -1] * item.scale
                carried = (run.W @ states[:, b, :-1, None])[:, :, 0] + run.E[:, :, item.place] * signal[:, None]
                added.append(signal)
                std.append(np.sqrt(np.maximum(spread[:, b], 0.0)) * item.scale)
                wires.append(run.wires + carried + run.by_wire @ item.change)
            found.append(Smoothed(item.place, added, std, wires))
        return found

    def _smoothed(
        self, run: LinearisedRun, pairs: Sequence[Hypothesis], weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the smoothed states x and d (N, B, n + 1) of a run and the variance of d (N, B) for each pair."""
        systems, P, _ = self._started(run, pairs, TIMES_FORGOTTEN)
        states, spread = systems.smoothed(P, self._columns(run))
        return np.einsum("kbim,bm->kbi", states, weights), spread
