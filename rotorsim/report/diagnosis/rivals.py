"""The evidence in the report of a diagnosis: how both diagrams fit, and which fault candidates lost, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from rotorsim.diagnosis.conclude.result import Diagnosis, Effect
from rotorsim.diagnosis.search.candidates import Candidate, Round
from rotorsim.errors import escape
from rotorsim.report.diagnosis.compared import looks_of
from rotorsim.report.diagnosis.words import place_words, plain_words
from rotorsim.report.page import paragraph, table

MISFIT = "Misfit: sum of squares of the residual, in standard deviations of the noise. Degrees of freedom: equations "
MISFIT += "less unknowns."
PROBABILITY = " Probability: that noise alone leaves as much."
CRITERION = "Criterion: misfit and ln(equations) for every unknown (BIC); 10 more are odds of 150 to 1."
RIVALS = 15  # in a table
VARIANCE, CROSS = "residual variance / noise", "misfit in cross-validation"
OPEN = "not fitted to the end: not rejected"


def fits_table(diagnosis: Diagnosis, *, independent: bool) -> str:
    """Return how each diagram fits; independent: whether the residuals are, so that they have a probability."""
    rows = []
    for look, fit in zip(looks_of(diagnosis), (diagnosis.before, diagnosis.after), strict=False):
        probability = f"{fit.goodness:.2g}" if fit.goodness > 1e-12 else "< 1e-12"
        variance, cross = f"{fit.misfit / fit.freedom:.3g}", f"{fit.left_out.sum():.4g}"
        rows.append([look.label, f"{fit.misfit:.4g}", str(fit.freedom), variance, cross, probability])
    header = ["", "misfit", "degrees of freedom", VARIANCE, CROSS, "probability"]
    last = None if independent else -1
    note = paragraph(MISFIT + (PROBABILITY if independent else ""), small=True)
    return "\n".join(["<h2>Evidence</h2>", table(header[:last], [row[:last] for row in rows], right=range(1, 6)), note])


def rivals_tables(diagnosis: Diagnosis) -> str:
    """Return for each round of the search the nearest fault candidates."""
    reasons = dict(diagnosis.rejected)
    count = max(len(diagnosis.searched), 1)
    return "\n".join(
        _rivals(diagnosis, item, k, reasons if k == 0 else {})
        for k, item in enumerate(diagnosis.selection.rounds[:count])
    )


def _rivals(diagnosis: Diagnosis, item: Round, number: int, reasons: Mapping[str, str]) -> str:
    effects = diagnosis.searched
    best: dict[str, Candidate] = {}
    for candidate in item.tried:
        best.setdefault(candidate.insertion.physics, candidate)
    kept = _as_tried(effects[number], item) if number < len(effects) else None
    base = kept.candidate.fit.criterion if kept is not None else item.before.criterion
    rows = []
    for name, candidate in list(best.items())[:RIVALS]:
        fit, why = candidate.fit, _why(candidate, kept, reasons.get(name, ""), diagnosis.verdict)
        numbers = (
            str(len(candidate.parameters)),
            f"{fit.misfit / fit.freedom:.3g}",
            f"{fit.left_out.sum():.4g}",
            f"{fit.criterion - base:+.4g}",
        )
        cells = [""] * 4 if fit.failure else numbers
        rows.append([plain_words(name), place_words(candidate.insertion), *cells, why or fit.failure])
    if not rows:
        return ""
    others = [plain_words(effect.physics) for k, effect in enumerate(effects) if k != number]
    beside = f", beside {', '.join(others)}" if others else ""
    criterion = f"criterion against {'the one kept' if kept is not None else 'the diagram as given'}"
    header = ["fault candidate, at its best place", "at", "parameters", VARIANCE, CROSS, criterion, "why it lost"]
    last = None if any(row[-1] for row in rows) else -1
    tried = len({(c.insertion.physics, c.insertion.spot) for c in item.tried})
    title = f"<h3>Rivals{escape(beside)}: the {len(rows)} nearest of {tried} tried</h3>"
    note = paragraph("" if number else CRITERION, small=True)
    return "\n".join([title, table(header[:last], [row[:last] for row in rows], right=range(2, 6)), note])


def _as_tried(effect: Effect, found: Round) -> Effect:
    """Return an effect as it was fitted in a round, with the same measure of the noise as its rivals there."""
    key = effect.candidate.insertion.key
    tried = next((item for item in found.tried if item.insertion.key == key and not item.fit.failure), effect.candidate)
    return replace(effect, candidate=tried)


def _why(candidate: Candidate, kept: Effect | None, given: str, verdict: str) -> str:
    """Return why a candidate lost, or what it is; given: what the diagnosis says of it."""
    name, fit = candidate.insertion.physics, candidate.fit
    if kept is not None and name in kept.members:
        chosen = "nearest" if verdict == "outside_catalogue" else "kept"
        return chosen if name == kept.physics else "explains the data as well"
    if not candidate.final:
        return OPEN
    if kept is None:
        return ""
    best = kept.candidate.fit
    ratio = fit.misfit * best.freedom / (fit.freedom * best.misfit)
    larger = given and len(fit.free) > len(best.free)  # then it is said what its parameters cost
    if not fit.failure and (ratio > 2 or (ratio > 1.05 and not larger)):
        return f"residual variance {ratio:.3g} times as large"
    return given or "explains the data less well"
