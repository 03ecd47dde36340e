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
from dataclasses import dataclass

import numpy as np

from rotorsim.identification.waveform.linearised import LinearisedRun, recursion

STRENGTHS = 10.0 ** np.arange(-2.0, 4.5, 0.5)  # of the signal, in noise of the outputs and root seconds; of
# nonlinear diagrams, whose filters change from sample to sample, every fourth
STRONGEST = 1e9  # that is tried while the strongest so far is the best: what two integrators attenuate is strong
RESPONSE_FREQUENCIES = 60  # at which the largest response to a signal is looked for
LEAST_RESPONSE = 1e-12  # of the largest of all places: what has less does not show
REGULAR = 1e-3  # of the noise, by states that are driven at every sample: what nothing drives has no steady filter
DOUBLINGS, CONVERGED = 60, 1e-12  # of the samples that a steady filter has seen, until nothing changes (relative)
CHUNK = 64  # samples whose innovations are kept at a time
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
    """A signal at a place in each run: added (N,) with its standard deviation std, and what all places carry (N, P)."""

    added: list[np.ndarray]
    std: list[np.ndarray]
    wires: list[np.ndarray]


@dataclass(frozen=True, eq=False)
class _Filter:
    """Filters of B hypotheses (place, strength): F (B, n, n), H (B, c, n), P (B, n, n), noise of unit variance.

    gain (B, n, c), root (B, c, c): inverse Cholesky factor of the variance of innovations; log_det (B,).
    """

    F: np.ndarray
    H: np.ndarray
    P: np.ndarray
    gain: np.ndarray
    root: np.ndarray
    log_det: np.ndarray

    @classmethod
    def of(cls, F: np.ndarray, H: np.ndarray, P: np.ndarray) -> _Filter:
        """Return the filters with prediction variances P."""
        V = H @ P @ H.swapaxes(1, 2) + np.eye(H.shape[1])
        L = np.linalg.cholesky(V)
        gain = F @ P @ np.linalg.solve(V, H).swapaxes(1, 2)
        log_det = 2 * np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
        return cls(F, H, P, gain, np.linalg.inv(L), log_det)


