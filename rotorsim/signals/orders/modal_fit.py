"""Modes along a run that passes their critical speeds, fitted to its order vectors: variable projection.

Source: D. J. Ewins, Modal Testing (2000), ch. 4; G. Golub & V. Pereyra, Inverse Problems 19 (2003) R1;
F. M. Dimentberg, Flexural Vibrations of Rotating Shafts (1961), ch. 4 (passage through resonance).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from math import log, pi

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.orders import OrderChannel, OrderRun
from rotorsim.signals.orders.rows import row_noise, row_times, slowness
from rotorsim.signals.pickup import MAINS

SEARCH_EVALUATIONS = 50  # of one search
MODES_CONVERGED = 1e-7  # of the misfit: of 10^4 rows a thousandth of what one standard deviation changes
STEPS_OF_TURN = 8  # of what turns with the shaft next to nothing changes in a part of one
SAME_SHAPE = 0.9  # modal assurance criterion, from which two shapes are one; Allemang, Sound & Vib. 37 (2003) 14
START_SPEEDS = 40  # over the run, from which a mode is looked for
FIRST_DAMPING = (0.01, 0.05)
LEAST_DAMPING, MOST_DAMPING = 1e-4, 0.7
WORTH_TOGETHER = 64  # steps: fewer are faster one by one
PRODUCT = 1e-6  # of decays over steps that are taken together: ten digits are left of what is divided by it
LEAKS = 1e-3  # of the rms of the largest order of a channel: what tracking leaves of it in others at most
BELIEVED = 1e-3  # of the rms of a channel: noise below is not believed
NOISY = 2.0  # times the square that noise alone leaves in a direction


@dataclass(frozen=True, eq=False)
class PassedRun:
    """Vectors (n, c) over their noise, on a grid of times (N,) with the speed and force between them.

    acceleration [rad/s^2], as speed; angle (N,); ends (n, 2): angles where rows begin and end; rows (n,): their speeds.
    """

    names: list[str]
    vectors: np.ndarray
    noise: np.ndarray
    time: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    angle: np.ndarray
    ends: np.ndarray
    rows: np.ndarray
    order: int

    @classmethod
    def of(cls, run: OrderRun, channels: Mapping[str, OrderChannel], order: int) -> PassedRun:
        """Return the vectors of one order of a run, over the noise of their rows, or what leaks from other orders."""
        known, noise, names = [], [], [name for name, one in channels.items() if one.order == order]
        names = [name for name in names if np.isfinite(run.vectors[name]).any()]
        for name in names:
            place = channels[name].name
            beside = [run.vectors[other] for other, one in channels.items() if one.name == place]
            found = row_noise([run.vectors[name]], BELIEVED)
            if found is None:
                hint = "seven rows one after another, of this channel"
                raise RotorsimError(Problem("too many rows are missing to tell noise from motion", name, hint=hint))
            leaks = max(float(np.nanmean(np.abs(y) ** 2)) for y in beside if np.isfinite(y).any()) * LEAKS**2 / 2
            known.append(run.vectors[name])
            noise.append(np.sqrt(max(found, leaks)))
        rows = row_times(run)
        turned = float(rows.angle(rows.end) - rows.angle(rows.begin))
        time = np.linspace(rows.begin, rows.end, max(int(turned / (2 * pi) * STEPS_OF_TURN), 2) + 1)
        angle = np.asarray(rows.angle(time) - rows.angle(rows.begin))
        middle = (time[1:] + time[:-1]) / 2
        acceleration = np.diff(np.asarray(rows.speed(time))) / np.diff(time)
        ends = np.stack([rows.starts, rows.starts + 2 * pi * run.turns], axis=1)
        vectors = np.stack(known, axis=1) / np.array(noise)
        return cls(
            names,
            vectors,
            np.array(noise),
            time,
            np.asarray(rows.speed(middle)),
            acceleration,
            angle,
            ends,
            run.speed,
            order,
        )

    @cached_property
    def compressed(self) -> PassedRun:
        """The directions of all channels together in which there is more than noise: they cost the search as much less.

        Factors of each channel are free, so that cost is the same for channels turned among each other.
        """
        if len(self.masks) > 1:
            return self
        _, s, V = np.linalg.svd(self.vectors[self.masks[0][0]], full_matrices=False)
        kept = max(int((s**2 > NOISY * 2 * len(self.rows)).sum()), 1)
        turned = self.vectors @ V[:kept].conj().T
        return replace(self, names=self.names[:kept], vectors=turned, noise=np.ones(kept))

    @cached_property
    def masks(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Rows that were measured, and the channels of which just these were."""
        there = np.isfinite(self.vectors)
        kinds, which = np.unique(there, axis=1, return_inverse=True)
        return [(np.flatnonzero(kind), np.flatnonzero(which == k)) for k, kind in enumerate(kinds.T)]

    @cached_property
    def _known(self) -> dict[tuple[float, float], np.ndarray]:
        return {}

    @cached_property
    def smooth(self) -> np.ndarray:
        """What is no mode in the run: slow roll, pick-up of the mains, and modes far below and above, (n, j).

        Those are g / W^2, g and g W^2, one of which is constant, as slow roll is: the first column.
        """
        turn = np.exp(-1j * self.order * self.angle)
        columns = [np.ones(len(self.rows), complex)]
        columns += [self.averaged(np.exp(2j * pi * f * self.time) * turn) for f in MAINS]
        return np.stack([*columns, *self.far(self.rows).T], axis=1)

    def far(self, speed: np.ndarray) -> np.ndarray:
        """Return the responses of modes far below and above at constant speeds, but for a constant, (n, 2)."""
        square = (speed / self.rows.max()) ** 2
        return np.stack([square, square**2] if self.order == 1 else [1 / square, square], axis=1)

    @property
    def force(self) -> np.ndarray:
        """g between the times, (N - 1,)."""
        return self.speed**2 - 1j * self.acceleration if self.order == 1 else np.ones(len(self.speed), complex)

    def averaged(self, values: np.ndarray) -> np.ndarray:
        """Return values (N,) on the grid averaged over the angle of each row, (n,)."""
        whole = CubicSpline(self.angle, values).antiderivative()(self.ends)
        return np.asarray((whole[:, 1] - whole[:, 0]) / (self.ends[:, 1] - self.ends[:, 0]))

    def mode(self, w: float, z: float) -> np.ndarray:
        """Return the vectors of one mode along the run, (n,)."""
        if (w, z) not in self._known:
            s = complex(-z, np.sqrt(1 - z**2)) * w
            self._known[w, z] = self.averaged((self._moved(s) - self._moved(s.conjugate())) / (2j * s.imag))
        return self._known[w, z]

    def settled_mode(self, w: float, z: float) -> np.ndarray:
        """Return the vectors that one mode would have at constant speeds, (n,)."""
        W = self.order * self.rows
        return (self.rows**2 if self.order == 1 else 1.0) / (w**2 - W**2 + 2j * z * w * W)

    def _moved(self, s: complex) -> np.ndarray:
        """Return a on the grid (N,): a' = (s - i k W) a + g, settled where it begins.

        a_j = P_j (a_0 + sum_i d_i / P_i), P the product of all factors, over as many steps as it stays above PRODUCT.
        """
        lam = s - 1j * self.order * self.speed
        exponent = lam * np.diff(self.time)
        driven = np.expm1(exponent) / lam * self.force
        decay = max(float(-exponent.real.min()), 1e-300)
        length = int(np.clip(-log(PRODUCT) / decay, 1, len(exponent)))
        out = np.empty(len(self.time), complex)
        out[0] = a = -self.force[0] / lam[0]
        if length < WORTH_TOGETHER:
            for k, (factor, add) in enumerate(zip(np.exp(exponent).tolist(), driven.tolist(), strict=True), start=1):
                out[k] = a = factor * a + add
            return out
        for first in range(0, len(exponent), length):
            part = slice(first, min(first + length, len(exponent)))
            product = np.exp(np.cumsum(exponent[part]))
            out[part.start + 1 : part.stop + 1] = product * (out[first] + np.cumsum(driven[part] / product))
        return out


