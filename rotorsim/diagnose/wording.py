"""What a diagnosis says in words: the statement and the next experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rotorsim.diagnose.fitting import Source
from rotorsim.diagnose.next_experiment import best_change
from rotorsim.diagnose.scoring import HeldScore
from rotorsim.units import format_quantity

if TYPE_CHECKING:
    from rotorsim.diagnose.conclusions import Diagnosis, Effect
    from rotorsim.fault import Fault

__all__ = ["next_experiment", "statement"]

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
    before, after = found.score_before, found.score_after
    name = str(found.document.get("name", "the diagram"))
    if not found.effects and found.verdict in ("consistent", "not_identifiable"):
        text = (
            f"{name} explains the recording: what is left over has {found.before.misfit / found.before.freedom:.3g} "
            "times the variance of the noise, and no row of the catalogue explains more of it than noise would."
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
        lost = found.disproved
        if isinstance(lost, HeldScore) and lost.misfit is not None:
            text += f", but {lost.misfit / lost.rows:.3g} times what noise and its parameters make in held-out runs"
        text += "."
        if found.outside.get("description"):
            text += " " + str(found.outside["description"])
        return text + _held_out(found)
    for effect in found.effects:
        text += " " + _sentence(effect, found)
    if found.named.nearly and not found.named.explained:
        left = found.named.fit.misfit / found.named.fit.freedom
        text += f" {left:.3g} times the variance of the noise are left: details of a law, or a small effect more."
    if before.total is not None and after.total is not None:
        text += _held_out(found)
    return text


def _sentence(effect: Effect, found: Diagnosis) -> str:
    """Return what is missing, with its sizes in the fit of all effects."""
    fit = found.after
    names = list(effect.members)
    known = {item.name: (j, item) for j, item in enumerate(fit.free)}
    values = []
    for name in effect.candidate.insertion.free:
        if name not in known:
            continue
        j, item = known[name]
        std = float(np.sqrt(max(fit.covariance[j, j], 0.0)))
        size = _quantity(float(fit.theta[j]), 0.0 if fit.at_bound[j] else std, item.unit)
        values.append(f"{name.rpartition('.')[2]} {size}" + (" at its bound" if fit.at_bound[j] else ""))
    values += [f"{key} {_quantity(size, std, unit)}" for key, (size, std, unit) in found.taken(effect).items()]
    sizes = ", ".join(values)
    if len(names) == 1:
        place = f" at {effect.places[0][0]}" if effect.places else ""
        return f"Missing is {names[0]}{place}" + (f" ({sizes})." if sizes else ".")
    best = {name: item.insertion.spot for name, item in effect.rivals.items()}
    best[effect.physics] = effect.candidate.insertion.spot
    alike = [f"{name} at {best[name]}" if name in best else name for name in names]
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
    kind = "held-out runs" if found.held else "runs left out one by one"
    if before is None or floor is None:
        return ""
    if found.verdict == "consistent":
        return f" On {kind} its error is {_percent(before)} of the signals (noise {_percent(floor)})."
    if after is None:
        lacks = "the repaired diagram has no settled motion there"
        return f" On {kind} its error is {_percent(before)} of the signals; {lacks}."
    change = f"{'falls' if after < before else 'goes'} from {_percent(before)} to {_percent(after)}"
    return f" On {kind} the error {change} of the signals (noise {_percent(floor)})."


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _list(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
