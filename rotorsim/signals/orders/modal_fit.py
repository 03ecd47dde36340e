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
from rotorsim.signals.orders.resonance import settled_response
from rotorsim.signals.orders.rows import row_noise, row_times, slowness
from rotorsim.signals.pickup import MAINS

SEARCH_EVALUATIONS = 50  # of one search
MODES_CONVERGED = 1e-7  # of the misfit: of 10^4 rows a thousandth of what one standard deviation changes
STEPS_OF_TURN = 8  # of what turns with the shaft next to nothing changes in a part of one
SAME_SHAPE = 0.9  # modal assurance criterion, from which two shapes are one; Allemang, Sound & Vib. 37 (2003) 14
START_SPEEDS = 40  # over the run, from which a mode is looked for
FIRST_DAMPING = (0.01, 0.05)
LEAST_DAMPING, MOST_DAMPING = 1e-4, 0.7
MOST_SLOPE = 0.9  # of a natural frequency over the order's: at one they would never meet
WORTH_TOGETHER = 64  # steps: fewer are faster one by one
PRODUCT = 1e-6  # of decays over steps that are taken together: ten digits are left of what is divided by it
MOST_STEPS = 200_000  # of a run: 25 000 turns, in which the speed changes by next to nothing in a bandwidth
LEAKS = 1e-3  # of the rms of the largest order of a channel: what tracking leaves of it in others at most
NOISY = 2.0  # times the square that noise alone leaves in a direction


