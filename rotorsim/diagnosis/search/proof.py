"""What runs that took no part say of a repair: proved, disproved or unproved, and the share that it explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, t

from rotorsim.diagnosis.evidence.harmonic import Fit
from rotorsim.diagnosis.evidence.scoring import HeldScore, Score
from rotorsim.diagnosis.search.trials import MODEL_ERROR, is_noise

__all__ = ["Proof", "Share", "is_faint", "is_material", "prove", "share_explained"]

SURPRISE = 0.01  # probability of what a diagram leaves in held-out runs, below which noise does not make it: a right
# repair is disproved in one case of a hundred, as often as a false alarm is raised
DETAILS = 1e-4  # share of what was left unexplained there that an otherwise exact law may leave: 1 % of the amplitude,
# what harmonics of a law with corners are good to
BEYOND = 10.0  # times the share left in fitted runs, that may be left in others, at other speeds and gains: three
# times the amplitude, as for forces that grow with the square of a speed 1.7 times higher
MOST = 0.98  # share of what is to be explained that a cause must explain to be named: between laws that imitate others
# and right laws with details, `python -m benchmarks.concealed shares` (docs/diagnosis.md)
MATERIAL = 0.5  # of the fall of the misfit in fitted runs, or of all that is left beyond noise where that is less, that
# must be seen in runs left out: a true effect shows all of it there, what was fitted to noise nothing, or the reverse
HIDDEN = 4.0  # of the misfit, by which a true effect may make it rise there: one of d standard deviations makes it fall
# by d^2 +- 2 d; two deviations below that mean are least at d = 2, a rise by 4
FAINT = 1.5  # times the variance of the noise: what is left below may be the model of the noise; 200 healthy machines
# with hum, flicker noise, drift, lost samples and sampled pulses leave up to 1.20 (benchmarks/concealed/results)
LEVEL = 0.9  # of intervals


@dataclass(frozen=True)
class Proof:
    """status: "proved", "disproved" or "unproved". reason: in words, after "in held-out runs"."""

    status: str
    reason: str


@dataclass(frozen=True)
class Share:
    """A share and its 90 % interval (None of a single run)."""

    value: float
    interval: tuple[float, float] | None = None


def prove(before: Score, after: Score, *, left: float = 0.0, held: bool = True) -> Proof:
    """Return whether a repaired diagram predicts runs that took no part in its fit.

    Proved: what it leaves is what noise and uncertain parameters can make (chi-squared, SURPRISE), or a share of what
    was unexplained of at most DETAILS, or BEYOND times ``left``, the share that it leaves in the fitted runs, but at
    most 1 - MOST, and no more than that of the squared error of the signals, either: misfit weighs an order by its
    noise, so that small orders may outweigh the motion. Disproved: it leaves more. Unproved: nothing can be said, for
    the reason given; without runs that are held out for good (held), too little may be left to find a law in runs left
    out one by one.
    """
    if not (isinstance(before, HeldScore) and isinstance(after, HeldScore)):
        return _by_error(before, after)
    if after.misfit is None:
        return Proof("unproved", f"the repaired diagram predicts nothing: {after.reason or 'no settled motion'}")
    times = after.misfit / max(after.rows, 1)
    if chi2.sf(after.misfit, after.rows) >= SURPRISE or times <= MODEL_ERROR:
        return Proof("proved", f"what it leaves there, {times:.3g} times the variance of the noise, noise can make")
    if before.misfit is None:
        what = f"the diagram as given has no settled motion to compare with ({before.reason or 'none was found'})"
        return Proof("unproved", f"{what}; the repaired one leaves {times:.3g} times the variance of the noise")
    share = (after.misfit - after.rows) / max(before.misfit - before.rows, 1e-300)
    allowed = min(max(DETAILS, BEYOND * left), 1 - MOST)
    said = f"it leaves {share:.2g} of what was unexplained there, {times:.3g} times the variance of the noise"
    if before.misfit > before.rows and share <= allowed:
        error = _error_left(before, after)
        if error <= 1 - MOST:
            return Proof("proved", f"{said}: no more than details of the law")
        limit = f"more than details of a law ({1 - MOST:.2g})"
        said = f"{said}, but {error:.2g} of the squared error of the signals: {limit}"
    else:
        said = f"{said}: more than the fitted runs give reason for ({allowed:.2g})"
    return Proof("disproved" if held else "unproved", said)


def _error_left(before: Score, after: Score) -> float:
    """Return the share of the squared error beyond the noise floor that a repair leaves; 0 where it is not known."""
    if before.total is None or after.total is None or before.noise is None or after.noise is None:
        return 0.0
    return max(after.total**2 - after.noise**2, 0.0) / max(before.total**2 - before.noise**2, 1e-300)


def _by_error(before: Score, after: Score) -> Proof:
    """Return what errors alone say, where the noise of the harmonics is not known."""
    if after.total is None:
        return Proof("unproved", "the repaired diagram predicts nothing")
    if before.total is None:
        return Proof("unproved", "the diagram as given predicts nothing to compare with")
    change = f"{100 * before.total:.3g} % to {100 * after.total:.3g} %"
    if after.total < before.total:
        return Proof("proved", f"the error falls from {change}")
    return Proof("unproved", f"the error does not fall: {change}")


def is_material(before: Score, after: Score, base: Fit, fit: Fit) -> bool:
    """Return whether a repair shows in runs that took no part, too: their misfit falls by MATERIAL of that of the fits.

    Compared is the fall per equation. An effect may show less in those runs, at other speeds and gains: no more can
    fall than is left beyond noise there, and by chance it may rise by HIDDEN. Where the diagram as given, base, leaves
    little (`is_faint`), it may not, and the error of those runs must fall as well: the model of the noise may be wrong.
    True, too, where nothing of either is known.
    """
    if not (isinstance(before, HeldScore) and isinstance(after, HeldScore)):
        return True
    if before.misfit is None or after.misfit is None or before.total is None or after.total is None:
        return True
    rows = max(after.rows, 1)
    most = min((base.misfit - fit.misfit) / max(base.rows, 1), max(before.misfit / rows - 1.0, 0.0))
    faint = is_faint(base, before)
    falls = before.misfit - after.misfit >= MATERIAL * most * rows - (0.0 if faint else HIDDEN)
    return falls and (not faint or after.total < before.total)


def is_faint(found: Fit, scored: Score) -> bool:
    """Return whether what a diagram leaves is so little that the model of the noise may be wrong by as much.

    scored: of runs that took no part, where it must be as little. Lines beside the harmonics are told from noise by
    their own.
    """
    if isinstance(scored, HeldScore) and scored.misfit is not None and scored.misfit > FAINT * scored.rows:
        return False
    return found.misfit <= FAINT * found.freedom and is_noise(replace(found, goodness=1.0))


def share_explained(before: Score, after: Score, least: Sequence[tuple[float, float]] | None = None) -> Share | None:
    """Return the share of what is to be explained in runs that took no part that a repair explains.

    sum_r (b_r - a_r) / sum_r (b_r - f_r), of each run r the misfit less the number of equations: before b, after a,
    and f with free harmonics of a force or signal at the place of the repair, least (default: zero). Interval: Student,
    by leaving out one run after the other (jackknife; Quenouille, Biometrika 43 (1956) 353). None where nothing is to
    be explained, or it is not known.
    """
    if not (isinstance(before, HeldScore) and isinstance(after, HeldScore)):
        return None
    if not before.runs or len(before.runs) != len(after.runs) or (least is not None and len(least) != len(after.runs)):
        return None
    b, a = (np.array([misfit - rows for misfit, rows in item.runs]) for item in (before, after))
    f = np.zeros(len(b)) if least is None else np.array([misfit - rows for misfit, rows in least])
    to_explain = float((b - f).sum())
    rows = sum(pair[1] for pair in before.runs)
    if not np.isfinite([*b, *a, *f]).all() or to_explain <= chi2.isf(SURPRISE, rows) - rows:
        return None
    value = float((b - a).sum()) / to_explain
    R = len(b)
    if R < 2:
        return Share(min(value, 1.0))
    without = np.array([np.delete(b - a, r).sum() / np.delete(b - f, r).sum() for r in range(R)])
    spread = float(np.sqrt((R - 1) / R * ((without - without.mean()) ** 2).sum()))
    half = float(t.isf((1 - LEVEL) / 2, R - 1)) * spread
    return Share(min(value, 1.0), (value - half, min(value + half, 1.0)))
