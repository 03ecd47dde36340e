"""What the declared laws would explain at every place, before any of them is put into the diagram.

About the simulated runs, a law y = law(s; eta) at a place adds d = law(s; eta) - s there, and the outputs answer
linearly: residual = response(d) + S theta + noise, with s what the place carries (smoothed, where a free signal there
explains much), and likewise the other signal that a law may depend on. eta and theta by Gauss-Newton steps, all with
the block's own equations.

Where the simulation is far from the runs, what it adds goes astray before long. At the likely places a law is therefore
judged, too, beside a free signal that is weaker than the one that explains all: by -2 log likelihood of the innovations
of its Kalman filter, which forget what is past, and of which that of the outputs is the limit without a free signal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isclose
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from rotorsim.diagnosis.catalogue.insertion import Insertion, Spot, fixed_of, limits_of, sizes_at, starts_of
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass
from rotorsim.diagram.diagram import Diagram
from rotorsim.fault import Fault
from rotorsim.identification.waveform.data import STABLE_STEP, SampledRun
from rotorsim.identification.waveform.equations import driven_equations
from rotorsim.identification.waveform.linearised import LinearisedRun, Place
from rotorsim.identification.waveform.search import SIMULATION_SUBSTEPS
from rotorsim.identification.waveform.simulation import LARGE, Simulation
from rotorsim.identification.waveform.unknown_input import SignalEstimate, Smoothed, UnknownInputs, Whitening

WIRE, OTHER, LAW = "wire", "other", "law"
SMOOTHED_PLACES = 8  # the likeliest, where the signal that the place carries is estimated, too
STEPS = 6  # Gauss-Newton steps from the best start
SETTLED = 1e-3  # relative fall of the misfit in a step, below which it was the last
ALIKE = 1e-9  # relative difference of -2 log likelihoods of places that no data tell apart, whose filters are the same
DAMPED = (0.0, 0.03, 1.0)  # of the scaled information, until a step helps (Levenberg, Marquardt)
WEAKER = 0.1  # times the strength of the likeliest free signal: beside the law, a hundredth of its power is left
POSSIBLE = 10.0  # times the misfit of the best free signal, or of noise: beyond, a place is not looked at
WORTH = 10.0  # fall of the misfit by the shape alone, from which on a law is fitted


@dataclass(frozen=True, eq=False)
class Promise:
    """What a law would leave, and from where its parameters are to start, {free parameter: SI value}."""

    misfit: float
    start: Mapping[str, float]


def spot_of(place: Place) -> Spot:
    """Return where a signal is added, as a place of a diagnosis."""
    block, _, port = place.port.rpartition(".")
    return Spot(block, port, side=place.side)


class LawBounds:
    """Misfits that the laws of signals promise; places (P,), estimates: of free signals there, the likeliest first.

    moved: free parameters of the diagram that are not as fitted, {name: SI value}. roots (c,): of the weights of
    squares. load: document -> diagram. sizes: see `sizes_at`.
    """

    by_law = True

    def __init__(
        self,
        runs: Sequence[LinearisedRun],
        sampled: Sequence[SampledRun],
        places: Sequence[Place],
        unknown: UnknownInputs,
        moved: Mapping[str, float],
        roots: np.ndarray,
        sizes: Mapping[str, float],
        load: Callable[[Mapping[str, Any]], Diagram],
    ) -> None:
        self.runs, self.sampled, self.places, self.unknown = runs, sampled, places, unknown
        self.moved, self.roots, self.given, self.load = moved, roots, sizes, load
        self.rows = sum(run.residual.shape[0] for run in runs) * float(np.sum((roots * unknown.noise) ** 2))
        self._impulses: dict[int, list[np.ndarray]] = {}
        self._laws: dict[tuple[Any, ...], Simulation] = {}
        self._known: dict[str, Promise | None] = {}
        self._plain: _View | None = None
        self._beside_free: dict[int, _View | None] = {}

    @cached_property
    def estimates(self) -> list[SignalEstimate]:
        """Free signals at all places that show, the likeliest first."""
        return self.unknown.estimates()

    @cached_property
    def carried(self) -> Mapping[str, float]:
        """The largest magnitude of what each place carries, smoothed with the likeliest free signal, by flat name."""
        smoothed = [self._smoothed[item.place].wires for item in self.estimates[:1]]
        wires = np.concatenate([*smoothed, [run.wires for run in self.runs]][0])
        return {place.port: float(size) for place, size in zip(self.places, np.abs(wires).max(axis=0), strict=True)}

    @cached_property
    def sizes(self) -> Mapping[str, float]:
        """The largest magnitude of signals, and what `sizes_at` takes beside them."""
        return {**self.given, **self.carried}

    @property
    def deviance(self) -> float:
        """-2 log likelihood of the likeliest free signal; infinite where none shows."""
        return min((item.deviance for item in self.estimates), default=np.inf)

    def bound(self, item: Insertion) -> float | None:
        """Return the misfit that a law promises, None where it is no law of a signal."""
        promise = self.promise(item)
        return None if promise is None else promise.misfit

    def start(self, item: Insertion) -> Mapping[str, float]:
        """Return from where a law is to start, {free parameter: SI value}; nothing where nothing is known."""
        promise = self.promise(item)
        return {} if promise is None or not promise.start else {**self.moved, **promise.start}

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
        others = [k for k, other in enumerate(self.places) if other.port == item.depends_on][:1]
        if item.depends_on and not others:
            return None
        sizes = sizes_at(item, self.sizes)
        law = self._law(item, fixed_of(item, sizes), limits_of(item, sizes))
        given = [np.array([start[key] for key in item.fault.free]) for start in starts_of(item, sizes)]
        best = Promise(np.inf, {})
        for carried, view in self._ways(place):
            wires = [wire[:, [place, *others]] for wire in carried]
            misfit, eta = self._fitted(_Law.of(law, self._sampled_wires(wires), item.fault), place, given, view)
            if misfit < min(best.misfit, view.before - WORTH if view.offset else np.inf):
                best = Promise(misfit, dict(zip(item.free, eta.tolist(), strict=True)))
        return best

    @property
    def classes(self) -> tuple[PlaceClass, ...]:
        """The classes of places that no data separate, with their probabilities, the likeliest first."""
        factor = float(np.mean((self.roots * self.unknown.noise) ** 2))
        deviance = {item.place: factor * item.deviance for item in self.estimates}
        sorted_ones = [
            sorted((k for k in one if k in deviance), key=deviance.__getitem__) for one in self.unknown.classes()
        ]
        classes = sorted((one for one in sorted_ones if one), key=lambda one: deviance[one[0]])
        weights = np.array([np.exp((deviance[classes[0][0]] - deviance[one[0]]) / 2) for one in classes])
        return tuple(
            PlaceClass(tuple(spot_of(self.places[k]) for k in one), float(weight))
            for one, weight in zip(classes, weights / weights.sum(), strict=True)
        )

    @cached_property
    def _free(self) -> dict[int, float]:
        """The misfit of a free signal at each place, in the units of a fit."""
        factor = float(np.mean((self.roots * self.unknown.noise) ** 2))
        return {item.place: factor * item.misfit for item in self.estimates}

    def _fitted(self, law: _Law, place: int, starts: Sequence[np.ndarray], view: _View) -> tuple[float, np.ndarray]:
        """Return the misfit and the parameters of a law: the best start, then Gauss-Newton steps where it is worth it.

        What a start adds may be of any size at first, so that a start need only be of the right shape.
        """
        residual = view.residual
        before = view.before
        trials = [law.within(eta) for eta in starts]
        shapes = [self._added(law, place, eta, view)[:, 0] for eta in trials]
        gains = [max(float(a @ residual), 0.0) ** 2 / max(float(a @ a), 1e-300) for a in shapes]
        k = int(np.argmax(gains))
        eta, least = trials[k], before - gains[k]
        if not np.isfinite(gains[k]) or gains[k] < WORTH:
            return least, eta
        if law.sizes.any():  # of the size at once, or the first step changes where the law begins to act instead
            factor = float(shapes[k] @ residual) / float(shapes[k] @ shapes[k])
            eta = law.within(np.where(law.sizes, factor * eta, eta))
            shapes[k] = self._added(law, place, eta, view)[:, 0]
        left = residual - shapes[k]
        here = float(left @ left)
        for _ in range(STEPS):
            slopes = self._added(law, place, eta, view, slopes=True)[:, 1:]
            norm = np.linalg.norm(slopes, axis=0)
            scaled = slopes / np.where(norm > 0, norm, 1.0)
            H, g, fell = scaled.T @ scaled, scaled.T @ left, 0.0
            for damping in DAMPED:
                step = np.linalg.lstsq(H + damping * np.eye(len(H)), g, rcond=1e-12)[0] / np.where(norm > 0, norm, 1.0)
                trial = law.within(eta + step)
                after = residual - self._added(law, place, trial, view)[:, 0]
                if (cost := float(after @ after)) < here:
                    fell = 1 - cost / here
                    eta, left, here = trial, after, cost
                    break
            if fell < SETTLED:
                break
        here += view.offset
        return (here if here < least or not np.isfinite(least) else max(least, 0.0)), eta

    def _added(self, law: _Law, place: int, eta: np.ndarray, view: _View, *, slopes: bool = False) -> np.ndarray:
        """Return what a law changes of all outputs beside the diagram's parameters, weighted, (rows, 1 (+ m))."""
        added = [law.added(eta, r, slopes=slopes) for r in range(len(self.runs))]
        return view.beside([self._response(place, r, d) for r, d in enumerate(added)])

    def _ways(self, place: int) -> Iterator[tuple[list[np.ndarray], _View]]:
        """Yield what all places carry in each run (N, P), and how misfits are judged.

        As simulated, by the outputs; at a likely place also as smoothed with the free signal there, by the outputs and
        beside a weaker free signal.
        """
        if self._plain is None:
            self._plain = _View.of(self.runs, self.roots)
        yield [run.wires for run in self.runs], self._plain
        likely = {item.place: item for item in self.estimates[:SMOOTHED_PLACES]}
        if place not in likely:
            return
        item = likely[place]
        carried = self._smoothed[place].wires
        yield carried, self._plain
        alike = next((k for k in self._beside_free if isclose(likely[k].deviance, item.deviance, rel_tol=ALIKE)), place)
        if alike not in self._beside_free:
            filters = self.unknown.whitening(place, WEAKER * item.strength)
            root = float(np.sqrt(np.mean((self.roots * self.unknown.noise) ** 2)))
            self._beside_free[place] = None if filters is None else _View.of(self.runs, np.array(root), filters)
        if (view := self._beside_free[alike]) is not None:
            yield carried, view

    @cached_property
    def _smoothed(self) -> dict[int, Smoothed]:
        """The estimated signals of the likeliest places."""
        likely = self.estimates[:SMOOTHED_PLACES]
        return {item.place: one for item, one in zip(likely, self.unknown.smoothed(likely), strict=True)}

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
            inputs = {WIRE: taken, **({OTHER: item.fault.argument} if item.depends_on else {})}
            recorded = {name: {"type": "recorded", "parameters": {"interpolation": "linear"}} for name in inputs}
            diagram = self.load(
                {
                    "schema_version": 1,
                    "name": item.physics,
                    "blocks": {**recorded, LAW: {"type": item.kind.type_name, "parameters": parameters}},
                    "wires": [[f"{name}.output", f"{LAW}.{port}"] for name, port in inputs.items()],
                    "record": [f"{LAW}.{given}"],
                    "identify": {f"{LAW}.{name}": limit for name, limit in bounds.items()},
                }
            )
            names = [f"{name}.output" for name in inputs]
            self._laws[key] = Simulation(driven_equations(diagram, [f"{LAW}.{given}"], names, diagram.free))
        return self._laws[key]

    def _sampled_wires(self, wires: Sequence[np.ndarray]) -> list[SampledRun]:
        """Return runs in which a wire, and the other that a law may depend on, carry signals, (N, 1 or 2)."""
        names = (f"{WIRE}.output", f"{OTHER}.output")
        kinds = dict.fromkeys(names, "linear")
        return [
            SampledRun(run.id, dict(zip(names, both.T, strict=False)), kinds, run.time, {})
            for run, both in zip(self.sampled, wires, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class _View:
    """Outputs of all runs as one column, weighted: as they are, or as innovations of filters.

    basis (rows, m): orthonormal, of what the diagram's parameters change; residual (rows,): beside it. offset: log
    variances of innovations, in the units of the misfit.
    """

    weigh: Callable[[Sequence[np.ndarray]], np.ndarray]
    basis: np.ndarray
    residual: np.ndarray
    offset: float

    @classmethod
    def of(cls, runs: Sequence[LinearisedRun], roots: np.ndarray, filters: Sequence[Whitening] | None = None) -> _View:
        """Return a view of some runs; roots (c,), or one of all innovations: of the weights of squares."""

        def weigh(parts: Sequence[np.ndarray]) -> np.ndarray:
            kept = parts if filters is None else [f.innovations(part) for f, part in zip(filters, parts, strict=True)]
            return np.concatenate([(part * np.reshape(roots, (-1, 1))).reshape(-1, part.shape[2]) for part in kept])

        S = weigh([run.by_output for run in runs])
        U, s, _ = np.linalg.svd(S / np.maximum(np.linalg.norm(S, axis=0), 1e-300), full_matrices=False)
        basis = U[:, s > 1e-9 * s.max(initial=0.0)]
        residual = weigh([run.residual[:, :, None] for run in runs])[:, 0]
        offset = 0.0 if filters is None else float(roots) ** 2 * sum(f.log_det for f in filters)
        return cls(weigh, basis, residual - basis @ (basis.T @ residual), offset)

    @property
    def before(self) -> float:
        """The misfit without any law."""
        return float(self.residual @ self.residual) + self.offset

    def beside(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Return outputs of all runs (N, c, K) as columns (rows, K), without what the diagram's parameters explain."""
        whole = self.weigh(parts)
        return np.asarray(whole - self.basis @ (self.basis.T @ whole))


@dataclass(frozen=True, eq=False)
class _Law:
    """A law alone, driven by what a wire carries in each run. p, x0: its parameters and start; bounds (2, m).

    sizes (m,): which parameters what it adds is proportional to.
    """

    law: Simulation
    runs: Sequence[SampledRun]
    p: np.ndarray
    x0: np.ndarray
    bounds: np.ndarray
    sizes: np.ndarray

    @classmethod
    def of(cls, law: Simulation, runs: Sequence[SampledRun], fault: Fault) -> _Law:
        """Return a law at its start."""
        equations = law.equations
        p = equations.model.parameter_vector()
        bounds = np.array([(item.low, item.high) for item in equations.free]).reshape(-1, 2).T
        sizes = np.array([key in fault.sizes for key in fault.free], bool)
        return cls(law, runs, p, equations.model.x0(p)[equations.kept], bounds, sizes)

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
