"""What hold-out runs say of a repair: proved, disproved or unproved; effects that do not show there are dropped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.evidence.evidence import HeldScore, Score
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate, is_noise
from rotorsim.diagnosis.search.selection import Selection, without_effects, without_last


@dataclass(frozen=True)
class Proof:
    """status: "proved", "disproved" or "unproved". reason: in words, after "on hold-out runs"."""

    status: str
    reason: str


def prove(
    before: HeldScore,
    after: HeldScore,
    *,
    left: float = 0.0,
    held: bool = True,
    drifting: bool = False,
    converters: bool = False,
) -> Proof:
    """Return whether a repaired diagram predicts hold-out runs.

    Proved: its residual is what noise and uncertain parameters can make (chi-squared, `Criteria.surprise`), or a share
    of what was unexplained of at most ``details``, or ``extrapolation`` times ``left``, the share that it leaves in the
    fitted runs, but at most 1 - ``cause``, and no more than that of the squared error of the signals, either: misfit
    weighs an order by its noise, so that small orders may outweigh the motion. Disproved: it leaves more. Unproved:
    nothing can be said, for the reason given; without runs that are held out for good (held), too little may be left to
    find a law in runs left out one by one. drifting: 1X drifts within the runs, which is no noise of its harmonics, so
    that the squared error alone decides. converters: readings are steps, whose noise is known to ``faint`` only.
    """
    if after.misfit is None:
        return Proof("unproved", f"the repaired diagram predicts nothing: {after.reason or 'no settled motion'}")
    times = after.misfit / max(after.rows, 1)
    limit = CRITERIA.faint if converters else CRITERIA.model_error
    if chi2.sf(after.misfit, after.rows) >= CRITERIA.surprise or times <= limit:
        return Proof("proved", f"its residual variance there, {times:.3g} times the noise, noise can make")
    if before.misfit is None:
        what = f"the diagram as given has no settled motion to compare with ({before.reason or 'none was found'})"
        return Proof("unproved", f"{what}; the residual variance of the repaired one is {times:.3g} times the noise")
    share = (after.misfit - after.rows) / max(before.misfit - before.rows, 1e-300)
    allowed = min(max(CRITERIA.details, CRITERIA.extrapolation * left), 1 - CRITERIA.cause)
    reason = f"it leaves {share:.2g} of what was unexplained there, residual variance {times:.3g} times the noise"
    if before.misfit > before.rows and (share <= allowed or drifting):
        error = _error_left(before, after)
        if error <= 1 - CRITERIA.cause:
            return Proof("proved", f"{reason}: no more than details of the law")
        most = f"more than details of a law ({1 - CRITERIA.cause:.2g})"
        reason = f"{reason}, but {error:.2g} of the squared error of the signals: {most}"
    else:
        reason = f"{reason}: more than the fitted runs give reason for ({allowed:.2g})"
    return Proof("disproved" if held else "unproved", reason)


def prove_by_error(before: Score, after: Score) -> Proof:
    """Return whether a repaired diagram predicts hold-out runs whose samples are not independent, by its error there.

    Disproved: the squared error rises by more than a model of the noise may be wrong by (`Criteria.model_error`); it
    must fall to be proved.
    """
    if after.total is None:
        return Proof("unproved", f"the repaired diagram predicts nothing: {after.reason or 'it diverges'}")
    if before.total is None:
        return Proof("unproved", f"the diagram as given cannot be compared: {before.reason or 'it diverges'}")
    ratio = (after.total / before.total) ** 2
    reason = f"its squared error there is {ratio:.3g} times that of the diagram as given"
    if ratio > CRITERIA.model_error:
        return Proof("disproved", reason)
    return Proof("proved" if ratio < 1 else "unproved", reason)


def _error_left(before: Score, after: Score) -> float:
    """Return the share of the squared error beyond the noise floor that a repair leaves; 0 where it is not known."""
    if before.total is None or after.total is None or before.noise is None or after.noise is None:
        return 0.0
    return max(after.total**2 - after.noise**2, 0.0) / max(before.total**2 - before.noise**2, 1e-300)


def is_material(before: HeldScore, after: HeldScore, base: Fit, fit: Fit) -> bool:
    """Return whether a repair shows in hold-out runs, too: their misfit falls by ``material`` of that of the fits.

    Compared is the fall per equation. An effect may show less in those runs, at other speeds and gains: no more can
    fall than is left beyond noise there, and by chance it may rise by ``hidden``. Where the residual of the diagram as
    given, base, is faint (`is_faint`), it may not, and the error of those runs must fall as well: the model of the
    noise may be wrong. True, too, where the misfit of either is not known.
    """
    if before.misfit is None or after.misfit is None or before.total is None or after.total is None:
        return True
    rows = max(after.rows, 1)
    most = min((base.misfit - fit.misfit) / max(base.rows, 1), max(before.misfit / rows - 1.0, 0.0))
    faint = is_faint(base, before)
    falls = before.misfit - after.misfit >= CRITERIA.material * most * rows - (0.0 if faint else CRITERIA.hidden)
    return falls and (not faint or after.total < before.total)


def is_faint(fit: Fit, score: HeldScore) -> bool:
    """Return whether a residual is so small that the model of the noise may be wrong by as much.

    score: of hold-out runs, where it must be as small. Asynchronous lines are judged by their own misfit.
    """
    if score.misfit is not None and score.misfit > CRITERIA.faint * score.rows:
        return False
    return fit.misfit <= CRITERIA.faint * fit.freedom and is_noise(replace(fit, goodness=1.0))


def contradicts(fit: Fit, score: HeldScore) -> bool:
    """Return whether hold-out runs leave more than the noise may be wrong by, of a fit that leaves noise."""
    if not is_adequate(fit) or score.misfit is None or score.misfit <= CRITERIA.faint * score.rows:
        return False
    return float(chi2.sf(score.misfit, score.rows)) < CRITERIA.not_explained


def material_effects(selection: Selection, score: Callable[[Fit], HeldScore]) -> Selection:
    """Return a selection without effects that do not show in hold-out runs, each beside those found before."""

    def shows(without: Fit, fit: Fit) -> bool:
        return is_material(score(without), score(fit), without, fit)

    while selection.chosen and selection.explains:
        less = without_last(selection)
        if shows(less.fit, selection.fit):
            break
        selection = less
    if selection.chosen and selection.explains and not shows(selection.base, selection.fit):
        return without_effects(selection)
    return selection
