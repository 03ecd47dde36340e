"""A missing signal that nothing predicts: a law that no black box knows, or an unmeasured disturbance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.result import Effect
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass
from rotorsim.diagnosis.search.candidates import Candidate

LEAST_VISIBLE = 2.0  # residual variance, of the noise's: half of it, or more, is what is missing


def is_unpredicted(base: Fit, signals: Sequence[MissingSignal], evidence: Evidence) -> bool:
    """Return whether nothing predicts what a diagram as given leaves, nor the free signal that explains it.

    At one place it must explain what a cause must explain (`Criteria.cause`). Most laws follow from what drives the
    diagram, but not all: of a ripple over an angle, or plays of many widths, a black box may find nothing.
    """
    if not signals or signals[0].predicted or signals[0].without < LEAST_VISIBLE:
        return False
    share = (signals[0].without - signals[0].left) / (signals[0].without - 1)
    return share >= CRITERIA.cause and not evidence.structure(base)


def unmeasured(
    base: Fit, signal: MissingSignal, evidence: Evidence, catalogue: Catalogue
) -> tuple[Effect, MissingSignal] | None:
    """Return the unmeasured disturbance that a signal is which nothing predicts, and the signal with its name.

    None unless runs with the same inputs show that it does not come again, as that of a law does: less than
    `Criteria.material` of it, three standard deviations of chance included. Two courses that have nothing to do with
    each other have a correlation of variance tau / T, T: of the shortest run (Bartlett, as in `MissingSignal.known`).
    """
    chance = (signal.correlation_time / min(run.time[-1] - run.time[0] for run in signal.runs)) ** 0.5
    if signal.repeated is None or signal.repeated + 3 * chance > CRITERIA.material:
        return None
    item = _insertion(base, signal, evidence, catalogue)
    if item is None:
        return None
    values = {key: signal.known(value)[0] for key, value in item.from_course.items()}
    document = item.document(values_in(base.document, base.values), values)
    places = tuple(one for one in signal.classes if one.probability >= CRITERIA.listed)
    places = places or (PlaceClass((item.spot,), 1.0),)
    effect = Effect(Candidate(item, replace(base, document=document)), {item.physics: 1.0}, {}, places)
    return effect, replace(signal, physics=item.physics)


def _insertion(base: Fit, signal: MissingSignal, evidence: Evidence, catalogue: Catalogue) -> Insertion | None:
    """Return the declared disturbance at the place of a signal, or at one that no data tell from it."""
    diagram = evidence.load(values_in(base.document, base.values))
    every = [item for item in catalogue.candidates(diagram, evidence.recorded) if item.from_course]
    alike = [signal.place, *(spot for one in signal.classes if signal.place in one.places for spot in one.places)]
    found = (item for spot in alike for item in every if item.spot == spot and item.spot.side == spot.side)
    return next(found, None)
