"""Name what is missing: every row of the catalogue at every place is put into the diagram, refitted and judged."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.harmonic import Fit, Source
from rotorsim.diagnosis.search.proof import MOST
from rotorsim.diagnosis.search.trials import Candidate, Round, Trials, is_adequate, is_noise
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.identification.coordinates import ANGLE_UNIT
from rotorsim.jobs.jobs import Jobs, local_workers

__all__ = ["Candidate", "Named", "Round", "least_gain", "name_missing", "without_effects", "without_last"]

# of the equations, in the misfit: what meshes get wrong where another mesh is the truth. Meshes are refined until a
# finer one changes 0.02 of them (`base.VISIBLE`); the sum of what still finer ones would change is five times that
MESH_ERROR = 0.1
# criterion within which two explanations are not told apart: odds of e^5 = 148 to 1, from which evidence counts as very
# strong (Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795, section 3.2)
CLASS = 10.0
MOST_EFFECTS = 3
# probability that noise alone makes any row of the catalogue look as good, by Bonferroni; 200 healthy machines of
# benchmarks/concealed/results/nuisances_1617.md keep it
FALSE_ALARM = 0.01
# share of what is left unexplained that one more effect must explain: details of the first law are many and small, so
# that none of them is most of the rest
WORTH = 0.9
BEAM = 2  # explanations that the next round starts from
TOLD = 2.0  # standard deviations below which a parameter of a law is tried without: it goes where the criterion falls


@dataclass(frozen=True, eq=False)
class Named:
    """base: the diagram as given, refitted. chosen: the effects, in the order in which they were found; fit: with all.

    rounds: what was tried for each of them, with all others in place. level: probability of a false alarm for each.
    slack: of the misfit, what says nothing because meshes are not exact. first: the round in which all was tried.
    """

    base: Fit
    chosen: tuple[Candidate, ...]
    rounds: tuple[Round, ...]
    fit: Fit
    level: float
    counts: Mapping[str, int] = field(default_factory=dict)
    slack: float = 0.0
    first: Round | None = None

    @property
    def explained(self) -> bool:
        """Whether what is left over is noise; faint lines, where they are all that the diagram as given leaves over."""
        return is_adequate(self.fit) and (is_noise(self.fit) or not is_adequate(self.base))

    @property
    def share(self) -> float:
        """The share of what the diagram as given leaves over beyond noise that the effects explain."""
        return _share(self.fit, self.base)

    @property
    def mostly(self) -> bool:
        """Whether the effects explain most of what was to be explained: what is left may be details of their laws."""
        return bool(self.chosen) and not is_adequate(self.base) and self.share >= MOST

    @property
    def explains(self) -> bool:
        """Whether the effects explain all of it, or most."""
        return self.explained or self.mostly


def without_effects(named: Named) -> Named:
    """Return a search whose effects do not count."""
    first = named.first or named.rounds[0]
    return replace(named, chosen=(), rounds=(first,), fit=named.base)


def without_last(named: Named) -> Named:
    """Return a search without the effect that was found beside all others."""
    if len(named.chosen) < 2:
        return without_effects(named)
    return replace(named, chosen=named.chosen[:-1], rounds=named.rounds[:-1], fit=named.chosen[-2].fit)


def name_missing(
    base: Fit,
    source: Source,
    *,
    registry: Registry | None = None,
    physics: Collection[str] | None = None,
    most: int = MOST_EFFECTS,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Named:
    """Return what explains a recording that the fitted diagram ``base`` does not, effect by effect.

    physics: rows of the catalogue that are tried (default: all).
    Raises RotorsimError.
    """
    with local_workers(Jobs(workers, scheduler, progress)) as jobs:
        return _named(Trials(source, registry, physics, jobs), base, most)


def _named(trials: Trials, base: Fit, most: int) -> Named:
    trials.nominal = {item.name: item.value for item in base.free if item.unit != ANGLE_UNIT}
    trials.slack = slack = MESH_ERROR * base.rows if trials.has_mesh(base) else 0.0
    first = trials.round(base)
    level = _level(first.tried)
    worth = _noticed(first.tried, base, level, slack) if is_adequate(base) else first.tried
    beam: list[tuple[Candidate, ...]] = [(item,) for item in _distinct(worth, base)[:BEAM]]
    if not beam:
        return Named(base, (), (first,), base, level, trials.counts, slack)
    chosen: tuple[Candidate, ...] = beam[0]
    rounds = [first]
    while not is_adequate(chosen[-1].fit) and len(chosen) < most:
        grown: list[tuple[tuple[Candidate, ...], Round]] = []
        for path in beam:
            after = trials.round(path[-1].fit)
            for item in _distinct(after.tried, path[-1].fit)[:1]:
                grown.append(((*path, item), after))
            if grown and is_adequate(grown[-1][0][-1].fit):
                break
        if not grown:
            break
        grown.sort(key=lambda pair: pair[0][-1].fit.criterion)
        best, after = grown[0]
        if not is_adequate(best[-1].fit) and _share(best[-1].fit, chosen[-1].fit) < WORTH:
            break
        beam, chosen = [path for path, _ in grown], best
        rounds = [*rounds, after]
    if is_adequate(chosen[-1].fit) or _share(chosen[-1].fit, base) >= MOST:
        chosen, rounds = _reconsidered(trials, base, chosen, rounds)
        chosen, rounds = _completed(trials, chosen, rounds)
        chosen = _simplified(trials, chosen)
    return Named(base, chosen, tuple(rounds), chosen[-1].fit, level, trials.counts, slack, first)


def _completed(
    trials: Trials, chosen: tuple[Candidate, ...], rounds: list[Round]
) -> tuple[tuple[Candidate, ...], list[Round]]:
    """Return the choice with its known look-alikes fitted to the end beside the others; the last may give way to one.

    Look-alikes: what a declaration names as ``confused_with``, one way or the other.
    """
    rounds = list(rounds)
    for k, item in enumerate(chosen):
        rounds[k] = trials.completed(rounds[k], _alike(item, rounds[k]))
    best = rounds[len(chosen) - 1].best
    if best is not None and best.fit.criterion < chosen[-1].fit.criterion - trials.slack:
        chosen = (*chosen[:-1], best)
    return chosen, rounds


def _alike(item: Candidate, found: Round) -> set[str]:
    """Return the physics that are declared to read like an effect."""
    own, name = set(item.insertion.fault.confused_with), item.insertion.physics
    return own | {other.insertion.physics for other in found.tried if name in other.insertion.fault.confused_with}


def _simplified(trials: Trials, chosen: tuple[Candidate, ...]) -> tuple[Candidate, ...]:
    """Return the choice without parameters of its laws whose size the data do not tell from zero.

    One by one, the least told first, with the angle that means nothing without it, while the criterion falls.
    """
    fit = chosen[-1].fit
    while True:
        names = [item.name for item in fit.free]
        told: dict[str, float] = {}
        for effect in chosen:
            own = [name for name in effect.insertion.free if name in names]
            for name in own:
                j = names.index(name)
                item, std = fit.free[j], float(np.sqrt(max(fit.covariance[j, j], 0.0)))
                may_be_zero = item.unit != ANGLE_UNIT and item.low <= 0 <= item.high
                if may_be_zero and abs(fit.theta[j]) <= TOLD * std and len({*own} - _with_angle(name, own)) > 0:
                    told[name] = abs(float(fit.theta[j])) / std if std else 0.0
        for name in sorted(told, key=lambda name: told[name]):
            gone = _with_angle(name, names)
            document = values_in(fit.document, {**fit.values, name: 0.0})
            document["identify"] = {key: value for key, value in document["identify"].items() if key not in gone}
            less = trials.source.fit(document, [[{}]])
            if not less.failure and less.criterion < fit.criterion:
                fit = less
                break
        else:
            return (*chosen[:-1], Candidate(chosen[-1].insertion, fit)) if fit is not chosen[-1].fit else chosen


def _with_angle(name: str, names: Collection[str]) -> set[str]:
    """Return a parameter with the angle of the same pair, where there is one."""
    block, _, key = name.rpartition(".")
    letters = key.rstrip("0123456789")
    angles = {f"{block}.{key.replace('amplitude', 'phase')}", f"{block}.{letters}_phase{key[len(letters) :]}"}
    return {name, *(angles & set(names))}


def _reconsidered(
    trials: Trials, base: Fit, chosen: tuple[Candidate, ...], rounds: list[Round]
) -> tuple[tuple[Candidate, ...], list[Round]]:
    """Return the choice without effects that others make superfluous, each tried again beside the others.

    Effects are found one by one, so that an early one may stand for what a later one explains better.
    """
    k = 0
    while len(chosen) > 1 and k < len(chosen):
        others = trials.refitted(base, [item for j, item in enumerate(chosen) if j != k], chosen[-1].fit)
        if not others:  # they cannot be fitted without it
            k += 1
            continue
        without = others[-1].fit
        if without.criterion <= chosen[-1].fit.criterion + trials.slack:
            chosen = others
            rounds = [item for j, item in enumerate(rounds) if j != k]
            k = 0
            continue
        if k == len(chosen) - 1:  # it was found beside all the others
            break
        again = trials.round(without)  # all: what was rejected before stood beside less
        rounds[k] = again
        best = again.best
        if best is not None and best.fit.criterion < chosen[-1].fit.criterion - CLASS - trials.slack:
            chosen = (*others, best)
            rounds = [*(item for j, item in enumerate(rounds) if j != k), again]
            k = 0
            continue
        k += 1
    return chosen, rounds


def _level(tried: Sequence[Candidate]) -> float:
    """Return the probability of a false alarm that one of these candidates may take up."""
    ways = {(item.insertion.physics, item.insertion.spot) for item in tried if not item.fit.failure}
    return FALSE_ALARM / max(len(ways), 1)


def least_gain(item: Candidate, base: Fit, level: float) -> float:
    """Return the drop of the misfit that noise alone makes by the unknowns of a candidate with probability level.

    A nonlinear law has one more: where it begins to act is chosen, too.
    """
    more = len(item.fit.free) - len(base.free) + max(item.fit.nuisances - base.nuisances, 0) + item.fit.nonlinear
    return float(chi2.isf(level, max(more, 1)))


def _share(after: Fit, before: Fit) -> float:
    """Return the share of what was left unexplained before that is explained after."""
    return 1 - (after.misfit - after.freedom) / max(before.misfit - before.freedom, 1.0)


def _noticed(tried: Sequence[Candidate], base: Fit, level: float, slack: float) -> list[Candidate]:
    """Return the candidates that explain more than noise and meshes would have them explain."""
    return [
        item
        for item in tried
        if not item.fit.failure and base.misfit - item.fit.misfit > least_gain(item, base, level) + slack
    ]


def _distinct(tried: Sequence[Candidate], before: Fit) -> list[Candidate]:
    """Return the physical candidates that explain more than before, the best of each physics."""
    best: dict[str, Candidate] = {}
    for item in tried:
        if not item.fit.failure and item.physical and item.fit.criterion < before.criterion:
            best.setdefault(item.insertion.physics, item)
    return list(best.values())


def where(tried: Sequence[Candidate], scale: float) -> list[tuple[Spot, float]]:
    """Return the probability of every spot, by the best candidate there; scale: variance of the noise, as a factor."""
    best: dict[Spot, float] = {}
    for item in tried:
        if not item.fit.failure:
            spot = item.insertion.spot
            best[spot] = min(best.get(spot, np.inf), item.fit.criterion)
    if not best:
        return []
    least = min(best.values())
    weights = {spot: float(np.exp(-0.5 * (value - least) / max(scale, 1.0))) for spot, value in best.items()}
    total = sum(weights.values())
    return sorted(((spot, weight / total) for spot, weight in weights.items()), key=lambda pair: -pair[1])
