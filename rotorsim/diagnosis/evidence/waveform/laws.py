"""What the declared laws would explain at every place, before any of them is put into the diagram.

About the simulated runs, a law y = law(s; eta) at a place adds d = law(s; eta) - s there, and the outputs answer
linearly: residual = response(d) + S theta + noise, with s what the place carries (smoothed, where a free signal there
explains much). eta and theta by Gauss-Newton steps, all with the block's own equations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from rotorsim.diagnosis.catalogue.insertion import Insertion, fixed_of, limits_of, sizes_at, starts_of
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.data import STABLE_STEP, SampledRun
from rotorsim.identification.waveform.equations import driven_equations
from rotorsim.identification.waveform.linearised import LinearisedRun, Place
from rotorsim.identification.waveform.search import SIMULATION_SUBSTEPS
from rotorsim.identification.waveform.simulation import LARGE, Simulation
from rotorsim.identification.waveform.unknown_input import SignalEstimate, UnknownInputs

WIRE, LAW = "wire", "law"
SMOOTHED_PLACES = 8  # the likeliest, where the signal that the place carries is estimated, too
STEPS = 3  # Gauss-Newton steps from the best start
HALVED = (1.0, 0.3)  # of a step, until it helps
POSSIBLE = 10.0  # times the misfit of the best free signal, or of noise: beyond, a place is not looked at
WORTH = 10.0  # fall of the misfit by the shape alone, from which on a law is fitted


@dataclass(frozen=True, eq=False)
class Promise:
    """What a law would leave, and from where its parameters are to start, {free parameter: SI value}."""

    misfit: float
    start: Mapping[str, float]


class LawBounds:
    """Misfits that the laws of signals promise; places (P,), estimates: of free signals there, the likeliest first.

    roots (c,): of the weights of squares. load: document -> diagram. sizes: see `sizes_at`.
    """

    by_law = True

    def __init__(
        self,
        runs: Sequence[LinearisedRun],
        sampled: Sequence[SampledRun],
        places: Sequence[Place],
        unknown: UnknownInputs,
        roots: np.ndarray,
        sizes: Mapping[str, float],
        load: Callable[[Mapping[str, Any]], Diagram],
    ) -> None:
        self.runs, self.sampled, self.places, self.unknown = runs, sampled, places, unknown
        self.roots, self.sizes, self.load = roots, sizes, load
        self.rows = sum(run.residual.shape[0] for run in runs) * float(np.sum((roots * unknown.noise) ** 2))
        self._carried: dict[int, list[list[np.ndarray]]] = {}
        self._impulses: dict[int, list[np.ndarray]] = {}
        self._laws: dict[tuple[Any, ...], Simulation] = {}
        self._known: dict[str, Promise | None] = {}

    @cached_property
    def estimates(self) -> list[SignalEstimate]:
        """Free signals at all places that show, the likeliest first."""
        return self.unknown.estimates()

    def bound(self, item: Insertion) -> float | None:
        """Return the misfit that a law promises, None where it is no law of a signal."""
        promise = self.promise(item)
        return None if promise is None else promise.misfit

    def start(self, item: Insertion) -> Mapping[str, float]:
        """Return from where a law is to start, {free parameter: SI value}; nothing where nothing is known."""
        promise = self.promise(item)
        return {} if promise is None else promise.start

    def promise(self, item: Insertion) -> Promise | None:
        """Return what a law promises at its place, None where it is no law of a signal."""
        if item.fault.enters != "signal":
            return None
        if item.key not in self._known:
            self._known[item.key] = self._promise(item)
        return self._known[item.key]

    def _promise(self, item: Insertion) -> Promise | None:
        here = Place(f"{item.spot.block}.{item.spot.port}", item.spot.side)
        if here not in self.places:
            return None
        place = self.places.index(here)
        free = self._free.get(place, np.inf)
        if free > POSSIBLE * max(min(self._free.values(), default=np.inf), self.rows):
            return Promise(free, {})  # no law leaves less than a free signal does there
        sizes = sizes_at(item, self.sizes)
        law = self._law(item, fixed_of(item, sizes), limits_of(item, sizes))
        given = [np.array([start[key] for key in item.fault.free]) for start in starts_of(item, sizes)]
        best = Promise(np.inf, {})
        for wires in self._wires(place):
            found = self._fitted(_Law.of(law, self._sampled_wires(wires)), place, given)
            if found[0] < best.misfit:
                best = Promise(found[0], dict(zip(item.free, found[1].tolist(), strict=True)))
        return best

    @cached_property
    def _free(self) -> dict[int, float]:
        """The misfit of a free signal at each place, in the units of a fit."""
        factor = float(np.mean((self.roots * self.unknown.noise) ** 2))
        return {item.place: factor * item.misfit for item in self.estimates}

    def _fitted(self, law: _Law, place: int, starts: Sequence[np.ndarray]) -> tuple[float, np.ndarray]:
        """Return the misfit and the parameters of a law: the best start, then Gauss-Newton steps where it is worth it.

        What a start adds may be of any size at first, so that a start need only be of the right shape.
        """
        _, residual = self._beside
        before = float(residual @ residual)
        trials = [law.within(eta) for eta in starts]
        shapes = [self._added(law, place, eta)[:, 0] for eta in trials]
        gains = [max(float(a @ residual), 0.0) ** 2 / max(float(a @ a), 1e-300) for a in shapes]
        k = int(np.argmax(gains))
        eta, least = trials[k], before - gains[k]
        if not np.isfinite(gains[k]) or gains[k] < WORTH:
            return least, eta
        left = residual - shapes[k]
        here = float(left @ left)
        for _ in range(STEPS):
            slopes = self._added(law, place, eta, slopes=True)[:, 1:]
            norm = np.linalg.norm(slopes, axis=0)
            scaled = slopes / np.where(norm > 0, norm, 1.0)
            step = np.linalg.lstsq(scaled.T @ scaled, scaled.T @ left, rcond=1e-12)[0] / np.where(norm > 0, norm, 1.0)
            for factor in HALVED:
                trial = law.within(eta + factor * step)
                after = residual - self._added(law, place, trial)[:, 0]
                if (cost := float(after @ after)) < here:
                    eta, left, here = trial, after, cost
                    break
            else:
                break
        return (here if here < least or not np.isfinite(least) else max(least, 0.0)), eta

    def _added(self, law: _Law, place: int, eta: np.ndarray, *, slopes: bool = False) -> np.ndarray:
        """Return what a law changes of all outputs beside the diagram's parameters, weighted, (rows, 1 (+ m))."""
        parts = []
        for r in range(len(self.runs)):
            added = law.added(eta, r, slopes=slopes)
            answers = self._response(place, r, added) * self.roots[:, None]
            parts.append(answers.reshape(-1, added.shape[1]))
        basis, _ = self._beside
        whole = np.concatenate(parts)
        return np.asarray(whole - basis @ (basis.T @ whole))

    @cached_property
    def _beside(self) -> tuple[np.ndarray, np.ndarray]:
        """Return an orthonormal basis (rows, m) of what the diagram's parameters change, and the residual beside it."""
        S = np.concatenate(
            [(run.by_output * self.roots[:, None]).reshape(-1, run.by_output.shape[2]) for run in self.runs]
        )
        U, s, _ = np.linalg.svd(S / np.maximum(np.linalg.norm(S, axis=0), 1e-300), full_matrices=False)
        basis = U[:, s > 1e-9 * s.max(initial=0.0)]
        residual = np.concatenate([(run.residual * self.roots).ravel() for run in self.runs])
        return basis, residual - basis @ (basis.T @ residual)

    def _wires(self, place: int) -> list[list[np.ndarray]]:
        """Return what a place carries in each run, (N,): as simulated, and as smoothed where it is likely."""
        if place not in self._carried:
            simulated = [run.wires[:, place] for run in self.runs]
            likely = {item.place: item for item in self.estimates[:SMOOTHED_PLACES]}
            smoothed = [self.unknown.smoothed(likely[place]).wire] if place in likely else []
            self._carried[place] = [simulated, *smoothed]
        return self._carried[place]

    def _response(self, place: int, r: int, added: np.ndarray) -> np.ndarray:
        """Return what signals (N, K) that are added at a place change of the outputs of a run, (N, c, K)."""
        run, N = self.runs[r], len(added)
        if not run.constant:
            return run.responses(place, added)
        if place not in self._impulses:
            self._impulses[place] = [one.responses(place, np.eye(len(one.residual), 1))[:, :, 0] for one in self.runs]
        size = next_fast_len(2 * N, real=True)
        product = rfft(self._impulses[place][r], size, axis=0)[:, :, None] * rfft(added, size, axis=0)[:, None]
        return np.asarray(irfft(product, size, axis=0)[:N])

    def _law(
        self, item: Insertion, fixed: Mapping[str, float], limits: Mapping[str, tuple[float, float]]
    ) -> Simulation:
        """Return a law alone, driven by a wire, with its parameters free."""
        parameters = {**item.values, **fixed}
        key = (item.kind, tuple(sorted((k, str(v)) for k, v in parameters.items())), tuple(sorted(limits.items())))
        if key not in self._laws:
            bounds = {name: dict(zip(("low", "high"), limits.get(name, ()), strict=False)) for name in item.fault.free}
            [(taken, given)] = item.fault.through.items()
            diagram = self.load(
                {
                    "schema_version": 1,
                    "name": item.physics,
                    "blocks": {
                        WIRE: {"type": "recorded", "parameters": {"interpolation": "linear"}},
                        LAW: {"type": item.kind.type_name, "parameters": parameters},
                    },
                    "wires": [[f"{WIRE}.output", f"{LAW}.{taken}"]],
                    "record": [f"{LAW}.{given}"],
                    "identify": {f"{LAW}.{name}": limit for name, limit in bounds.items()},
                }
            )
            self._laws[key] = Simulation(
                driven_equations(diagram, [f"{LAW}.{given}"], [f"{WIRE}.output"], diagram.free)
            )
        return self._laws[key]

    def _sampled_wires(self, wires: Sequence[np.ndarray]) -> list[SampledRun]:
        """Return runs in which a wire carries signals, (N,)."""
        kinds = {f"{WIRE}.output": "linear"}
        pairs = zip(self.sampled, wires, strict=True)
        return [SampledRun(run.id, {f"{WIRE}.output": s}, kinds, run.time, {}) for run, s in pairs]


