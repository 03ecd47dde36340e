"""Draw a case: plant, true parameters, runs, recorder, what is missing, and what least squares make of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import log

import numpy as np

from benchmarks.generic import measuring
from benchmarks.generic.effects import Effect, effects_of, scale, sized
from benchmarks.generic.excitation import KINDS as EXCITATIONS
from benchmarks.generic.excitation import course, drive
from benchmarks.generic.fitting import chi, fit
from benchmarks.generic.laws import log_uniform
from benchmarks.generic.native import Array, System, simulate, simulate_all
from benchmarks.generic.plants import PLANTS, Plant

KINDS = ("nothing", "one", "two", "outside")
MIX = (25, 55, 10, 10)
OFF = (0.1, 0.3)  # of the written parameters, either way
CHI = (2.0, 40.0)  # of the diagram refitted, log-uniform
PAIR = (4.0, 30.0)  # of each of two effects, alone
ALONE = 1.7  # least misfit, without noise, of either of two where the other is known
EXACT = 1e-3  # error of the integration over the noise floor, rms of the worst channel and run
IDENTIFY = 3


@dataclass
class Case:
    """A case, before it is measured. runs: samples x inputs; the first three are to identify, the others held out."""

    name: str
    kind: str
    plant: Plant
    parameters: tuple[float, ...]
    runs: list[Array]
    excitations: list[str]
    recorders: list[measuring.Recorder]
    series: list[Array]  # of a disturbance, for each run
    effects: tuple[Effect, ...] = ()
    substeps: int = 8
    error: float = 0.0
    attempts: int = 0
    clean: list[Array] = field(default_factory=list)  # what all runs record, without the recorder's errors

    @property
    def floors(self) -> Array:
        """Return the rms of the recorder's errors of each channel."""
        return np.array([recorder.floor for recorder in self.recorders])

    def system(self, parameters: Sequence[float], effects: Sequence[Effect]) -> System:
        """Return what is simulated with these parameters and effects."""
        plant = self.plant
        linear = tuple(item.linear for item in plant.inputs)
        acting = tuple(effect.acting for effect in effects)
        sizes = (plant.number, len(plant.channels), len(plant.places))
        return System(*sizes, tuple(parameters), plant.start, linear, acting)

    def simulate(
        self, parameters: Sequence[float], effects: Sequence[Effect], runs: slice = slice(None), finer: int = 1
    ) -> list[Array] | None:
        """Return what runs record, without the recorder's errors; None where one diverges."""
        system, steps = self.system(parameters, effects), self.substeps * finer
        return simulate_all(system, self.runs[runs], self.plant.rate, steps, self.series[runs])

    def model(self, effects: Sequence[Effect]) -> tuple[Callable[[Array, slice], list[Array] | None], Array]:
        """Return the structure with effects as a function of scaled parameters and runs, and the true ones.

        Free parameters count in logarithms of the written ones, numbers of effects in multiples of the true ones.
        """
        plant = self.plant
        where = [plant.parameters.index(name) for name in plant.free]
        start = [log(self.parameters[k] / plant.written(plant.parameters[k])) for k in where]
        start += [1.0 for effect in effects for _ in effect.fitted]

        def simulated(theta: Array, runs: slice) -> list[Array] | None:
            parameters, used = list(self.parameters), []
            for k, value in zip(where, theta, strict=False):
                parameters[k] = plant.written(plant.parameters[k]) * float(np.exp(value))
            rest = list(theta[len(where) :])
            for effect in effects:
                values = list(effect.values)
                for k in effect.fitted:
                    values[k] *= float(rest.pop(0))
                if "delay" in effect.law.numbers and values[0] <= 0.02 / plant.rate:
                    return None
                used.append(replace(effect, values=tuple(values)))
            return self.simulate(parameters, used, runs)

        return simulated, np.array(start)


def refit(
    case: Case, effects: Sequence[Effect], measured: Sequence[Array], fresh: bool = False
) -> tuple[Array, float, Callable[[Array, slice], list[Array] | None]]:
    """Return the fitted parameters of a structure, its chi on the runs to identify, and its model.

    From the true parameters, and with fresh from the written ones too.
    """
    model, start = case.model(effects)
    first = slice(0, IDENTIFY)
    starts = [start]
    if fresh:
        starts.append(np.where(np.arange(len(start)) < len(case.plant.free), 0.0, start))
    found = [fit(lambda theta: model(theta, first), measured, case.floors, begin) for begin in starts]
    theta, misfit = min(found, key=lambda item: item[1])
    return theta, misfit, model


def make_case(
    name: str, kind: str, plant_name: str, seed: Sequence[int], number: int = 0, only: Sequence[str] = ()
) -> Case:
    """Return a case. It depends on its arguments alone; number: which of the plant's effects comes first.

    Raises:
        RuntimeError: no effect could be made visible
    """
    rng, plant = np.random.default_rng(list(seed)), PLANTS[plant_name]
    case = _plain(name, kind, plant, rng)
    if kind != "nothing":
        _conceal(case, rng, number, only, seed)
    elif not _converges(case):
        raise RuntimeError(f"{name}: the integration of {plant_name} does not converge")
    return case


