"""What a search knows at a point: residuals, their Jacobians, and what these say together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from rotorsim.errors import RotorsimError
from rotorsim.model.heard import barred

BLOCK_NUMBERS = 1 << 17  # of a Jacobian, weighted at a time: 1 MB, which stays in the cache

Label = tuple[str, str, int]  # subsystem, state, run


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Residuals and their Jacobians at a point.

    unknowns (q,): the m free parameters, then the states at the first samples, of every subsystem and run. sub: steps
    between samples. cost: weighted sum of squares with priors. residuals: of each subsystem and run (N, c), measured
    less simulated, not weighted, NaN where nothing was measured. gradient, information: J^T r and J^T J of all
    unknowns. jacobians: of each subsystem and run (N, c, m + n) by parameters and its start, not weighted; (N, c, 0)
    without sensitivities. barred: what failed at a trial; at the end of a search: beyond where it would go on.
    """

    unknowns: np.ndarray
    sub: int
    cost: float = np.inf
    residuals: Sequence[Sequence[np.ndarray]] = ()
    jacobians: Sequence[Sequence[np.ndarray]] = ()
    gradient: np.ndarray = field(default_factory=lambda: np.zeros(0))
    information: np.ndarray = field(default_factory=lambda: np.zeros(0))
    barred: RotorsimError | None = None

    def reached(self) -> Evaluation:
        """Return it as the end of a fit. Raises RotorsimError where the search would go on, but trials fail there."""
        if self.barred is not None:
            raise barred(self.barred)
        return self


def solved(H: np.ndarray, b: np.ndarray, rcond: float = 1e-12) -> np.ndarray:
    """Return H^-1 b of what information H (q, q), scaled to unit diagonal, determines; b (q,) or (q, k)."""
    scale = np.sqrt(np.where(np.diag(H) > 0, np.diag(H), 1.0))
    scaled = np.linalg.lstsq(H / np.outer(scale, scale), (b.T / scale).T, rcond=rcond)[0]
    return np.asarray((scaled.T / scale).T)


def weighted_blocks(
    root: np.ndarray, residual: np.ndarray, jacobian: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield weighted residuals (n,) and their Jacobians (n, q) of samples, some at a time: all together may be large.

    root, residual (N, c), jacobian (N, c, q).
    """
    each = max(BLOCK_NUMBERS // max(root.shape[1] * jacobian.shape[2], 1), 1)
    for a in range(0, len(root), each):
        weight = root[a : a + each]
        e = (weight * np.nan_to_num(residual[a : a + each])).ravel()
        yield e, (weight[:, :, None] * jacobian[a : a + each]).reshape(weight.size, -1)
