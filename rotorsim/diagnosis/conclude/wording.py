"""What a diagnosis says in words: the statement and the next experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rotorsim.diagnosis.conclude.next_experiment import best_change
from rotorsim.diagnosis.evidence.harmonic import Source
from rotorsim.diagnosis.search.trials import is_noise
from rotorsim.units import format_quantity

if TYPE_CHECKING:
    from rotorsim.diagnosis.conclude.conclusions import Diagnosis, Effect
    from rotorsim.diagnosis.conclude.explaining import Explained
    from rotorsim.fault import Fault

__all__ = ["next_experiment", "statement"]

ALL = 0.999  # a share from which its digits say nothing
ONE_SPEED = "at one speed unbalance imitates bow and runout, and force factors imitate stiffness and damping"
MORE_RUNS = "runs at several speeds, from slow roll to above the first critical, and some with other gains"


def next_experiment(found: Diagnosis) -> str:
    """Return the change that would tell apart what is left, or say that none is needed."""
    parts = []
    known = () if found.verdict == "outside_catalogue" else found.effects  # else none to tell from its rivals
    for effect in known:
        for name, rival in effect.rivals.items():
            told = _told_apart(effect.candidate.insertion.fault, rival.insertion.fault)
            change = None
            if isinstance(found.source, Source):
                change = best_change(effect.candidate.fit, rival.fit, found.source)
            text = f"to tell {effect.physics} from {name}: "
            if change is not None and change.runs:
                times = "" if change.runs == 1 else f", {change.runs} times,"
                text += f"{change.words}{times} (predictions {change.separation:.2g} standard deviations apart)"
            elif change is not None:
                apart = f"predictions only {change.separation:.2g} standard deviations apart"
                text += f"{change.words} tells most ({apart})" + (f"; {told}" if told else "")
            elif isinstance(found.source, Source):
                text += "no other speed or gain does" + (f"; {told}" if told else "")
            else:
                text += told or "another input, or a sensor elsewhere"
            parts.append(text)
    if found.verdict == "outside_catalogue":
        parts.append("runs at more speeds and amplitudes about the place named, to see the law of the unknown force")
    if parts:
        return "; ".join(parts)
    if found.verdict in ("consistent", "not_identifiable") and _alike(found.source):
        return f"{MORE_RUNS}: {ONE_SPEED}"
    if found.verdict == "consistent":
        return "none is needed for what the diagram states; smaller effects need lower noise or longer runs"
    return "none is needed: one explanation is left"


def _alike(source: Source | None) -> bool:
    return isinstance(source, Source) and source.alike


def _told_apart(first: Fault, second: Fault) -> str:
    """Return what is declared to tell two faults apart: by one that names the other, else by any."""
    pairs = ((first, second), (second, first))
    named = [a.told_apart_by for a, b in pairs if b.physics in a.confused_with and a.told_apart_by]
    return (named or [fault.told_apart_by for fault in (first, second)])[0]


def statement(found: Diagnosis) -> str:
    """Return one paragraph in plain words."""
    name = str(found.document.get("name", "the diagram"))
    if not found.effects and found.verdict in ("consistent", "not_identifiable"):
        rest = f"what is left over has {found.before.misfit / found.before.freedom:.3g} times the variance of the noise"
        if is_noise(found.before):
            none = "no row of the catalogue explains more of it than noise would"
            text = f"{name} explains the recording: {rest}, and {none}."
        else:
            text = (
                f"{name} explains the recording, but for little: {rest}, and no row of the catalogue explains that in "
                f"runs that took no part, too.{_residual(found)}"
            )
        if _alike(found.source):
            text += f" All its runs are alike, though: {ONE_SPEED}."
        return text + _held_out(found)
    excess = found.before.misfit / found.before.freedom
    text = f"{name} does not explain the recording: it leaves {excess:.3g} times the variance of the noise."
    if found.verdict == "outside_catalogue":
        nearest = found.effects[0] if found.effects else None
        text += " No effect of the catalogue, alone or with others, explains it"
        if nearest is not None:
            left = found.named.fit.misfit / found.named.fit.freedom
            text += f": the nearest, {_list([e.physics for e in found.effects])}, leaves {left:.3g} times"
        if found.proof is not None and found.proof.status == "disproved":
            text += f", but held-out runs disprove it: {found.proof.reason}"
        text += "."
        if found.outside.get("description"):
            text += " " + str(found.outside["description"])
        return text + _held_out(found)
    for number, effect in enumerate(found.effects):
        text += " " + _sentence(effect, found)
        if number < len(found.explained):
            text += _explains(found.explained[number], found)
    if found.named.mostly and not found.named.explained:
        fit = found.named.fit
        text += (
            f" {fit.misfit / fit.freedom:.3g} times the variance of the noise are left ({_chance(fit.goodness)} that "
            f"noise makes as much), {_percent(1 - found.named.share)} of what was unexplained: details of a law, or a "
            f"small effect more.{_residual(found)}"
        )
    text += _held_out(found)
    if found.proof is not None and found.proof.status == "unproved":
        text += f" On {_kind(found)} this is unproved: {found.proof.reason}."
    return text


def _explains(item: Explained, found: Diagnosis) -> str:
    """Return how much of what is to be explained an effect explains."""
    if item.share is None:
        return ""
    of = "is left without it" if item.explainable is None else "anything at that place could explain"
    if item.share.interval is None or item.share.interval[0] > ALL:
        much = f"more than {_percent(ALL)}" if item.share.value > ALL else _percent(item.share.value)
    else:
        much = "{} ({} to {})".format(*(_percent(share) for share in (item.share.value, *item.share.interval)))
    return f" On {_kind(found)} it explains {much} of what {of}."


def _residual(found: Diagnosis) -> str:
    """Return where what is left over acts most likely, and its size."""
    place = None if found.residual is None else found.residual["place"]
    if found.residual is None or place is None:
        return ""
    size = found.residual["size"]
    node = "" if place["node"] is None else f"[{place['node']}]"
    at = f"{place['block']}.{place['port']}{node}"
    return f" What is left acts most likely at {at}: {format_quantity(size['value'], size['unit'], 2)} rms."


def _chance(probability: float) -> str:
    return f"probability {probability:.2g}" if probability > 1e-300 else "probability below 1e-300"


def _kind(found: Diagnosis) -> str:
    return "held-out runs" if found.held else "runs left out one by one"


def _sentence(effect: Effect, found: Diagnosis) -> str:
    """Return what is missing, with its sizes in the fit of all effects."""
    from rotorsim.diagnosis.conclude.conclusions import estimates

    names = list(effect.members)
    known = estimates(found.after)
    values = []
    for name in effect.candidate.insertion.free:
        if name in known:
            item = known[name]
            size = _quantity(item.value, 0.0 if item.at_bound else item.std, item.unit)
            values.append(f"{name.rpartition('.')[2]} {size}" + (" at its bound" if item.at_bound else ""))
    values += [f"{key} {_quantity(size, std, unit)}" for key, (size, std, unit) in found.taken(effect).items()]
    sizes = ", ".join(values)
    if len(names) == 1:
        return f"Missing is {names[0]} at {effect.spot_of(names[0])}" + (f" ({sizes})." if sizes else ".")
    alike = [f"{name} at {effect.spot_of(name)}" if effect.spot_of(name) else name for name in names]
    text = f"Missing is one of these, which the data do not tell apart: {', '.join(alike)}"
    return text + (f" (as {effect.physics}: {sizes})." if sizes else ".")


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


def _held_out(found: Diagnosis) -> str:
    before, after, floor = found.score_before.total, found.score_after.total, found.score_before.noise
    floor = found.score_after.noise if floor is None else floor
    kind = _kind(found)
    noise = "" if floor is None else f" (noise {_percent(floor)})"
    if found.verdict == "consistent":
        return "" if before is None else f" On {kind} its error is {_percent(before)} of the signals{noise}."
    lost = [str(getattr(item, "reason", "")) for item in (found.score_before, found.score_after)]
    if before is None and after is None:
        return f" On {kind} neither diagram has a settled motion."
    if before is None:
        why = f" ({lost[0]})" if lost[0] else ""
        return f" On {kind} it has no settled motion{why}; the repaired diagram's error is {_percent(after)}{noise}."
    if after is None:
        why = f" ({lost[1]})" if lost[1] and found.proof is None else ""
        lacks = f"the repaired diagram has no settled motion there{why}"
        return f" On {kind} its error is {_percent(before)} of the signals; {lacks}."
    change = f"{'falls' if after < before else 'goes'} from {_percent(before)} to {_percent(after)}"
    return f" On {kind} the error {change} of the signals{noise}."


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.3g} %"


def _list(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