def _plain(name: str, kind: str, plant: Plant, rng: np.random.Generator) -> Case:
    """Return a case in which nothing is missing."""
    parameters = []
    for key in plant.parameters:
        off = rng.uniform(*OFF) * rng.choice([-1.0, 1.0])
        parameters.append(plant.written(key) * (1.0 + off if key in plant.free else 1.0))
    samples = int(rng.integers(4000, 5001))
    kinds = [str(k) for k in rng.permutation(EXCITATIONS)]
    kinds += [str(k) for k in rng.permutation(EXCITATIONS)[: rng.integers(0, 2)]]
    runs, series = [], []
    for k, excitation in enumerate(kinds):
        size = rng.uniform(0.7, 1.0) if k < IDENTIFY else rng.uniform(0.6, 1.05)
        runs.append(drive(plant, excitation, samples, size, rng))
        disturbance = course("random", samples, plant.rate, plant.inputs[0].top / 2, rng)
        series.append(disturbance / disturbance.std())
    case = Case(name, kind, plant, tuple(parameters), runs, kinds, [], series)
    quiet = case.simulate(parameters, (), slice(0, IDENTIFY))
    if quiet is None:
        raise RuntimeError(f"{plant.name}: diverges with nothing missing")
    ranges = np.ptp(np.concatenate(quiet), axis=0) / 2
    case.recorders = [measuring.draw(float(half), plant.rate, rng) for half in ranges]
    return case


def _conceal(case: Case, rng: np.random.Generator, number: int, only: Sequence[str], seed: Sequence[int]) -> None:
    """Put effects into a case, of a strength that leaves the misfit that was drawn; the next ones if that fails."""
    system = case.system(case.parameters, ())
    taps = [simulate(system, run, case.plant.rate, case.substeps, taps=True)[1] for run in case.runs[:IDENTIFY]]
    seen = [tap for tap in taps if tap is not None]
    pool = effects_of(case.plant, case.kind == "outside")
    order = np.random.default_rng([int(seed[0]), case.plant.number]).permutation(len(pool))  # the same in a set
    turn = [pool[k] for k in order]
    turn = [effect for effect in turn if not only or {effect.law.key, effect.law.physics} & set(only)]
    if not turn:
        raise ValueError(f"{case.plant.name} has none of {', '.join(only)} of kind {case.kind}")
    targets = PAIR if case.kind == "two" else CHI
    for attempt in range(3 * len(turn)):
        case.attempts = attempt + 1
        target = log_uniform(rng, *targets)
        first = _strong(case, turn[(number + attempt) % len(turn)], seen, target, [*seed, attempt])
        if first is None:
            continue
        chosen = [first]
        if case.kind == "two":
            others = [effect for effect in pool if effect.law.physics != first.law.physics]
            other = others[int(rng.integers(len(others)))]
            target = log_uniform(rng, *targets)
            second = _strong(case, other, seen, target, [*seed, attempt, 1])
            if second is None:
                continue
            chosen.append(second)
            clean = case.simulate(case.parameters, chosen, slice(0, IDENTIFY))
            if clean is None or any(refit(case, [one], clean)[1] < ALONE for one in chosen):
                continue  # each must be missed where the other is known
        case.effects = tuple(chosen)
        if _converges(case):
            return
        case.substeps = 8
    raise RuntimeError(f"{case.name}: no effect of {case.plant.name} leaves a misfit of {targets[0]:g}")


def _strong(case: Case, effect: Effect, taps: list[Array], target: float, seed: Sequence[int]) -> Effect | None:
    """Return an effect of the strength that leaves a misfit of target after a refit; None if no strength does.

    By bisection; a misfit that does not grow evenly ends within a factor of CHI.
    """
    by = scale(effect, taps, len(case.runs[0]) / case.plant.rate)
    low, high = 0.0, 1.0
    best: tuple[float, Effect] | None = None
    for step in range(9):
        strength = 1.0 if step == 0 else (low + high) / 2
        trial = sized(effect, strength, by, seed)
        clean = case.simulate(case.parameters, [trial], slice(0, IDENTIFY))
        if clean is None:
            high = strength
            continue
        misfit = float(np.hypot(1.0, refit(case, (), clean)[1]))
        if CHI[0] <= misfit <= CHI[1] and (best is None or abs(log(misfit / target)) < abs(log(best[0] / target))):
            best = (misfit, trial)
        if best is not None and abs(log(best[0] / target)) < 0.1:
            break
        if misfit > target:
            high = strength
        elif step == 0:
            break  # the strongest leaves less
        else:
            low = strength
    return best[1] if best else None


def _converges(case: Case) -> bool:
    """Simulate all runs with steps so short that half of them changes less than EXACT of the noise floor.

    False if none is: a motion that diverges, or that depends on everything before (limits of a loop that cycles).
    """
    coarse = case.simulate(case.parameters, case.effects)
    while coarse is not None and case.substeps <= 256:
        fine = case.simulate(case.parameters, case.effects, finer=2)
        if fine is None:
            return False
        case.error = max(
            float((np.sqrt(((a - b) ** 2).mean(axis=0)) / case.floors).max()) for a, b in zip(coarse, fine, strict=True)
        )
        if case.error < EXACT / 2:  # first order, at worst: the finer one is as far from the truth
            case.clean = fine
            return True
        case.substeps *= 2
        coarse = fine
    return False


def score(case: Case, simulated: Sequence[Array], measured: Sequence[Array]) -> tuple[float, dict[str, float], float]:
    """Return chi, nrmse of each channel and in total: rms of measured - model over the standard deviation."""
    square = np.mean([((s - m) ** 2).mean(axis=0) for s, m in zip(simulated, measured, strict=True)], axis=0)
    spread = np.concatenate(list(measured)).std(axis=0)
    each = np.sqrt(square) / spread
    names = [name for name, _, _ in case.plant.channels]
    total = float(np.sqrt((each**2).mean()))
    return chi(simulated, measured, case.floors), dict(zip(names, map(float, each), strict=True)), total