class ModalFit:
    """Vectors as modes (j, 2) of w and z, with the linear factors at their best."""

    def __init__(self, data: PassedRun, modes: np.ndarray, shapes: np.ndarray | None = None) -> None:
        self.data, self.modes = data, modes
        self.columns = np.column_stack([*(data.mode(w, z) for w, z in modes), data.smooth])
        self.factors = np.zeros((self.columns.shape[1], len(data.names)), complex)
        self.left: list[np.ndarray] = []
        size = np.maximum(np.linalg.norm(self.columns, axis=0), 1e-300)
        for there, channels in data.masks:
            y = data.vectors[np.ix_(there, channels)]
            found = np.linalg.lstsq(self.columns[there] / size, y, rcond=None)[0] / size[:, None]
            self.factors[:, channels] = found
            self.left += [*(y - self.columns[there] @ found).T]
        self.residual = np.concatenate([np.concatenate([e.real, e.imag]) for e in self.left])

    @property
    def has_twins(self) -> bool:
        """Whether two modes within their bandwidths have the same shape, so that they are one that is not quite so."""
        for j, k in combinations(range(len(self.modes)), 2):
            near = abs(self.modes[j, 0] - self.modes[k, 0]) < 2 * self.modes[[j, k]].prod(axis=1).max()
            a, b = self.factors[[j, k]]
            mac = abs(np.vdot(a, b)) ** 2 / max(float(np.vdot(a, a).real * np.vdot(b, b).real), 1e-300)
            if near and mac > SAME_SHAPE:
                return True
        return False

    @property
    def unknowns(self) -> int:
        """The number of real unknowns."""
        return int(self.modes.size + 2 * self.factors.size)

    def gain(self, fewer: ModalFit) -> float:
        """Return by how much the Bayesian information criterion is lower than that of a fit with fewer modes.

        Noise is of unknown size, but not below that between rows; rows count by what this fit leaves (`slowness`).
        """
        n = len(self.residual) / slowness(self.left)
        here, there = (max(float((fit.residual**2).mean()), 1.0) for fit in (self, fewer))
        return n * log(there / here) - (self.unknowns - fewer.unknowns) * log(max(n, 2.0))


