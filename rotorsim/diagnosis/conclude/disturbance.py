"""An unmeasured disturbance as an effect, beside those that show beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.result import Effect
from rotorsim.diagnosis.evidence.disturbance import disturbance
from rotorsim.diagnosis.evidence.evidence import Evidence, Score
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass
from rotorsim.diagnosis.search.candidates import Candidate
from rotorsim.diagnosis.search.selection import Selection, least_gain, without_last


@dataclass(frozen=True, eq=False)
class Disturbed:
    """An unmeasured disturbance with its signal, beside the effects of a selection; its fit is that of all."""

    selection: Selection
    effect: Effect
    signal: MissingSignal

    @property
    def fit(self) -> Fit:
        """The fit with all effects."""
        return self.effect.candidate.fit


def disturbed(selection: Selection, evidence: Evidence, catalogue: Catalogue) -> Disturbed | None:
    """Return the unmeasured disturbance that explains what a diagram leaves, beside the effects that show beside it.

    None where it may be a law, or where no disturbance is declared.
    """
    if not selection.first.classes:
        return None
    shown, classes = _beside_a_signal(selection, evidence)
    signal = disturbance(shown.fit, classes, evidence)
    found = None if signal is None else unmeasured(shown.fit, signal, evidence, catalogue)
    return None if found is None else Disturbed(shown, *found)


def _beside_a_signal(selection: Selection, evidence: Evidence) -> tuple[Selection, Sequence[PlaceClass]]:
    """Return a selection without effects that a free signal explains as well, and the classes of places of that.

    An effect must raise its likelihood by more than noise lets the best of all candidates (`least_gain`), and show in
    hold-out runs, beside those before it and all of them together: the squared error there must fall by
    `Criteria.material` of the part that the misfit falls by.
    """
    given = evidence.score(selection.base) if selection.chosen else None
    bounds = evidence.bounds(selection.fit) if selection.chosen else None
    while bounds is not None and given is not None and selection.chosen:
        less, score = without_last(selection), evidence.score(selection.fit)
        beside = evidence.bounds(less.fit)
        least = least_gain(selection.chosen[-1], less.fit, selection.level)
        likelier = beside is not None and beside.deviance - bounds.deviance > least
        together = _shows(given, score, selection.base, selection.fit)
        if likelier and together and _shows(evidence.score(less.fit), score, less.fit, selection.fit):
            return selection, bounds.classes
        selection, bounds = less, beside
    return selection, selection.first.classes


def _shows(before: Score, after: Score, without: Fit, fit: Fit) -> bool:
    if before.total is None or after.total is None:
        return False
    return 1 - (after.total / before.total) ** 2 >= CRITERIA.material * (1 - fit.misfit / without.misfit)


def unmeasured(
    fit: Fit, signal: MissingSignal, evidence: Evidence, catalogue: Catalogue
) -> tuple[Effect, MissingSignal] | None:
    """Return the unmeasured disturbance that a signal is, and the signal with its name; None where none is declared."""
    item = _insertion(fit, signal, evidence, catalogue)
    if item is None:
        return None
    values = {key: signal.known(value)[0] for key, value in item.from_course.items()}
    document = item.document(values_in(fit.document, fit.values), values)
    places = tuple(one for one in signal.classes if one.probability >= CRITERIA.listed)
    places = places or (PlaceClass((item.spot,), 1.0),)
    effect = Effect(Candidate(item, replace(fit, document=document)), {item.physics: 1.0}, {}, places)
    return effect, replace(signal, physics=item.physics)


def _insertion(fit: Fit, signal: MissingSignal, evidence: Evidence, catalogue: Catalogue) -> Insertion | None:
    """Return the declared disturbance at the place of a signal, or at one that no data tell from it."""
    diagram = evidence.load(values_in(fit.document, fit.values))
    every = [item for item in catalogue.candidates(diagram, evidence.recorded) if item.from_course]
    alike = [signal.place, *(spot for one in signal.classes if signal.place in one.places for spot in one.places)]
    found = (item for spot in alike for item in every if item.spot == spot and item.spot.side == spot.side)
    return next(found, None)
