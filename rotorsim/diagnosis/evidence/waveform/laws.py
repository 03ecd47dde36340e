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
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from math import isclose
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from rotorsim.diagnosis.catalogue.insertion import (
    DOMINANT,
    LAW_ALONE,
    ONSETS,
    STARTS_TRIED,
    Insertion,
    Law,
    Spot,
    fixed_of,
    limits_of,
    scales_of,
    sizes_at,
    starts_of,
)
from rotorsim.diagnosis.evidence.evidence import Promise
from rotorsim.diagnosis.evidence.fit import FAILURES
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass
from rotorsim.diagnosis.evidence.waveform.dominant_line import dominant_line, white
from rotorsim.diagnosis.evidence.waveform.driven_law import OTHER, WIRE, DrivenLaw, View
from rotorsim.diagnosis.evidence.waveform.onset import onset_times
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.driven.equations import driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.linearised import LinearisedRun, Place
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.identification.waveform.unknown_input import SignalEstimate, Smoothed, UnknownInputs

SMOOTHED_PLACES = 8  # the likeliest, where the signal that the place carries is estimated, too
STEPS = 6  # Gauss-Newton steps from the best start
SETTLED = 1e-3  # relative fall of the misfit in a step, below which it was the last
STARTS_COMPARED = 24  # of a law at a likely place, by what they leave of the outputs
ALIKE = 1e-9  # relative difference of -2 log likelihoods of places that no data tell apart, whose filters are the same
DAMPED = (0.0, 0.03, 1.0)  # of the scaled information, until a step helps (Levenberg, Marquardt)
WEAKER = 0.1  # times the strength of the likeliest free signal: beside the law, a hundredth of its power is left
POSSIBLE = 10.0  # times the misfit of the best free signal, or of noise: beyond, a place is not looked at
WORTH = 10.0  # fall of the misfit by the shape alone, from which on a law is fitted
PAIRS = 12  # of place and other signal at which a nonlinear law is fitted: the best by its shape as it starts


def spot_of(place: Place) -> Spot:
    """Return where a signal is added, as a place of a diagnosis."""
    block, _, port = place.entry.rpartition(".")
    return Spot(block, port, side=place.side)