def with_one_more(run: PassedRun, fit: ModalFit) -> ModalFit:
    """Return the best fit with one more mode, from the place on a grid where that leaves least."""
    low, high = run.order * float(run.rows.min()), run.order * float(run.rows.max())
    few = run.compressed

    def cost(mode: tuple[float, float]) -> float:
        trial = ModalFit(few, np.vstack([fit.modes, mode]))
        return float(trial.residual @ trial.residual)

    first = min(product(np.linspace(low, high, START_SPEEDS).tolist(), FIRST_DAMPING), key=cost)
    start = np.vstack([fit.modes, first])
    start[:, 1] = np.log(start[:, 1])
    least = np.array([0.5 * low, log(LEAST_DAMPING)] * len(start))
    most = np.array([1.5 * high, log(MOST_DAMPING)] * len(start))

    def residual(q: np.ndarray) -> np.ndarray:
        return ModalFit(few, _unfolded(q)).residual

    begin = np.clip(start.ravel(), least, most)
    found = least_squares(
        residual, begin, bounds=(least, most), x_scale=_scale(start), max_nfev=SEARCH_EVALUATIONS, ftol=MODES_CONVERGED
    )
    return ModalFit(run, _unfolded(found.x))


def _unfolded(q: np.ndarray) -> np.ndarray:
    modes = q.reshape(-1, 2).copy()
    modes[:, 1] = np.exp(modes[:, 1])
    return modes


def _scale(start: np.ndarray) -> np.ndarray:
    """Return the size of a step: a bandwidth, and a factor of the damping."""
    return np.stack([start[:, 0] * np.exp(start[:, 1]), np.ones(len(start))], axis=1).ravel()


def covariance_of(data: PassedRun, fit: ModalFit) -> np.ndarray:
    """Return the covariance of w and z of all modes for noise of variance one, the linear factors being free."""
    columns = []
    for j in range(len(fit.modes)):
        for which, step in ((0, 1e-4 * fit.modes[j].prod()), (1, 1e-4 * fit.modes[j, 1])):
            ends = []
            for sign in (1, -1):
                moved = fit.modes.copy()
                moved[j, which] += sign * step
                ends.append(ModalFit(data, moved).residual)
            columns.append((ends[0] - ends[1]) / (2 * step))
    J = np.stack(columns, axis=1)
    size = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    return np.asarray(np.linalg.pinv((J / size).T @ (J / size), hermitian=True) / np.outer(size, size))
