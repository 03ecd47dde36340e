"""A missing signal that nothing predicts: a law that no black box knows, or an unmeasured disturbance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass, likely_spots

LEAST_VISIBLE = 2.0  # residual variance, of the noise's: half of it, or more, is what is missing
SURE = 3.0  # standard deviations of chance that a disturbance must be away from what a law does
SINE = 1.5  # excess kurtosis of a sine, with the other sign: of a ripple over an angle


def disturbance(fit: Fit, classes: Sequence[PlaceClass], evidence: Evidence) -> MissingSignal | None:
    """Return the signal of an unmeasured disturbance that explains what a fit leaves; None where it may be a law.

    At the likeliest class of places where it is one: behind an integrator it has too long a memory to tell.
    """
    likely = likely_spots(classes)
    for n, one in enumerate(classes):
        if not likely.intersection(one.places):
            break
        total = sum(other.probability for other in classes[n:])  # at those before it is none
        here = [replace(other, probability=other.probability / total) for other in classes[n:]]
        signal = evidence.missing_signal(fit, fit, None, one.places[0], here)
        if signal is not None and not may_be_a_law(signal) and is_unpredicted(fit, (signal,), evidence):
            return signal
    return None


def is_unpredicted(fit: Fit, signals: Sequence[MissingSignal], evidence: Evidence) -> bool:
    """Return whether nothing predicts what a diagram leaves, nor the free signal that explains it.

    At one place it must explain what a cause must explain (`Criteria.cause`). Most laws follow from what drives the
    diagram, but not all: of a ripple over an angle, or plays of many widths, a black box may find nothing.
    """
    if not signals or signals[0].predicted or signals[0].without < LEAST_VISIBLE:
        return False
    share = (signals[0].without - signals[0].left) / (signals[0].without - 1)
    return share >= CRITERIA.cause and not evidence.structure(fit)


def may_be_a_law(signal: MissingSignal) -> bool:
    """Return whether a signal that nothing predicts may be a law that no black box knows.

    In runs with the same inputs a law adds the same again: a disturbance comes again by less than `Criteria.material`,
    `SURE` standard deviations of chance included. Two courses that have nothing to do with each other have a
    correlation of variance tau / T, T: of the shortest run (Bartlett, as in `MissingSignal.known`). Without such runs
    it must be noise that has nothing to do with the motion: Gaussian, as far as chance tells, and surely no sine;
    without lines (but for the mains'); and its power must follow that of the motion by less than `Criteria.material` of
    what is proportional. A ripple is bounded; most laws are larger where more moves.
    """
    if signal.repeated is not None:
        chance = sqrt(signal.correlation_time / min(run.time[-1] - run.time[0] for run in signal.runs))
        return not signal.repeated + SURE * chance <= CRITERIA.material
    (exponent, off), (kurtosis, chance) = signal.follows, signal.kurtosis
    follows = not abs(exponent) + SURE * off <= CRITERIA.material
    gaussian = abs(kurtosis) <= SURE * chance and abs(kurtosis) + SURE * chance < SINE
    return follows or not gaussian or not signal.line <= 1
