"""Poles that grow, told from poles that are zero but for rounding, and the stability limit of the fixed step."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorsim.model.compiled import Model
from rotorsim.model.runge_kutta import RK4

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Growing:
    """The poles [1/s] with a positive real part, fastest growth first, one of each conjugate pair.

    share: how much every state takes part in the first, (n_x,), its sum 1 (participation factors).
    """

    poles: np.ndarray
    share: np.ndarray

    def __bool__(self) -> bool:
        return bool(len(self.poles))

    def describe(self, model: Model | None = None) -> str:
        """Return the fastest growing pole in words, how many others grow, and the block whose states it is in."""
        if not self:
            return "no pole grows"
        first = complex(self.poles[0])
        text = f"a pole at {first.real:.4g} 1/s"
        if first.imag:
            damping = f"damping ratio {-first.real / abs(first):.3g}"
            text = f"a pole at {first.imag / (2 * np.pi):.4g} Hz, {damping}, grows at {first.real:.4g} 1/s"
        blocks: dict[str, float] = {}
        for position, share in enumerate(self.share if model else ()):
            name = model.block_of_state(position) if model else ""
            blocks[name] = blocks.get(name, 0.0) + float(share)
        if len(blocks) > 1:
            text += f", most of it in the states of '{max(blocks, key=lambda name: blocks[name])}'"
        more = len(self.poles) - 1
        return text + (f"; {more} more grow{'s' * (more == 1)}" if more else "")


def growing(A: np.ndarray) -> Growing:
    """Return the poles of d x/dt = A x, A (n, n), that grow, but for rounding (see `_uncertain`)."""
    n = len(A)
    nothing = Growing(np.zeros(0, complex), np.zeros(n))
    if n == 0 or not np.isfinite(A).all():
        return nothing
    if not (np.linalg.eigvals(A).real > 0).any():  # LAPACK balances, too
        return nothing
    values, left, right, rounding = _uncertain(A)
    kept = np.flatnonzero((values.real > rounding) & (values.imag >= 0))
    if not len(kept):
        return nothing
    kept = kept[np.argsort(-values.real[kept], kind="stable")]
    share = np.abs(left[:, kept[0]] * right[:, kept[0]])
    return Growing(values[kept], share / share.sum())


def growing_multipliers(M: np.ndarray) -> np.ndarray:
    """Return the eigenvalues of x_(k+1) = M x_k, M (n, n), outside the unit circle but for rounding, largest first."""
    if not len(M) or not (np.abs(np.linalg.eigvals(M)) > 1).any():
        return np.zeros(0, complex)
    values, _, _, rounding = _uncertain(M)
    found = values[np.abs(values) > 1 + rounding]
    return np.asarray(found[np.argsort(-np.abs(found), kind="stable")])


def _uncertain(A: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return eigenvalues, left and right vectors of a balanced matrix, and by how much rounding may move each value.

    A computed eigenvalue is exact for a matrix within about n eps |A| of the (balanced) one, which moves it by
    kappa n eps |A|, kappa = |l| |r| / |l^H r| (left and right vectors): what lies within ten times that of the
    limit of stability may be there but for rounding, such as the double zero of a free body (kappa is infinite).
    Source: Golub & Van Loan, Matrix Computations (2013), sec. 7.2.2; LAPACK Users' Guide, sec. 4.8.
    """
    from scipy.linalg import eig, matrix_balance  # as long to load as a short run takes

    balanced = matrix_balance(A, permute=False)[0]
    values, left, right = eig(balanced, left=True, right=True)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    with np.errstate(divide="ignore", over="ignore"):
        kappa = np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0) / overlap
    return values, left, right, 10 * len(A) * EPS * np.linalg.norm(balanced) * kappa


def step_factor(q: np.ndarray) -> np.ndarray:
    """Return |R(q)|, by which `RK4` changes exp(lambda t) in one step, q = h lambda: 1 + q + q^2/2 + q^3/6 + q^4/24."""
    return np.asarray(np.abs(np.polynomial.polynomial.polyval(q, RK4.stability)))


def largest_stable_step(eigenvalues: np.ndarray) -> float:
    """Return the largest step [s] for which classical RK4 is stable, |R(h lambda)| <= 1 for every lambda.

    Growing poles do not count; undamped ones do (|R(i y)| <= 1 up to y = sqrt 8).
    """
    steady = eigenvalues[(eigenvalues.real <= 1e-12 * np.abs(eigenvalues)) & (eigenvalues != 0)]
    if not len(steady):
        return float("inf")
    steady = np.minimum(steady.real, 0.0) + 1j * steady.imag

    def stable(h: float) -> bool:
        return bool((step_factor(h * steady) <= 1 + 1e-12).all())

    steps = np.geomspace(1e-3, 10.0, 400) / np.abs(steady).max()
    low, high = next(((a, b) for a, b in pairwise(steps) if not stable(b)), (steps[-1], steps[-1]))
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)


def rounded_down(value: float, digits: int = 3) -> float:
    """Return a positive number rounded down: a step that is told as stable must be."""
    if not np.isfinite(value) or value <= 0:
        return value
    unit = 10.0 ** (np.floor(np.log10(value)) - digits + 1)
    return float(np.floor(value / unit * (1 + 1e-12)) * unit)