@dataclass(frozen=True, eq=False)
class PassedRun:
    """Vectors (n, c) over their noise, on a grid of times (N,) with the speed and force between them.

    noise (c,): standard deviation of their real parts. least: of the square of what is left, over that of noise, what
    counts as none, since so much may leak. acceleration [rad/s^2], as speed; angle (N,); ends (n, 2): angles where rows
    begin and end; rows (n,): their speeds. is_slow: so many turns that the motion is taken as settled in each row.
    """

    names: list[str]
    vectors: np.ndarray
    noise: np.ndarray
    least: float
    time: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    angle: np.ndarray
    ends: np.ndarray
    rows: np.ndarray
    order: int
    is_slow: bool

    @classmethod
    def of(cls, run: OrderRun, channels: Mapping[str, OrderChannel], order: int) -> PassedRun:
        """Return the vectors of one order of a run over the noise of their rows.

        Raises RotorsimError where no channel has as many rows without a gap that noise is seen, or where the times of
        a table contradict its speeds.
        """
        names = [name for name, one in channels.items() if one.order == order and name in run.vectors]
        noise, floors = {}, {}
        for name in names:
            found = row_noise([run.vectors[name]]) if run.noise is None else run.noise[name]
            if found is not None:
                beside = [
                    run.vectors[k]
                    for k, one in channels.items()
                    if one.name == channels[name].name and k in run.vectors
                ]
                largest = max(float(np.nanmean(np.abs(y) ** 2)) for y in beside if np.isfinite(y).any())
                floors[name] = max(LEAKS**2 / 2 * largest, 1e-300)
                noise[name] = max(found, floors[name])
        if not noise:
            what, hint = "too many rows are missing to tell noise from motion", "seven rows one after another"
            raise RotorsimError(Problem(what, f"run {run.id}, {order}X", run.place, hint), exit_code=1)
        scale = np.sqrt([*noise.values()])
        vectors = np.stack([run.vectors[name] for name in noise], axis=1) / scale
        least = float(np.mean([floors[name] / noise[name] for name in noise]))
        if run.noise is not None:
            none = np.zeros(0)
            return cls([*noise], vectors, scale, least, none, none, none, none, none, run.speed, order, is_slow=True)
        rows = row_times(run)
        turned = float(rows.angle(rows.end) - rows.angle(rows.begin))
        steps = int(turned / (2 * pi) * STEPS_OF_TURN)
        time = np.linspace(rows.begin, rows.end, min(max(steps, 2), MOST_STEPS) + 1)
        angle = np.asarray(rows.angle(time) - rows.angle(rows.begin))
        if not (np.diff(angle) > 0).all():
            hint = "is the time in s, the speed in rpm?"
            raise RotorsimError(Problem("times and speeds contradict each other", f"run {run.id}", run.place, hint))
        return cls(
            [*noise],
            vectors,
            scale,
            least,
            time,
            np.asarray(rows.speed((time[1:] + time[:-1]) / 2)),
            np.diff(np.asarray(rows.speed(time))) / np.diff(time),
            angle,
            np.stack([rows.starts, rows.starts + 2 * pi * run.turns], axis=1),
            run.speed,
            order,
            steps > MOST_STEPS,
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
    def _known(self) -> dict[tuple[float, float, float], np.ndarray]:
        return {}

    @cached_property
    def smooth(self) -> np.ndarray:
        """What is no mode in the run: slow roll, pick-up of the mains, and modes far below and above, (n, j).

        Those are g / W^2, g and g W^2, one of which is constant, as slow roll is: the first column.
        """
        turn = np.exp(-1j * self.order * self.angle)
        columns = [np.ones(len(self.rows), complex)]
        if not self.is_slow:
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

    def mode(self, w: float, z: float, slope: float) -> np.ndarray:
        """Return the vectors of one mode along the run, (n,); slope: of its frequency over that of the order."""
        if self.is_slow:
            return self.settled_mode(w, z, slope)
        if (w, z, slope) not in self._known:
            own = w + slope * (self.order * self.speed - w)
            s = complex(-z, np.sqrt(1 - z**2)) * own
            ends = np.append(s.imag, s.imag[-1])
            ends[1:-1] = (s.imag[1:] + s.imag[:-1]) / 2
            self._known[w, z, slope] = self.averaged((self._moved(s) - self._moved(s.conjugate())) / (2j * ends))
        return self._known[w, z, slope]

    def settled_mode(self, w: float, z: float, slope: float) -> np.ndarray:
        """Return the vectors that one mode would have at constant speeds, (n,)."""
        return settled_response(self.rows, w, z, self.order, slope)

    def _moved(self, s: np.ndarray) -> np.ndarray:
        """Return a on the grid (N,): a' = (s - i k W) a + g, settled where it begins; s (N - 1,) between the times.

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
    """Vectors as modes (j, 3) of w, z and slope, with the linear factors at their best."""

    def __init__(self, data: PassedRun, modes: np.ndarray) -> None:
        self.data, self.modes = data, modes
        self.columns = np.column_stack([*(data.mode(*mode) for mode in modes.tolist()), data.smooth])
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
            near = abs(self.modes[j, 0] - self.modes[k, 0]) < 2 * self.modes[[j, k], :2].prod(axis=1).max()
            a, b = self.factors[[j, k]]
            mac = abs(np.vdot(a, b)) ** 2 / max(float(np.vdot(a, a).real * np.vdot(b, b).real), 1e-300)
            if near and mac > SAME_SHAPE:
                return True
        return False

    @property
    def unknowns(self) -> int:
        """The number of real unknowns."""
        return int(2 * len(self.modes) + self.modes[:, 2].any() * len(self.modes) + 2 * self.factors.size)

    @property
    def excess(self) -> float:
        """The variance of what is left over that of the noise between rows."""
        return float(self.residual @ self.residual) / max(len(self.residual) - self.unknowns, 1)

    def gain(self, fewer: ModalFit) -> float:
        """Return by how much the Bayesian information criterion is lower than that of a fit with fewer unknowns.

        Noise is of unknown size, but not below what may leak; rows count by what this fit leaves (`slowness`).
        """
        n = len(self.residual) / slowness(self.left)
        here, there = (max(float((fit.residual**2).mean()), self.data.least) for fit in (self, fewer))
        return n * log(there / here) - (self.unknowns - fewer.unknowns) * log(max(n, 2.0))


def with_one_more(run: PassedRun, fit: ModalFit) -> ModalFit:
    """Return the best fit with one more mode, from the place on a grid where that leaves least."""
    low, high = run.order * float(run.rows.min()), run.order * float(run.rows.max())
    few = run.compressed

    def cost(mode: tuple[float, float]) -> float:
        trial = ModalFit(few, np.vstack([fit.modes, [*mode, 0.0]]))
        return float(trial.residual @ trial.residual)

    first = min(product(np.linspace(low, high, START_SPEEDS).tolist(), FIRST_DAMPING), key=cost)
    return searched(run, np.vstack([fit.modes, [*first, 0.0]]), slopes=False)


def searched(run: PassedRun, start: np.ndarray, *, slopes: bool) -> ModalFit:
    """Return the best fit near modes (j, 3); slopes: whether their frequencies may follow the speed."""
    low, high = run.order * float(run.rows.min()), run.order * float(run.rows.max())
    few, count = run.compressed, 3 if slopes else 2

    def unfolded(q: np.ndarray) -> np.ndarray:
        modes = np.zeros((len(start), 3))
        modes[:, :count] = q.reshape(-1, count)
        modes[:, 1] = np.exp(modes[:, 1])
        return modes

    def each(w: float, z: float, slope: float) -> np.ndarray:
        return np.tile([w, z, slope][:count], len(start))

    least, most = each(0.5 * low, log(LEAST_DAMPING), -MOST_SLOPE), each(1.5 * high, log(MOST_DAMPING), MOST_SLOPE)
    begin = start[:, :count].copy()
    begin[:, 1] = np.log(begin[:, 1])
    scale = np.ones_like(begin)
    scale[:, 0] = start[:, :2].prod(axis=1)
    found = least_squares(
        lambda q: ModalFit(few, unfolded(q)).residual,
        np.clip(begin.ravel(), least, most),
        bounds=(least, most),
        x_scale=scale.ravel(),
        max_nfev=SEARCH_EVALUATIONS,
        ftol=MODES_CONVERGED,
    )
    return ModalFit(run, unfolded(found.x))


def covariance_of(data: PassedRun, fit: ModalFit) -> np.ndarray:
    """Return the covariance of w, z and slope of all modes for noise of variance one, the linear factors being free.

    That of slopes that are fixed at zero is zero.
    """
    count = 3 if fit.modes[:, 2].any() else 2
    columns = []
    for j, (w, z, _) in enumerate(fit.modes):
        for which, step in ((0, 1e-4 * w * z), (1, 1e-4 * z), (2, 1e-4))[:count]:
            ends = []
            for sign in (1, -1):
                moved = fit.modes.copy()
                moved[j, which] += sign * step
                ends.append(ModalFit(data, moved).residual)
            columns.append((ends[0] - ends[1]) / (2 * step))
    J = np.stack(columns, axis=1)
    size = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    known = np.linalg.pinv((J / size).T @ (J / size), hermitian=True) / np.outer(size, size)
    whole = np.zeros((len(fit.modes), 3, len(fit.modes), 3))
    whole[:, :count, :, :count] = known.reshape(len(fit.modes), count, len(fit.modes), count)
    return whole.reshape(3 * len(fit.modes), -1)