def _steady(F: np.ndarray, H: np.ndarray, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return P of P = F (P - P H^T (H P H^T + I)^-1 H P) F^T + Q for B hypotheses, and which have one, (B,).

    By doubling: after k steps it is that of 2^k samples. Source: E. K.-W. Chu et al., Int. J. Control 77 (2004) 767.
    """
    A, G, P = F.swapaxes(1, 2), H.swapaxes(1, 2) @ H, Q
    one, done = np.eye(F.shape[1]), np.zeros(len(F), bool)
    with np.errstate(all="ignore"):
        for _ in range(DOUBLINGS):
            W = np.where(np.isfinite(G).all(axis=(1, 2))[:, None, None], one + G @ P, one)
            WA, WG = np.linalg.solve(W, A), np.linalg.solve(W, G)
            more = A.swapaxes(1, 2) @ P @ WA
            A, G, P = A @ WA, G + A @ WG @ A.swapaxes(1, 2), P + (more + more.swapaxes(1, 2)) / 2
            done = np.abs(more).max(axis=(1, 2)) <= CONVERGED * np.abs(P).max(axis=(1, 2))
            if done.all():
                break
    found = done & np.isfinite(P).all(axis=(1, 2))
    V = H @ np.where(found[:, None, None], P, 0.0) @ H.swapaxes(1, 2) + np.eye(H.shape[1])
    return P, found & (np.linalg.eigvalsh(V).min(axis=1) > 0.5)  # 1 at least, but for rounding


@dataclass(frozen=True, eq=False)
class Whitening:
    """The steady or varying filter of one hypothesis along a run: signals (N, c, K) to innovations of unit variance.

    F (N or 1, n, n): of the predicted states, gain (N or 1, n, c), H (N or 1, c, n), root (N or 1, c, c). log_det: sum
    of the logarithms of their variances. noise (c,): of the outputs.
    """

    F: np.ndarray
    gain: np.ndarray
    H: np.ndarray
    root: np.ndarray
    log_det: float
    noise: np.ndarray

    def innovations(self, y: np.ndarray) -> np.ndarray:
        """Return the innovations (N, c, K) of signals at the outputs."""
        y = y / self.noise[:, None]
        return np.asarray(self.root @ (y - self.H @ recursion(self.F, self.gain, y)[:-1]))


class UnknownInputs:
    """Runs in which a signal is missing at one of P places; noise (c,): standard deviation of each output."""

    def __init__(self, runs: Sequence[LinearisedRun], noise: np.ndarray) -> None:
        self.runs, self.noise = runs, np.asarray(noise)
        F, G, H, D = (M.mean(axis=0) for M in (runs[0].F, runs[0].G, runs[0].H, runs[0].D))
        self.scales = self._scales(F, G, H, D)
        states = self._scales(F, np.eye(len(F)), H, np.zeros_like(H))
        self.regular = np.where(np.isfinite(states), REGULAR * states, 0.0) ** 2

    def _scales(self, F: np.ndarray, G: np.ndarray, H: np.ndarray, D: np.ndarray) -> np.ndarray:
        """Return the amplitudes of a sine whose largest response is the noise, infinite where none shows."""
        z = np.exp(2j * np.pi * np.geomspace(1 / len(self.runs[0].residual), 0.45, RESPONSE_FREQUENCIES))
        gains = H @ np.linalg.solve(z[:, None, None] * np.eye(len(F)) - F, G) + D
        size = np.sqrt((np.abs(gains / self.noise[:, None]) ** 2).sum(axis=1)).max(axis=0)
        shows = size > LEAST_RESPONSE * size.max(initial=0.0)
        return np.where(shows, 1 / np.where(shows, size, 1.0), np.inf)

    def estimates(self) -> list[SignalEstimate]:
        """Return the best free signal at every place that shows in the outputs, the likeliest first."""
        places = np.flatnonzero(np.isfinite(self.scales)).tolist()
        strengths = (STRENGTHS if all(run.constant for run in self.runs) else STRENGTHS[::4]).tolist()
        best: dict[int, SignalEstimate] = {}
        while places and strengths[-1] <= STRONGEST:
            sums, log_dets, kept = self._innovations([(place, q) for place in places for q in strengths])
            for (place, q), G, log_det in zip(kept, sums, log_dets, strict=True):
                change = np.linalg.lstsq(G[1:, 1:], G[1:, 0], rcond=INFORMATION_RANK)[0]
                misfit = float(G[0, 0] - G[0, 1:] @ change)
                found = SignalEstimate(place, misfit, misfit + float(log_det), q, float(self.scales[place]), change)
                if place not in best or found.deviance < best[place].deviance:
                    best[place] = found
            places = [place for place in places if place in best and best[place].strength == strengths[-1]]
            strengths = [strengths[-1] * strengths[-1] / strengths[-2]]
            strengths += [strengths[-1] * 10.0]
        return sorted(best.values(), key=lambda item: item.deviance)

    def _innovations(
        self, pairs: Sequence[tuple[int, float]]
    ) -> tuple[np.ndarray, np.ndarray, list[tuple[int, float]]]:
        """Return the products (B, 1 + m, 1 + m) of the innovations of residual and sensitivities, and log variances."""
        total: np.ndarray | float = 0.0
        log_dets: np.ndarray | float = 0.0
        kept = list(pairs)
        for run in self.runs:
            columns = self._columns(run)
            steady, here = self._started(run, kept)
            if len(here) < len(kept):  # without a steady filter in one run: none in all
                chosen = [kept.index(pair) for pair in here]
                total, log_dets = (np.asarray(part)[chosen] if np.ndim(part) else part for part in (total, log_dets))
                kept = here
            x = np.zeros((len(kept), steady.F.shape[1], columns.shape[2]))
            parts: list[np.ndarray] = []
            for k, y in enumerate(columns):
                if not run.constant and k:
                    steady = self._advanced(run, kept, steady, k)
                difference = y - steady.H @ x
                parts.append(steady.root @ difference)
                x = steady.F @ x + steady.gain @ difference
                log_dets = log_dets + steady.log_det
                if len(parts) == CHUNK or k == len(columns) - 1:
                    v = np.concatenate(parts, axis=1)
                    total, parts = total + v.swapaxes(1, 2) @ v, []
        return np.asarray(total), np.asarray(log_dets), kept

    def _columns(self, run: LinearisedRun) -> np.ndarray:
        """Return residual and derivatives of a run in units of the noise, (N, c, 1 + m)."""
        return np.asarray(np.concatenate([run.residual[:, :, None], run.by_output], axis=2) / self.noise[:, None])

    def _augmented(
        self, run: LinearisedRun, pairs: Sequence[tuple[int, float]], k: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return F, H and the variance Q of what enters, of x and d at sample k, for each pair."""
        n, B = run.F.shape[1], len(pairs)
        place = [place for place, _ in pairs]
        scale = self.scales[place]
        j = 0 if run.constant else k
        F, H = np.zeros((B, n + 1, n + 1)), np.zeros((B, run.H.shape[1], n + 1))
        F[:, :n, :n], F[:, :n, n], F[:, n, n] = run.F[j], (run.G[j][:, place] * scale).T, 1.0
        H[:, :, :n], H[:, :, n] = run.H[j] / self.noise[:, None], (run.D[j][:, place] * scale).T / self.noise
        Q = np.tile(np.diag([*self.regular, 0.0]), (B, 1, 1))
        Q[:, n, n] = np.array([q for _, q in pairs]) ** 2 * run.dt
        return F, H, Q

    def _started(
        self, run: LinearisedRun, pairs: Sequence[tuple[int, float]]
    ) -> tuple[_Filter, list[tuple[int, float]]]:
        """Return the steady filters of a run (of its first sample), and the pairs that have one."""
        F, H, Q = self._augmented(run, pairs, 0)
        P, steady = _steady(F, H, Q)
        kept = [pair for pair, has in zip(pairs, steady, strict=True) if has]
        return _Filter.of(F[steady], H[steady], P[steady]), kept

    def _advanced(self, run: LinearisedRun, pairs: Sequence[tuple[int, float]], before: _Filter, k: int) -> _Filter:
        """Return the filters of the next sample by the Riccati recursion."""
        F, H, Q = self._augmented(run, pairs, k)
        rest = before.F - before.gain @ before.H  # in the form of Joseph: a sum of squares stays one
        P = rest @ before.P @ rest.swapaxes(1, 2) + before.gain @ before.gain.swapaxes(1, 2) + Q
        return _Filter.of(F, H, (P + P.swapaxes(1, 2)) / 2)

    def whitening(self, place: int, strength: float) -> list[Whitening] | None:
        """Return the filters of a signal of some strength at a place in each run; None where there is none."""
        found = []
        for run in self.runs:
            pair = [(place, strength)]
            here, kept = self._started(run, pair)
            if not kept:
                return None
            filters = [here]
            for k in range(1, 1 if run.constant else len(run.residual)):
                filters.append(self._advanced(run, pair, filters[-1], k))
            gain, H, root = (np.concatenate([getattr(f, key) for f in filters]) for key in ("gain", "H", "root"))
            F = np.concatenate([f.F for f in filters]) - gain @ H
            log_det = sum(float(f.log_det[0]) for f in filters) * (len(run.residual) if run.constant else 1)
            found.append(Whitening(F, gain, H, root, log_det, self.noise))
        return found

    def smoothed(self, item: SignalEstimate) -> Smoothed:
        """Return the estimated signal at a place, given all samples of the runs."""
        added, std, wires = [], [], []
        for run in self.runs:
            pair = [(item.place, item.strength)]
            y = self._columns(run) @ np.concatenate([[1.0], -item.change])
            here, _ = self._started(run, pair)
            filters, predicted, innovations = [], [], []
            x = np.zeros(here.F.shape[1])
            for k, row in enumerate(y):
                here = here if run.constant or not k else self._advanced(run, pair, here, k)
                difference = row - here.H[0] @ x
                filters.append(here)
                predicted.append(x)
                innovations.append(here.root[0] @ difference)
                x = here.F[0] @ x + here.gain[0] @ difference
            r, N = np.zeros(len(x)), np.zeros((len(x), len(x)))
            states, spread = np.empty((len(y), len(x))), np.empty(len(y))
            for k in range(len(y) - 1, -1, -1):
                one = filters[k]
                rest, HL = one.F[0] - one.gain[0] @ one.H[0], one.H[0].T @ one.root[0].T
                r, N = rest.T @ r + HL @ innovations[k], rest.T @ N @ rest + HL @ HL.T
                states[k] = predicted[k] + one.P[0] @ r
                spread[k] = one.P[0][-1, -1] - one.P[0][-1] @ N @ one.P[0][-1]
            signal = states[:, -1] * item.scale
            carried = np.einsum("kpn,kn->kp", np.broadcast_to(run.W, (len(y), *run.W.shape[1:])), states[:, :-1])
            at_once = run.E[:, :, item.place] * signal[:, None] + run.by_wire @ item.change
            added.append(signal)
            std.append(np.sqrt(np.maximum(spread, 0.0)) * item.scale)
            wires.append(run.wires + carried + at_once)
        return Smoothed(added, std, wires)
