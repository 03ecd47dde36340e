"""Forward selection: the effects that explain a recording, one a round, and what is reconsidered at the end."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.evidence.disturbance import disturbance
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate, is_noise
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass
from rotorsim.diagnosis.search.candidates import SAME, Candidate, Round
from rotorsim.diagnosis.search.growing import told_by_drift
from rotorsim.diagnosis.search.idle import nested, simplified, without_idle
from rotorsim.diagnosis.search.promises import level_of, noticed_from
from rotorsim.diagnosis.search.trials import Trials
from rotorsim.jobs.jobs import Jobs

BEAM_WIDTH = 2  # hypotheses that the next round starts from
LAW_AND_PLACE_TURNS = 3  # from a law to its places, and from a place to its laws


@dataclass(frozen=True, eq=False)
class Selection:
    """base: the diagram as given, refitted. chosen: the effects, in the order in which they were found; fit: with all.

    rounds: what was tried for each of them, with all others in place. level: probability of a false alarm for each.
    slack: of the misfit, what says nothing because meshes are not exact. first: the round in which all was tried.
    searched: every round, by the diagram that it began with.
    """

    base: Fit
    chosen: tuple[Candidate, ...]
    rounds: tuple[Round, ...]
    fit: Fit
    level: float
    counts: Mapping[str, int]
    slack: float
    first: Round
    searched: Mapping[str, Round] = field(default_factory=dict)

    @property
    def explained(self) -> bool:
        """Whether noise can make the residual; faint lines, where nothing else is unexplained at first."""
        return is_adequate(self.fit) and (is_noise(self.fit) or not is_adequate(self.base))

    @property
    def share(self) -> float:
        """The share of the misfit of the diagram as given beyond noise that the effects explain."""
        return _share(self.fit, self.base)

    @property
    def mostly(self) -> bool:
        """Whether the effects explain most of the misfit: the residual may be details of their laws."""
        return bool(self.chosen) and not is_adequate(self.base) and self.share >= CRITERIA.cause

    @property
    def explains(self) -> bool:
        """Whether the effects explain all of it, or most."""
        return self.explained or self.mostly


def without_effects(selection: Selection) -> Selection:
    """Return the selection result without its effects."""
    return replace(selection, chosen=(), rounds=(selection.first,), fit=selection.base)


def without_last(selection: Selection) -> Selection:
    """Return the selection result without the effect that was found beside all others."""
    if len(selection.chosen) < 2:
        return without_effects(selection)
    return replace(selection, chosen=selection.chosen[:-1], rounds=selection.rounds[:-1], fit=selection.chosen[-2].fit)


def with_faint(selection: Selection) -> Selection:
    """Return the selection result with the effect that explains most beyond chance, be it less than meshes may."""
    noticed = _noticed(selection.first.tried, selection.base, selection.level, 0.0)
    best = next(iter(_distinct(noticed, selection.base)), None)
    return selection if best is None else replace(selection, chosen=(best,), rounds=(selection.first,), fit=best.fit)


def select_effects(
    base: Fit, evidence: Evidence, catalogue: Catalogue, jobs: Jobs, earlier: Selection | None = None
) -> Selection:
    """Return what explains a recording that the fitted diagram ``base`` does not, effect by effect (forward selection).

    earlier: with another measure of the noise. Raises RotorsimError.
    """
    trials = Trials(evidence, catalogue, jobs, {} if earlier is None else earlier.searched, base)
    return replace(_selected(trials, base, earlier), searched=trials.rounds)


def _selected(trials: Trials, base: Fit, earlier: Selection | None = None) -> Selection:
    slack = trials.slack
    first = _round(trials, base)
    level = _level(first)
    little = is_adequate(base) or base.misfit <= base.freedom + slack  # noise, or no more than meshes get wrong
    worth = _noticed(first.tried, base, level, slack) if little else first.tried
    beam: list[tuple[Candidate, ...]] = [(item,) for item in _distinct(worth, base)[:BEAM_WIDTH]]
    if not beam:
        return Selection(base, (), (first,), base, level, trials.counts, slack, first)
    half_left = beam[0][0].fit.misfit > base.misfit / 2
    if half_left and not is_adequate(base) and disturbance(base, first.classes, trials.evidence) is not None:
        return Selection(base, (), (first,), base, level, trials.counts, slack, first)
    chosen: tuple[Candidate, ...] = beam[0]
    rounds = [first]
    if earlier is not None and len(earlier.chosen) > 1:
        before = _found_before(trials, base, first, earlier)
        if before is not None and before[0][-1].fit.criterion < chosen[-1].fit.criterion:
            chosen, rounds = before
    while not is_adequate(chosen[-1].fit) and len(chosen) < CRITERIA.most_effects:
        if first.classes and _is_disturbed(chosen[-1].fit, trials.evidence):
            break
        grown: list[tuple[tuple[Candidate, ...], Round]] = []
        begun = {path[0].insertion.key for path in beam}
        for path in beam:
            grown += _grown(trials, base, path, begun)
            if any(is_adequate(path[-1].fit) for path, _ in grown):
                break
        if not grown:
            break
        grown.sort(key=lambda pair: pair[0][-1].fit.criterion)
        best, after = grown[0]
        if not _leaves_noise(best[-1].fit) and _share(best[-1].fit, chosen[-1].fit) < CRITERIA.worth:
            break
        beam, chosen = [path for path, _ in grown[:BEAM_WIDTH]], best
        rounds = [*rounds, after]
    if is_adequate(chosen[-1].fit) or _share(chosen[-1].fit, base) >= CRITERIA.cause:
        chosen, rounds = _reconsidered(trials, base, chosen, rounds)
        chosen, rounds = _completed(trials, base, chosen, rounds)
        chosen, rounds = _narrowed(trials, base, chosen, rounds)
        chosen = _simplified(trials, chosen)
        chosen, rounds = told_by_drift(trials.evidence, chosen, rounds, slack)
        first = next((found for found in rounds if found.before is base), first)  # with what was looked at since
    return Selection(base, chosen, tuple(rounds), chosen[-1].fit, level, trials.counts, slack, first)


def _is_disturbed(fit: Fit, evidence: Evidence) -> bool:
    """Return whether what a fit leaves is an unmeasured disturbance, which no further law explains."""
    places = evidence.bounds(fit)
    return places is not None and disturbance(fit, places.classes, evidence) is not None


def _found_before(
    trials: Trials, base: Fit, first: Round, earlier: Selection
) -> tuple[tuple[Candidate, ...], list[Round]] | None:
    """Return several effects of a selection by another measure of the noise, if they leave noise by this one, too.

    With the round of the last; `_reconsidered` looks for each of the others again.
    """
    again = trials.refitted(base, earlier.chosen, earlier.fit)
    if not again or not _leaves_noise(again[-1].fit):
        return None
    others = trials.refitted(base, again[:-1], again[-1].fit)
    if not others:
        return None
    last = _round(trials, others[-1].fit)
    best = last.best
    kept = best is None or best.fit.criterion >= again[-1].fit.criterion
    return again if kept or best is None else (*others, best), [*[first] * len(others), last]


def _grown(
    trials: Trials, base: Fit, path: tuple[Candidate, ...], begun: set[str]
) -> list[tuple[tuple[Candidate, ...], Round]]:
    """Return a path with the effect that explains most beside it, and the round in which that was found.

    A pair that leaves more than noise is begun with its second effect as well, where none was ``begun`` with it: the
    first, found alone, may imitate two at once. That comes before other firsts, which leave more alone.
    """
    after = _round(trials, path[-1].fit)
    found = [((*path, item), after) for item in _distinct(after.tried, path[-1].fit)[:1]]
    if len(path) > 1 or not found or _leaves_noise(found[0][0][-1].fit):
        return found
    [(pair, _)] = found
    alone = trials.refitted(base, pair[1:], pair[-1].fit)
    if alone and alone[0].insertion.key not in begun:
        begun.add(alone[0].insertion.key)
        after = _round(trials, alone[0].fit)
        found += [((*alone, item), after) for item in _distinct(after.tried, alone[0].fit)[:1]]
    return found


def _round(trials: Trials, before: Fit) -> Round:
    """Return a round in which nothing that promises as much as the best was left out.

    What imitates the law that is missing seldom does so at the place where that promises most; beside it another effect
    would be looked for in vain. Where the best leaves more than noise, all laws are tried at its place, and it where it
    promises as much; beside one that explains half, promises are those of its parameters and motion. Where fits
    are costly only look-alikes of what is chosen follow (`_completed`).
    """
    found = trials.round(before)
    beside: Candidate | None = None
    for _ in range(LAW_AND_PLACE_TURNS):
        best, nearest = found.best, found.nearest
        if best is None or nearest is None or not found.untried or trials.evidence.costly:
            break
        if not _leaves_noise(best.fit):
            found = trials.completed(found, (), best.insertion, every=True)
            nearest = found.nearest or nearest
        if nearest.fit.misfit <= before.misfit / 2 and nearest is not beside:
            found, beside = trials.beside(found, nearest), nearest
        if found.best is best and found.nearest is nearest:
            break
    return simplified(trials.evidence, found, trials.slack)


def _completed(
    trials: Trials, base: Fit, chosen: tuple[Candidate, ...], rounds: list[Round]
) -> tuple[tuple[Candidate, ...], list[Round]]:
    """Return the choice with its known look-alikes fitted to the end beside the others; the last may give way to one.

    Look-alikes: what a declaration names as ``confused_with``, one way or the other; at a place where the last explains
    more, all laws: what it imitates may not be declared. What explains more alone takes the place of several.
    """

    def completed(found: Round, physics: Collection[str], item: Candidate, *, every: bool = False) -> Round:
        more = trials.completed(found, physics, item.insertion, every=every)
        return simplified(trials.evidence, more, trials.slack)

    rounds = list(rounds)
    for k, item in enumerate(chosen):
        rounds[k] = completed(rounds[k], _alike(item, rounds[k]), item)
        alone = rounds[k].best if len(chosen) > 1 and rounds[k].before is base else None
        if alone is not None and alone.fit.criterion < chosen[-1].fit.criterion - trials.slack:
            return _completed(trials, base, (alone,), [rounds[k]])
    for _ in range(LAW_AND_PLACE_TURNS):
        best = rounds[len(chosen) - 1].best
        if best is None or best.fit.criterion >= chosen[-1].fit.criterion - trials.slack:
            break
        chosen = (*chosen[:-1], best)
        rounds[len(chosen) - 1] = completed(rounds[len(chosen) - 1], (), best, every=True)
    return chosen, rounds


def _narrowed(
    trials: Trials, base: Fit, chosen: tuple[Candidate, ...], rounds: list[Round]
) -> tuple[tuple[Candidate, ...], list[Round]]:
    """Return the choice with cases of its laws in their place, where these explain as much; see `nested`."""
    for k in reversed(range(len(chosen))):
        found, other = nested(trials.evidence, rounds[k], rounds[k].as_tried(chosen[k]), trials.slack)
        rounds = [*rounds[:k], found, *rounds[k + 1 :]]
        if other.insertion.key == chosen[k].insertion.key:
            continue
        if k == len(chosen) - 1:
            chosen = (*chosen[:-1], other)
        elif others := trials.refitted(base, [item for j, item in enumerate(chosen) if j != k], chosen[-1].fit):
            chosen, rounds = (*others, other), [*rounds[:k], *rounds[k + 1 :], found]
    return chosen, rounds


def _alike(item: Candidate, found: Round) -> set[str]:
    """Return the physics that are declared to read like an effect."""
    own, name = set(item.insertion.fault.confused_with), item.insertion.physics
    return own | {other.insertion.physics for other in found.tried if name in other.insertion.fault.confused_with}


def _simplified(trials: Trials, chosen: tuple[Candidate, ...]) -> tuple[Candidate, ...]:
    """Return the choice without parameters of its laws whose size the data do not tell from zero."""
    last = chosen[-1]
    fit = without_idle(trials.evidence, last.fit, [effect.insertion for effect in chosen])
    return chosen if fit is last.fit else (*chosen[:-1], Candidate(last.insertion, fit))


def _reconsidered(
    trials: Trials, base: Fit, chosen: tuple[Candidate, ...], rounds: list[Round]
) -> tuple[tuple[Candidate, ...], list[Round]]:
    """Return the choice without effects that others make superfluous, each tried again beside the others.

    Effects are found one by one, so that an early one may stand for what a later one explains better. Where the others
    cannot stand without it, its look-alikes are tried in its place.
    """
    k = 0
    while len(chosen) > 1 and k < len(chosen):
        others = trials.refitted(base, [item for j, item in enumerate(chosen) if j != k], chosen[-1].fit)
        if not others:  # they cannot be fitted without it
            chosen, rounds[k] = _exchanged(trials, base, chosen, rounds[k], k)
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
        again = _round(trials, without)  # all: what was rejected before stood beside less
        rounds[k] = again
        best = again.best
        if best is not None and best.fit.criterion < chosen[-1].fit.criterion - _margin(best, chosen[-1], trials.slack):
            chosen = (*others, best)
            rounds = [*(item for j, item in enumerate(rounds) if j != k), again]
            k = 0
            continue
        k += 1
    return chosen, rounds


def _exchanged(
    trials: Trials, base: Fit, chosen: tuple[Candidate, ...], found: Round, k: int
) -> tuple[tuple[Candidate, ...], Round]:
    """Return the choice with a look-alike in the place of effect k, where it explains more beside the others.

    And the round of effect k, with the fits of both beside the others, and of the one that is taken at its other
    likely places.
    """
    alike, best, beside = _alike(chosen[k], found), chosen, {chosen[k].insertion.key: chosen[-1].fit}

    def exchanged(rival: Candidate) -> tuple[Candidate, ...]:
        again = trials.refitted(base, [*chosen[:k], rival, *chosen[k + 1 :]], chosen[-1].fit, rival)
        if again:
            beside[rival.insertion.key] = again[-1].fit
        return again

    for rival in _distinct(found.tried, found.before):
        if rival.insertion.physics not in alike or rival.insertion.physics == chosen[k].insertion.physics:
            continue
        again = exchanged(rival)
        if again and again[-1].fit.criterion < best[-1].fit.criterion - _margin(again[-1], best[-1], trials.slack):
            best, taken = again, rival
    if best is chosen:
        return chosen, found
    reach = taken.fit.criterion + trials.slack + CRITERIA.equivalent
    for item in found.tried:
        same = item.insertion.physics == taken.insertion.physics and item.insertion.key not in beside
        if same and not item.fit.failure and item.fit.criterion <= reach:
            exchanged(item)
    tried = [replace(item, fit=beside.get(item.insertion.key, item.fit)) for item in found.tried]
    return best, replace(found, before=replace(found.before)).with_tried(tried, trials.slack)


def _margin(other: Candidate, chosen: Candidate, slack: float) -> float:
    """Return how much better another effect must be than the one that was found; a simpler one need only be better."""
    simpler = len(other.fit.free) < len(chosen.fit.free)
    return SAME if simpler else CRITERIA.equivalent + slack


def _level(found: Round) -> float:
    """Return the probability of a false alarm that one of the candidates of a round may take up."""
    tried = {(item.insertion.physics, item.insertion.spot) for item in found.tried if not item.fit.failure}
    return level_of(max(len(tried), found.hypotheses))


def least_gain(item: Candidate, base: Fit, level: float) -> float:
    """Return the drop of the misfit that noise alone makes by the unknowns of a candidate with probability level.

    A nonlinear law has one more: where it begins to act is chosen, too.
    """
    more = len(item.fit.free) - len(base.free) + max(item.fit.nuisances - base.nuisances, 0) + item.fit.nonlinear
    return noticed_from(more, level)


def _share(after: Fit, before: Fit) -> float:
    """Return the share of the misfit beyond noise before that is explained after."""
    return 1 - (after.misfit - after.freedom) / max(before.misfit - before.freedom, 1.0)


def _leaves_noise(fit: Fit) -> bool:
    """Return whether a fit is adequate and its misfit that of noise: the former may tolerate details (stretches)."""
    small = fit.misfit <= CRITERIA.model_error * fit.freedom
    return is_adequate(fit) and (small or float(chi2.sf(fit.misfit, fit.freedom)) >= CRITERIA.not_explained)


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


def likely_places(tried: Sequence[Candidate], scale: float) -> tuple[PlaceClass, ...]:
    """Return places by the best candidate at each, the likeliest first; those that explain the same are one class.

    scale: variance of the noise, as a factor.
    """
    scale = max(scale, 1.0)
    best: dict[Spot, float] = {}
    for item in tried:
        if not item.fit.failure:
            spot = item.insertion.spot
            best[spot] = min(best.get(spot, np.inf), item.fit.criterion)
    classes: list[list[Spot]] = []
    for spot in sorted(best, key=lambda spot: best[spot]):
        if classes and best[spot] - best[classes[-1][0]] <= SAME * scale:
            classes[-1].append(spot)
        else:
            classes.append([spot])
    far = np.array([best[spots[0]] - best[classes[0][0]] for spots in classes])
    weights = np.exp(-0.5 * far / scale)
    pairs = zip(classes, weights / weights.sum(), strict=True)
    return tuple(PlaceClass(tuple(spots), float(weight)) for spots, weight in pairs)
