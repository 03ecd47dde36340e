"""One law alone, driven by what wires carry in each run, and what outputs show of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorsim.fault import Fault
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.linearised import LinearisedRun
from rotorsim.identification.waveform.recorded.data import STABLE_STEP, SampledRun
from rotorsim.identification.waveform.search import SIMULATION_SUBSTEPS
from rotorsim.linear.kalman import Whitening
from rotorsim.linear.sampled import LARGE

WIRE, OTHER = "wire", "other"
INDEPENDENT = 1e-9  # relative: singular values of what the diagram's parameters change that are none


@dataclass(frozen=True, eq=False)
class View:
    """Outputs of all runs as one column, weighted: as they are, or as innovations of filters.

    basis (rows, m): orthonormal, of what the diagram's parameters change; residual (rows,): beside it. offset: log
    variances of innovations, in the units of the misfit.
    """

    weigh: Callable[[Sequence[np.ndarray]], np.ndarray]
    basis: np.ndarray
    residual: np.ndarray
    offset: float

    @classmethod
    def of(cls, runs: Sequence[LinearisedRun], roots: np.ndarray, filters: Sequence[Whitening] | None = None) -> View:
        """Return a view of some runs; roots (c,), or one of all innovations: of the weights of squares."""

        def weigh(parts: Sequence[np.ndarray]) -> np.ndarray:
            kept = parts if filters is None else [f.innovations(part) for f, part in zip(filters, parts, strict=True)]
            return np.concatenate([(part * np.reshape(roots, (-1, 1))).reshape(-1, part.shape[2]) for part in kept])

        S = weigh([run.by_output for run in runs])
        U, s, _ = np.linalg.svd(S / np.maximum(np.linalg.norm(S, axis=0), 1e-300), full_matrices=False)
        basis = U[:, s > INDEPENDENT * s.max(initial=0.0)]
        residual = weigh([run.residual[:, :, None] for run in runs])[:, 0]
        offset = 0.0 if filters is None else float(roots) ** 2 * sum(f.log_det for f in filters)
        return cls(weigh, basis, residual - basis @ (basis.T @ residual), offset)

    @property
    def before(self) -> float:
        """The misfit without any law."""
        return float(self.residual @ self.residual) + self.offset

    def beside(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Return outputs of all runs (N, c, K) as columns (rows, K), without what the diagram's parameters explain."""
        return self.without_parameters(self.weigh(parts))

    def without_parameters(self, columns: np.ndarray) -> np.ndarray:
        """Return columns (rows, K) without what the diagram's parameters explain."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


@dataclass(frozen=True, eq=False)
class DrivenLaw:
    """A law alone with its fault; m free parameters."""

    law: Simulation
    fault: Fault

    @cached_property
    def p(self) -> np.ndarray:
        """The parameters of its model, (n_p,)."""
        return self.law.equations.model.parameter_vector()

    def _start(self, p: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Return its states at the first sample, of which its inputs (n_v,) are given; p: of its equations."""
        return self.law.equations.beginning(0.0, self._x0, first, p)

    @cached_property
    def _x0(self) -> np.ndarray:
        """Its initial states as they are declared, (n,)."""
        return np.asarray(self.law.equations.model.x0(self.p)[self.law.equations.kept])

    @cached_property
    def bounds(self) -> np.ndarray:
        """The bounds of its free parameters, (2, m)."""
        return np.array([(item.low, item.high) for item in self.law.equations.free]).reshape(-1, 2).T

    @cached_property
    def sizes(self) -> np.ndarray:
        """Which free parameters what it adds is proportional to, (m,)."""
        return np.array([key in self.fault.sizes for key in self.fault.free], bool)

    def within(self, eta: np.ndarray) -> np.ndarray:
        """Return parameters within their bounds."""
        return np.asarray(np.clip(eta, *self.bounds))

    def added(
        self, eta: np.ndarray, sampled: Sequence[SampledRun], wires: Sequence[np.ndarray], *, slopes: bool
    ) -> list[np.ndarray]:
        """Return what the law adds in each run, (N, 1), with derivatives (N, 1 + m); zero where it diverges.

        wires: of each run what its wire carries, and the other signal that it may depend on, (N, 1 or 2).
        """
        if self.law.equations.n:
            return [self._added(eta, run, wire, slopes) for run, wire in zip(sampled, wires, strict=True)]
        times = np.concatenate([run.time for run in sampled])  # without states all runs are one
        whole = self._simulated(eta, np.repeat(np.concatenate(wires)[:, None], 3, axis=1), times, slopes)
        return np.split(whole, np.cumsum([run.size for run in sampled])[:-1])

    def _added(self, eta: np.ndarray, run: SampledRun, wire: np.ndarray, slopes: bool) -> np.ndarray:
        equations = self.law.equations
        names = equations.inputs
        driven = SampledRun(run.id, dict(zip(names, wire.T, strict=True)), dict.fromkeys(names, "linear"), run.time, {})
        p = equations.parameters(self.p, eta)
        start = self._start(p, wire[0])
        if run.steps is None and equations.linear is not None:
            exact = self.law.exact(p, start, driven.inputs(names, 1)[:, ::2], run.dt, sensitivities=slopes)
            return self._change(*exact, wire, slopes)
        A = equations.matrices[0](run.start, start, wire[0], p)[0]
        fastest = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)) * run.dt
        sub = min(2 ** max(int(np.ceil(np.log2(max(fastest / STABLE_STEP, 1.0)))), 0), SIMULATION_SUBSTEPS)
        return self._simulated(eta, driven.inputs(names, sub), run.time, slopes)

    def _simulated(self, eta: np.ndarray, v: np.ndarray, times: np.ndarray, slopes: bool) -> np.ndarray:
        equations = self.law.equations
        p = equations.parameters(self.p, eta)
        start = self._start(p, v[0, 0])
        y, by = self.law.simulate(p, start, v, np.diff(times), t0=float(times[0]), sensitivities=slopes)
        return self._change(y, by, v[:, 0], slopes)

    def _change(self, y: np.ndarray, by: np.ndarray, wires: np.ndarray, slopes: bool) -> np.ndarray:
        """Return what an output y changes of its wire, with derivatives where there are slopes."""
        added = y - wires[:, :1]
        whole = np.concatenate([added, by[:, 0, : self.law.equations.m]], axis=1) if slopes else added
        return whole if (np.abs(whole) < LARGE).all() else np.zeros_like(whole)