@dataclass(frozen=True, eq=False)
class _Law:
    """A law alone, driven by what a wire carries in each run. p, x0: its parameters and start; bounds (2, m)."""

    law: Simulation
    runs: Sequence[SampledRun]
    p: np.ndarray
    x0: np.ndarray
    bounds: np.ndarray

    @classmethod
    def of(cls, law: Simulation, runs: Sequence[SampledRun]) -> _Law:
        """Return a law at its start."""
        equations = law.equations
        p = equations.model.parameter_vector()
        bounds = np.array([(item.low, item.high) for item in equations.free]).reshape(-1, 2).T
        return cls(law, runs, p, equations.model.x0(p)[equations.kept], bounds)

    def within(self, eta: np.ndarray) -> np.ndarray:
        """Return parameters within their bounds."""
        return np.asarray(np.clip(eta, *self.bounds))

    def added(self, eta: np.ndarray, r: int, *, slopes: bool) -> np.ndarray:
        """Return what the law adds to its wire in a run (N, 1), with derivatives (N, 1 + m); zero if it diverges."""
        run, equations = self.runs[r], self.law.equations
        p = equations.parameters(self.p, eta)
        A = equations.matrices[0](run.start, self.x0, run.inputs(equations.inputs, 1)[0, 0], p)[0]
        fastest = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)) * run.dt
        sub = min(2 ** max(int(np.ceil(np.log2(max(fastest / STABLE_STEP, 1.0)))), 0), SIMULATION_SUBSTEPS)
        steps = run.dt if run.steps is None else run.steps
        y, by = self.law.simulate(
            p, self.x0, run.inputs(equations.inputs, sub), steps, t0=run.start, sensitivities=slopes
        )
        added = y - run.values[f"{WIRE}.output"][:, None]
        whole = np.concatenate([added, by[:, 0, : equations.m]], axis=1) if slopes else added
        return whole if (np.abs(whole) < LARGE).all() else np.zeros_like(whole)
