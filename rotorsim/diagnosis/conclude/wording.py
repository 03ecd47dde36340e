"""What a diagnosis says in words, made from its fields: the statement and the next experiment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.conclude.result import Diagnosis, Effect, estimates, untried_of
from rotorsim.diagnosis.conclude.shares import Explained
from rotorsim.diagnosis.conclude.validation import contradicts
from rotorsim.diagnosis.evidence.evidence import HeldScore
from rotorsim.diagnosis.evidence.fit import is_noise
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, spots_of
from rotorsim.diagnosis.search.candidates import Candidate, Round
from rotorsim.fault import Fault
from rotorsim.units import format_quantity

ELSEWHERE = 0.05  # probability of another place, from which an experiment is looked for that tells it apart
UNTRIED = 5  # hypotheses that are named
WHOLE_SHARE = 0.999  # a share from which its digits say nothing
ONE_SPEED = "at one speed unbalance imitates bow and runout, and force factors imitate stiffness and damping"
REPEATED = "a run with the inputs and start of another: a law adds the same again, an unmeasured disturbance does not"
UNFITTED = "none yet: what could not be fitted may be what is missing; once it can be, diagnose again"
MORE_RUNS = "runs at several speeds, from slow roll to above the first critical, and some with other gains"


def next_experiment(diagnosis: Diagnosis) -> str:
    """Return the change that would separate the hypotheses that remain, or say that none is needed."""
    evidence, verdict = diagnosis.evidence, diagnosis.verdict
    known = () if verdict == "outside_catalogue" else diagnosis.effects  # else none to separate from its rivals
    parts = [
        f"to separate {effect.physics} from {name}: {_separating(effect, rival, diagnosis)}"
        for effect in known
        for name, rival in effect.rivals.items()
    ]
    for effect, found in zip(known, diagnosis.selection.rounds, strict=False):
        other = None if evidence.terms.turns else _elsewhere(effect, found)
        if other is not None:
            here, there = (item.insertion.spot.words for item in (effect.candidate, other))
            how = _separating(effect, other, diagnosis)
            parts.append(f"to separate {effect.physics} at {here} from that at {there}: {how}")
    if verdict == "outside_catalogue" and diagnosis.unpredicted and diagnosis.signals[0].repeated is None:
        parts.append(REPEATED)
    if verdict == "outside_catalogue":
        parts.append(_law_of_unknown(diagnosis))
    if (signal := _disturbance(diagnosis)) is not None:
        parts.append(_recorded(signal))
    open_questions = evidence.open_questions()
    if parts or open_questions:
        return "; ".join([*parts, *([open_questions] if open_questions else [])])
    if verdict == "not_identifiable" and evidence.unjudged:
        longer = f"longer runs, {evidence.terms.driven} that every signal moves by far more than its noise"
        return f"{longer}: {evidence.unjudged}"
    if verdict in ("consistent", "not_identifiable") and evidence.alike:
        return f"{MORE_RUNS}: {ONE_SPEED}"
    if untried_of(diagnosis.selection):
        return UNFITTED
    if verdict == "consistent":
        return "none is needed for what the diagram states; smaller effects need lower noise or longer runs"
    return "none is needed: one hypothesis is left"


def _recorded(signal: MissingSignal) -> str:
    """Return what a disturbance asks for: an input is recorded, what one sensor alone shows may be its own."""
    if signal.place.side == "reading":
        return f"measure what {signal.place} shows with a second sensor: nothing else sees the signal"
    return f"record the signal that acts at {signal.place.words}: it is an input then"


def _law_of_unknown(diagnosis: Diagnosis) -> str:
    """Return what shows the law of what is outside the catalogue."""
    runs = diagnosis.evidence.terms.more_runs
    if not diagnosis.signals:
        return f"{runs} about the place named, to see the law of the unknown force"
    signal = diagnosis.signals[0]
    of_map = f"a map over {signal.over} explains {_percent(signal.share)} of it in these runs"
    return f"{runs}, to see the law of the missing signal at {signal.place.words}: {of_map}"


def _elsewhere(effect: Effect, found: Round) -> Candidate | None:
    """Return the same physics at the likeliest other place, where that is nearly as likely; None where it is not."""
    spots = spots_of(one for one in effect.places if one.probability >= ELSEWHERE)
    best = effect.candidate.insertion
    others = (item for item in found.tried if item.insertion.physics == best.physics and not item.fit.failure)
    return next((item for item in others if item.insertion.spot in spots and item.insertion.spot != best.spot), None)


def _separating(effect: Effect, rival: Candidate, diagnosis: Diagnosis) -> str:
    """Return in words the experiment that separates an effect from a rival."""
    terms = diagnosis.evidence.terms
    declared = _declared(effect.candidate.insertion.fault, rival.insertion.fault, terms.turns)
    change = diagnosis.evidence.separation(effect.candidate.fit, rival.fit)
    more = f"; {declared}" if declared else ""
    if change is not None and change.runs:
        times = "" if change.runs == 1 else f", {change.runs} times,"
        return f"{change.words}{times} (predictions {change.separation:.2g} standard deviations apart)"
    if change is not None:
        apart = f"predictions only {change.separation:.2g} standard deviations apart"
        return f"{change.words} separates them most ({apart}){more}"
    return (declared or terms.another) if terms.another else f"{terms.searched} does{more}"


def _declared(first: Fault, second: Fault, turns: bool) -> str:
    """Return what is declared to separate two faults: by one that names the other, else by any; nothing of the same."""

    if first.physics == second.physics:
        return ""

    def said(fault: Fault) -> str:
        return fault.told_apart_by if turns else fault.told_apart_at_rest_by or fault.told_apart_by

    pairs = ((first, second), (second, first))
    named = [said(a) for a, b in pairs if b.physics in a.confused_with and said(a)]
    return (named or [said(fault) for fault in (first, second)])[0]


def statement(diagnosis: Diagnosis) -> str:
    """Return one paragraph: verdict, what is missing with its sizes, shares and errors on hold-out runs."""
    if not diagnosis.effects and diagnosis.verdict in ("consistent", "not_identifiable"):
        parts = _consistent(diagnosis)
    elif diagnosis.verdict == "outside_catalogue":
        parts = _outside(diagnosis)
    elif (signal := _disturbance(diagnosis)) is not None:
        parts = _disturbed(diagnosis, signal)
    else:
        parts = _missing(diagnosis)
    return " ".join(part for part in [*parts, _inside(diagnosis), _untried(diagnosis)] if part)


def _inside(diagnosis: Diagnosis) -> str:
    """Return which blocks may hide what was located at their ports."""
    first = diagnosis.places[0].places if diagnosis.places and diagnosis.verdict != "consistent" else ()
    spots = [spot for spot in first if diagnosis.inside(spot)]
    if not spots:
        return ""
    hidden = _list(list(dict.fromkeys(name for spot in spots for name in diagnosis.inside(spot))))
    at = _list(list(map(str, spots)))
    return f"What acts at {at} may as well be inside {hidden}, whose equations are its own and are not looked into."


def _untried(diagnosis: Diagnosis) -> str:
    """Return what could not be fitted, and why."""
    stopped = untried_of(diagnosis.selection)
    if not stopped:
        return ""
    names = [*stopped]
    more = f" and {len(names) - UNTRIED} more" if len(names) > UNTRIED else ""
    why = next(iter(stopped.values())).partition("\n")[0]
    return f"Not fitted, so that nothing is said of it: {', '.join(names[:UNTRIED])}{more} ({why})."


def _name(diagnosis: Diagnosis) -> str:
    return str(diagnosis.document.get("name", "the diagram"))


def _variance(ratio: float, diagnosis: Diagnosis) -> str:
    return f"residual variance {ratio:.3g} times {diagnosis.evidence.terms.noise}"


def _consistent(diagnosis: Diagnosis) -> list[str]:
    name, ratio = _name(diagnosis), _variance(diagnosis.before.excess_variance, diagnosis)
    if is_noise(diagnosis.before):
        fitted = " that could be fitted" if untried_of(diagnosis.selection) else ""
        more = f"no fault candidate{fitted} explains more of it than noise would"
        parts = [f"{name} explains the recording: {ratio}; {more}."]
    else:
        none = "no fault candidate explains the rest on hold-out runs too"
        parts = [f"{name} explains the recording but for a small residual: {ratio}; {none}.", _residual(diagnosis)]
    if diagnosis.evidence.unjudged:
        parts.append(f"Whether that is all cannot be judged, though: {diagnosis.evidence.unjudged}.")
    if diagnosis.evidence.alike:
        parts.append(f"All its runs are alike, though: {ONE_SPEED}.")
    return [*parts, _imitated(diagnosis), _hold_out(diagnosis)]


def _imitated(diagnosis: Diagnosis) -> str:
    """Return which physics change the recording only as what is free does, so that no size of them is known."""
    open_ones: dict[str, bool] = {}
    for item in diagnosis.selection.first.tried:
        names, physics = [free.name for free in item.fit.free], item.insertion.physics
        if not item.fit.failure:
            spread = [item.fit.covariance[j, j] for j in map(names.index, item.parameters)]
            open_ones[physics] = open_ones.get(physics, True) and bool(np.isinf(spread).all())
    names = sorted(physics for physics, is_open in open_ones.items() if is_open)
    return f"Nothing is said of {_list(names)}: what is free changes these data alike." if names else ""


def _unexplained(diagnosis: Diagnosis) -> str:
    ratio = _variance(diagnosis.before.excess_variance, diagnosis)
    held = diagnosis.score_before if diagnosis.held_out else None
    if isinstance(held, HeldScore) and held.misfit is not None and contradicts(diagnosis.before, held):
        there = _variance(held.misfit / held.rows, diagnosis)
        return f"{_name(diagnosis)} explains the fitted runs ({ratio}), but not the hold-out runs: {there}."
    return f"{_name(diagnosis)} does not explain the recording: {ratio}."


def _outside(diagnosis: Diagnosis) -> list[str]:
    text = "No fault candidate, alone or with others, explains it"
    names = [effect.physics for effect in diagnosis.effects]
    if names:
        ratio = _variance(diagnosis.selection.fit.excess_variance, diagnosis)
        text += f": the nearest, {_list(names)}, leaves a {ratio}"
        text += "; taken twice at one place, it stands for a law that is neither" if diagnosis.twice else ""
    if diagnosis.proof is not None and diagnosis.proof.status == "disproved":
        text += f"; hold-out runs disprove it: {diagnosis.proof.reason}"
    unknown = "" if diagnosis.unknown is None else diagnosis.unknown.description
    return [_unexplained(diagnosis), f"{text}.", unknown, _unpredicted(diagnosis), _hold_out(diagnosis)]


def _missing(diagnosis: Diagnosis) -> list[str]:
    parts = [_unexplained(diagnosis)]
    for number, effect in enumerate(diagnosis.effects):
        parts.append(_sentence(effect, diagnosis))
        if number < len(diagnosis.explained):
            parts.append(_explains(diagnosis.explained[number], diagnosis))
    selection = diagnosis.selection
    if selection.mostly and not selection.explained:
        share = _percent(1 - selection.share)
        ratio = _variance(selection.fit.excess_variance, diagnosis)
        chance = _chance(selection.fit.goodness)
        parts.append(f"The repaired diagram leaves a {ratio} ({chance}), {share} of what was unexplained: details of")
        parts[-1] += " a law, or a small further effect."
        parts.append(_residual(diagnosis))
    parts.append(_hold_out(diagnosis))
    if diagnosis.proof is not None and diagnosis.proof.status == "unproved":
        parts.append(f"On {_runs(diagnosis)} this is unproved: {diagnosis.proof.reason}.")
    if diagnosis.score_after.rms and diagnosis.after.excess_variance > CRITERIA.model_error:
        ratio = _variance(diagnosis.after.excess_variance, diagnosis)
        parts.append(f"The repaired diagram leaves a {ratio}: a further effect would be small beside this one; a")
        parts[-1] += " diagnosis of the repaired diagram looks for it."
    return parts


def _disturbance(diagnosis: Diagnosis) -> MissingSignal | None:
    """Return the signal of an unmeasured disturbance; None where none was found."""
    names = {one.physics for one in diagnosis.effects if one.candidate.insertion.from_course}
    return next((signal for signal in diagnosis.signals if signal.physics in names), None)


def _disturbed(diagnosis: Diagnosis, signal: MissingSignal) -> list[str]:
    """Return the effects, and what is known of a signal that no simulation follows, whatever is repaired."""
    left = f"Estimated from all outputs it leaves a {_variance(signal.left, diagnosis)}."
    if signal.repeated is None:
        follows = "{:.2g} +- {:.2g}".format(*signal.follows)
        of = f"(exponent {follows}; 1 of a signal in proportion to it)"
        known = f"It is Gaussian, its power does not follow that of the motion {of}"
    else:
        known = f"In runs with the same inputs it has another course (correlation {signal.repeated:.2g})"
    return [
        _unexplained(diagnosis),
        *(_sentence(effect, diagnosis) for effect in diagnosis.effects),
        f"{known}, and nothing that is simulated predicts it: no simulation follows it. {left}",
        _hold_out(diagnosis),
    ]


def _unpredicted(diagnosis: Diagnosis) -> str:
    """Return that a missing signal outside the catalogue may be no law at all."""
    if not diagnosis.unpredicted:
        return ""
    signal = diagnosis.signals[0]
    size, memory = (_quantity(*signal.known(value)) for value in ("rms", "correlation_time"))
    text = f"Nothing that is simulated, nor time, predicts the signal missing at {signal.place.words} (rms {size}, "
    text += f"correlation time {memory}): "
    if signal.repeated is None:
        return f"{text}an unmeasured disturbance, or a law that no black box knows."
    return f"{text}but it comes again in runs with the same inputs (correlation {signal.repeated:.2g}), as laws do."


def _explains(item: Explained, diagnosis: Diagnosis) -> str:
    """Return how much of what can be explained an effect explains."""
    if item.share is None:
        return ""
    of = "the residual without it" if item.explainable is None else "what any law at that place could explain"
    if item.share.interval is None or item.share.interval[0] > WHOLE_SHARE:
        much = f"more than {_percent(WHOLE_SHARE)}" if item.share.value > WHOLE_SHARE else _percent(item.share.value)
    else:
        much = "{} ({} to {})".format(*(_percent(share) for share in (item.share.value, *item.share.interval)))
    return f"On {_runs(diagnosis)} it explains {much} of {of}."


def _residual(diagnosis: Diagnosis) -> str:
    """Return where the residual acts most likely, and its size."""
    place = None if diagnosis.residual is None else diagnosis.residual["place"]
    if diagnosis.residual is None or place is None:
        return ""
    size = diagnosis.residual["size"]
    node = "" if place["node"] is None else f"[{place['node']}]"
    at = f"{place['block']}.{place['port']}{node}"
    return f"The residual acts most likely at {at}: {format_quantity(size['value'], size['unit'], 2)} rms."


def _chance(probability: float) -> str:
    return f"probability {probability:.2g}" if probability > 1e-300 else "probability below 1e-300"


def _runs(diagnosis: Diagnosis) -> str:
    return "hold-out runs" if diagnosis.held_out else diagnosis.evidence.terms.left_out


def _sentence(effect: Effect, diagnosis: Diagnosis) -> str:
    """Return what is missing, with its sizes in the fit of all effects."""
    known = estimates(diagnosis.after)
    values = []
    for name in effect.candidate.insertion.free:
        if name in known:
            item = known[name]
            size = _quantity(item.value, 0.0 if item.at_bound else item.std, item.unit)
            values.append(f"{name.rpartition('.')[2]} {size}" + (" at its bound" if item.at_bound else ""))
    values += [f"{key} {_quantity(*value)}" for key, value in diagnosis.measured(effect).items()]
    sizes = ", ".join(values)
    names = [_placed(effect, name) for name in effect.members]
    if len(names) == 1:
        return f"Missing physics: {names[0]}" + (f" ({sizes})." if sizes else ".")
    text = f"Missing physics: one of these, which the data do not separate: {', '.join(names)}"
    return text + (f" (as {effect.physics}: {sizes})." if sizes else ".")


def _placed(effect: Effect, name: str) -> str:
    """Return a member of the class of an effect with its place, and the signal that it depends on there."""
    spot, other = effect.spot_of(name), effect.depends_on(name)
    at = f" at {spot.words}" if spot else ""
    return f"{name}{at}{f' (depends on {other})' if other else ''}"


def _quantity(value: float, std: float, unit: str) -> str:
    """Return a value with its standard deviation in the same unit, both to two digits of the latter; angles in deg."""
    if unit == "rad":
        value, std, unit = float(np.degrees(value)), float(np.degrees(std)), "deg"
    number, _, shown = format_quantity(value, unit, 12).partition(" ")
    factor = float(number) / value if value else 1.0
    if not (0 < std < (180 if unit == "deg" else np.inf)):
        return f"{format_quantity(value, unit)}" + ("" if std == 0 else ", not determined")
    places = 1 - int(np.floor(np.log10(std * factor)))
    digits = max(places, 0)
    both = (f"{round(part * factor, places):.{digits}f}" for part in (value, std))
    return f"{' +- '.join(both)} {shown}".strip()


def _hold_out(diagnosis: Diagnosis) -> str:
    """Return the errors on hold-out runs before and after, in the units of the signals where they are of samples."""
    first, last = diagnosis.score_before, diagnosis.score_after
    before, after = first.total, last.total
    floor = last.noise if first.noise is None else first.noise
    kind, lost = _runs(diagnosis), "the repaired diagram has no settled motion there"
    of = diagnosis.evidence.terms.signals.format("" if floor is None else _percent(floor))
    of = of if floor is not None else of.partition(" (")[0]
    alone = len(diagnosis.effects) == 1 and _disturbance(diagnosis) is not None
    if diagnosis.verdict == "consistent" or alone:
        text = "" if before is None else f"On {kind} its error is {_percent(before)} {of}."
    elif before is None and after is None:
        text = f"On {kind} neither diagram has a settled motion."
    elif before is None:
        why = f" ({first.reason})" if first.reason else ""
        text = f"On {kind} it has no settled motion{why}; the error of the repaired diagram is {_percent(after)} {of}."
    elif after is None:
        why = f" ({last.reason})" if last.reason and diagnosis.proof is None else ""
        text = f"On {kind} its error is {_percent(before)} {of.partition(' (')[0]}; {lost}{why}."
    else:
        change = f"{'falls' if after < before else 'goes'} from {_percent(before)} to {_percent(after)}"
        text = f"On {kind} the error {change} {of}."
    return " ".join(part for part in (text, _errors(diagnosis)) if part)


def _errors(diagnosis: Diagnosis) -> str:
    """Return the errors of the simulation in the units of the signals."""
    text = []
    for name, (value, unit) in diagnosis.score_before.rms.items():
        after = diagnosis.score_after.rms.get(name) if diagnosis.searched else None
        more = "" if after is None else f", {format_quantity(*after, 3)} after"
        text.append(f"{name} {format_quantity(value, unit, 3)} rms{more}")
    return f"Error of the simulation there: {'; '.join(text)}." if text else ""


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.3g} %"


def _list(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