class LawBounds:
    """Misfits that the laws of signals promise; places (P,), estimates: of free signals there, the likeliest first.

    moved: free parameters of the diagram that are not as fitted, {name: SI value}. roots (c,): of the weights of
    squares. load: document -> diagram. sizes: see `sizes_at`. motion: what the places carry in each run (N, P), where a
    fit is at hand that explains more; laws are judged by that alone then.
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
        motion: Sequence[np.ndarray] | None = None,
    ) -> None:
        self.motion = motion
        self.runs, self.sampled, self.places, self.unknown = runs, sampled, places, unknown
        self.moved, self.roots, self.given, self.load = moved, roots, sizes, load
        self.rows = sum(run.residual.shape[0] for run in runs) * float(np.sum((roots * unknown.noise) ** 2))
        self._at = {spot_of(place): k for k, place in enumerate(places)}
        self._transfers: dict[tuple[View, int], np.ndarray] = {}
        self._laws: dict[tuple[Any, ...], DrivenLaw] = {}
        self._plain: View | None = None
        self._beside_free: dict[int, View | None] = {}

    @property
    def sure(self) -> bool:
        """Whether the diagram is linear along its runs: else laws and parameters change what others do."""
        return all(run.constant for run in self.runs)

    @cached_property
    def estimates(self) -> list[SignalEstimate]:
        """Free signals at all places that show, the likeliest first."""
        return self.unknown.estimates()

    @cached_property
    def carried(self) -> Mapping[str, float]:
        """What each place carries at most, smoothed with the likeliest free signal; `DOMINANT` and `ONSETS`."""
        smoothed = [self._smoothed[item.place].wires for item in self.estimates[:1]]
        wires = np.concatenate([*smoothed, [run.carried for run in self.runs]][0])
        sizes = {place.port: float(size) for place, size in zip(self.places, np.abs(wires).max(axis=0), strict=True)}
        return {**sizes, DOMINANT: self.dominant, **self.onsets}

    @cached_property
    def sizes(self) -> Mapping[str, float]:
        """The largest magnitude of signals, and what `sizes_at` takes beside them."""
        return {**self.given, **self.carried}

    @cached_property
    def dominant(self) -> float:
        """The frequency of the line that stands out most of the residual, or of the likeliest free signal [rad/s]."""
        dt = self.runs[0].dt
        lines = [dominant_line([run.residual / self.unknown.noise for run in self.runs], dt)]
        for item in self.estimates[:1]:
            lines.append(dominant_line(white(self._smoothed[item.place].added), dt))
        return max(lines, key=lambda line: line.ratio).frequency

    @cached_property
    def onsets(self) -> Mapping[str, float]:
        """The times at which the residual changes alike in all runs [s]."""
        residuals = [run.residual / self.unknown.noise for run in self.runs]
        return dict(zip(ONSETS, onset_times(residuals, [run.time for run in self.sampled]), strict=True))

    @property
    def deviance(self) -> float:
        """-2 log likelihood of the likeliest free signal, in the units of a misfit; infinite where none shows."""
        return self._factor * min((item.deviance for item in self.estimates), default=np.inf)

    @cached_property
    def _factor(self) -> float:
        """Misfit of a fit, of the squares of all samples in units of the noise: as many as are independent."""
        return float(np.mean((self.roots * self.unknown.noise) ** 2))

    def promises(self, items: Sequence[Insertion]) -> list[Promise | None]:
        """Return what laws promise at their places, None of what is no law of a signal there.

        What only adds a function of another signal does the same, but for a factor, at places that act in proportion.
        """
        found: dict[str, Promise] = {}
        alike: dict[tuple[Any, ...], list[_Placed]] = {}
        of_law: dict[Law, list[_Placed]] = {}
        for item in (one for one in map(self._placed, items) if one is not None):
            alike.setdefault(item.like, []).append(item)
        for first, *_ in alike.values():
            of_law.setdefault(first.item.law, []).append(first)
        for group in of_law.values():
            found |= self._of_law(group)
        for first, *others in alike.values():
            for one in others if first.item.key in found else ():
                found[one.item.key] = one.scaled(found[first.item.key], one.factor / first.factor)
        moved = {key: replace(one, start={**self.moved, **one.start}) for key, one in found.items() if one.start}
        return [{**found, **moved}.get(item.key) for item in items]

    def _of_law(self, group: Sequence[_Placed]) -> dict[str, Promise]:
        """Return what one law promises at places; of many pairs with another signal, the PAIRS best are fitted."""
        nonlinear = group[0].item.depends_on and not group[0].law.sizes.all()
        if not nonlinear or len(group) <= PAIRS:
            return self._promises(group, STEPS)
        shapes = self._promises(group, 0)
        best = sorted((one for one in group if one.item.key in shapes), key=lambda one: shapes[one.item.key].misfit)
        return shapes | self._promises(best[:PAIRS], STEPS)

    def _promises(self, group: Sequence[_Placed], steps: int) -> dict[str, Promise]:
        """Return what laws promise after some steps; without those that linear theory fails at, which are fitted."""
        found = {}
        for one in group:
            with suppress(*FAILURES):
                found[one.item.key] = self._promise(one, steps)
        return found

    def _placed(self, item: Insertion) -> _Placed | None:
        """Return a law at its place; None where it is no law of a signal, or there is no such place or other signal."""
        place = self._at.get(item.spot) if item.fault.enters == "signal" else None
        others = [k for k, other in enumerate(self.places) if other.port == item.depends_on][:1]
        if place is None or (item.depends_on and not others):
            return None
        sizes = sizes_at(item, self.sizes)
        given = starts_of(item, sizes)
        law = self._law(item, {**scales_of(item, given[0]), **fixed_of(item, sizes)}, limits_of(item, sizes))
        starts = [np.array([start[key] for key in item.fault.free]) for start in given]
        first, factor = self._proportional[place] if item.depends_on and item.fault.adds else (place, 1.0)
        return _Placed(item, law, (place, *others), starts, (item.law, item.depends_on, first), factor)

    @cached_property
    def _proportional(self) -> list[tuple[int, float]]:
        """Of each place the first that acts in proportion to it, and the factor of signals there that do the same."""
        return self.unknown.proportional(range(len(self.places)))

    def _promise(self, one: _Placed, steps: int) -> Promise:
        """Return what a law promises at its place after some steps."""
        place = one.wires[0]
        free = self._free.get(place, 0.0 if np.isfinite(self.unknown.scales[place]) else np.inf)
        if free > POSSIBLE * max(min(self._free.values(), default=np.inf), self.rows):
            return Promise(free, {})  # no law leaves less than a free signal does there
        best = Promise(np.inf, {})
        for carried, view in self._ways(place):
            misfit, eta = self._fitted(one, [wire[:, one.wires] for wire in carried], view, steps)
            if misfit < min(best.misfit, view.before - WORTH if view.offset else np.inf):
                best = Promise(misfit, dict(zip(one.item.free, eta.tolist(), strict=True)))
        return best

    @property
    def classes(self) -> tuple[PlaceClass, ...]:
        """The classes of places that no data separate, with their probabilities, the likeliest first."""
        deviance = {item.place: self._factor * item.deviance for item in self.estimates}
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
        """The misfit of a free signal at each place, in the units of a fit; of those that have a steady filter."""
        return {item.place: self._factor * item.misfit for item in self.estimates}

    def _fitted(self, one: _Placed, wires: Sequence[np.ndarray], view: View, steps: int) -> tuple[float, np.ndarray]:
        """Return the misfit and the parameters of a law: the best start, then Gauss-Newton steps where it is worth it.

        What a start adds may be of any size at first, so that a start need only be of the right shape.
        """

        def added(eta: np.ndarray, *, slopes: bool = False) -> np.ndarray:
            """Return what the law changes beside the diagram's parameters, weighted, (rows, 1 (+ m))."""
            return self._beside(view, one.wires[0], law.added(eta, self.sampled, wires, slopes=slopes))

        law, residual, before = one.law, view.residual, view.before
        trials = self._likely_starts(one, wires)
        every = [law.added(eta, self.sampled, wires, slopes=False) for eta in trials]
        together = [np.concatenate(own, axis=1) for own in zip(*every, strict=True)]
        shapes = [*self._beside(view, one.wires[0], together).T]
        products = [(float(a @ residual), float(a @ a)) for a in shapes]
        gains = [max(by, 0.0) ** 2 / max(square, 1e-300) for by, square in products]
        k = int(np.argmax(gains))
        if not law.sizes.any():  # what it adds is of its size; where none of them helps, the shape tells
            falls = [2 * by - square for by, square in products]
            k = int(np.argmax(falls)) if max(falls) > 0 else k
        eta, least = trials[k], before - gains[k]
        if not np.isfinite(gains[k]) or gains[k] < WORTH:
            return least, eta
        if law.sizes.any():  # of the size at once, or the first step changes where the law begins to act instead
            factor = float(shapes[k] @ residual) / float(shapes[k] @ shapes[k])
            eta = law.within(np.where(law.sizes, factor * eta, eta))
            shapes[k] = added(eta)[:, 0] if steps else factor * shapes[k]
        left = residual - shapes[k]
        here = float(left @ left)
        for _ in range(steps):
            slopes = added(eta, slopes=True)[:, 1:]
            norm = np.linalg.norm(slopes, axis=0)
            scaled = slopes / np.where(norm > 0, norm, 1.0)
            H, g, fell = scaled.T @ scaled, scaled.T @ left, 0.0
            promised = float(g @ np.linalg.lstsq(H, g, rcond=1e-12)[0])
            if promised < SETTLED * here:
                break
            for damping in DAMPED:
                step = np.linalg.lstsq(H + damping * np.eye(len(H)), g, rcond=1e-12)[0] / np.where(norm > 0, norm, 1.0)
                trial = law.within(eta + step)
                after = residual - added(trial)[:, 0]
                if (cost := float(after @ after)) < here:
                    linear = isclose(here - cost, promised, rel_tol=SETTLED)
                    fell = 0.0 if linear else 1 - cost / here
                    eta, left, here = trial, after, cost
                    break
            if fell < SETTLED:
                break
        here += view.offset
        return (here if here < least or not np.isfinite(least) else max(least, 0.0)), eta

    def _likely_starts(self, one: _Placed, wires: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return the starts of a law; of very many, those that add most nearly what is missing, but for a constant.

        As smoothed, and as outputs show it at once; where neither is known, the first of them.
        """
        starts = [one.law.within(eta) for eta in one.starts]
        is_likely = one.wires[0] in {item.place for item in self.estimates[:SMOOTHED_PLACES]}
        if len(starts) <= (STARTS_COMPARED if is_likely else STARTS_TRIED):
            return starts
        known = [self._smoothed[one.wires[0]].added if is_likely else None, self._shown_at_once(one.wires[0])]
        missing = [np.concatenate(signal) for signal in known if signal is not None]
        if not missing:
            return starts[:STARTS_TRIED]
        added = (np.concatenate(one.law.added(eta, self.sampled, wires, slopes=False))[:, 0] for eta in starts)
        left = np.array([[np.var(signal - each) for signal in missing] for each in added])
        best = np.argsort(left, axis=0, kind="stable")[:STARTS_TRIED]
        return [starts[k] for k in dict.fromkeys(best.ravel().tolist())]

    def _shown_at_once(self, place: int) -> list[np.ndarray] | None:
        """Return what outputs that pass a place on at once lack of it in each run (N,), by least squares; else None."""
        found = []
        for run in self.runs:
            through = run.responses(place, np.eye(len(run.residual), 1))[0, :, 0] * self.roots
            if not (power := float(through @ through)):
                return None
            found.append((run.residual * self.roots) @ through / power)
        return found

    def _ways(self, place: int) -> Iterator[tuple[list[np.ndarray], View]]:
        """Yield what all places carry in each run (N, P), and how misfits are judged.

        As simulated, by the outputs; at a likely place as smoothed with the free signal there, by the outputs, and
        beside a weaker free signal. By the outputs alone where the motion is known.
        """
        if self._plain is None:
            self._plain = View.of(self.runs, self.roots)
        if self.motion is not None:
            yield [*self.motion], self._plain
            return
        likely = {item.place: item for item in self.estimates[:SMOOTHED_PLACES]}
        if place not in likely:
            yield [run.carried for run in self.runs], self._plain
            return
        item = likely[place]
        carried = self._smoothed[place].wires
        yield carried, self._plain
        alike = next((k for k in self._beside_free if isclose(likely[k].deviance, item.deviance, rel_tol=ALIKE)), place)
        if alike not in self._beside_free:
            filters = self.unknown.whitening(place, WEAKER * item.strength)
            root = float(np.sqrt(np.mean((self.roots * self.unknown.noise) ** 2)))
            self._beside_free[place] = None if filters is None else View.of(self.runs, np.array(root), filters)
        if (view := self._beside_free[alike]) is not None:
            yield carried, view

    @cached_property
    def _smoothed(self) -> dict[int, Smoothed]:
        """The estimated signals of the likeliest places."""
        likely = self.estimates[:SMOOTHED_PLACES]
        return {item.place: one for item, one in zip(likely, self.unknown.smoothed(likely), strict=True)}

    def _beside(self, view: View, place: int, added: Sequence[np.ndarray]) -> np.ndarray:
        """Return what signals (N, K) that are added at a place in each run change in a view, (rows, K)."""
        sizes = {len(one) for one in added}
        if len(sizes) > 1 or not all(run.constant for run in self.runs):
            return view.beside([run.responses(place, one) for run, one in zip(self.runs, added, strict=True)])
        [N] = sizes
        size = next_fast_len(2 * N, real=True)
        if (view, place) not in self._transfers:  # of linear diagrams: responses, filtered, to an impulse
            impulses = view.weigh([run.responses(place, np.eye(N, 1)) for run in self.runs])
            self._transfers[view, place] = rfft(impulses.reshape(len(added), N, -1, 1), size, axis=1)
        product = self._transfers[view, place] * rfft(np.stack(added), size, axis=1)[:, :, None]
        return view.without_parameters(irfft(product, size, axis=1)[:, :N].reshape(-1, product.shape[-1]))

    def _law(
        self, item: Insertion, values: Mapping[str, float], limits: Mapping[str, tuple[float, float]]
    ) -> DrivenLaw:
        """Return a law alone, driven by a wire, with its parameters free; values: of some parameters."""
        parameters = {**item.values, **values}
        key = (item.kind, tuple(sorted((k, str(v)) for k, v in parameters.items())), tuple(sorted(limits.items())))
        if key not in self._laws:
            [(taken, given)] = item.fault.through.items()
            inputs = {WIRE: taken, **({OTHER: item.fault.argument} if item.depends_on else {})}
            driving = {name: (port, ()) for name, port in inputs.items()}
            diagram = self.load(item.alone(parameters, limits, driving, given))
            names = [f"{name}.output" for name in inputs]
            equations = driven_equations(diagram, [f"{LAW_ALONE}.{given}"], names, diagram.free)
            self._laws[key] = DrivenLaw(Simulation(equations), item.fault)
        return self._laws[key]


@dataclass(frozen=True, eq=False)
class _Placed:
    """A law at its place: wires, the place and that of the other signal that it may depend on; starts, each (m,).

    like: the same for laws that promise the same, but for factors of what they add.
    """

    item: Insertion
    law: DrivenLaw
    wires: tuple[int, ...]
    starts: Sequence[np.ndarray]
    like: tuple[Any, ...]
    factor: float

    def scaled(self, promise: Promise, factor: float) -> Promise:
        """Return what is promised where the law adds as much, but for a factor."""
        keys = zip(self.item.free, promise.start.values(), self.law.sizes, strict=False)
        return Promise(promise.misfit, {key: value * factor if size else value for key, value, size in keys})
