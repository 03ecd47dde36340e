"""What a diagnosis says in words: the statement and the next experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rotorsim.diagnose.fitting import Source
from rotorsim.diagnose.next_experiment import best_change
from rotorsim.units import format_quantity

if TYPE_CHECKING:
    from rotorsim.diagnose.diagnosis import Diagnosis, Effect

__all__ = ["next_experiment", "statement"]


def next_experiment(found: Diagnosis) -> str:
    """Return the change that would tell apart what is left, or say that none is needed."""
    parts = []
    for effect in found.effects:
        for name, rival in effect.rivals.items():
            told = effect.candidate.insertion.fault.told_apart_by or rival.insertion.fault.told_apart_by
            change = None
            if isinstance(found.source, Source):
                change = best_change(effect.candidate.fit, rival.fit, found.source)
            text = f"to tell {effect.physics} from {name}: "
            if change is not None:
                text += f"{change.words} ({change.separation:.2g} standard deviations apart in one run)"
            else:
                text += "no other speed or gain does" + (f"; {told}" if told else "")
            parts.append(text)
    if found.verdict == "outside_catalogue":
        parts.append("runs at more speeds and amplitudes about the place named, to see the law of the unknown force")
    if parts:
        return "; ".join(parts)
    if found.verdict == "consistent":
        return "none is needed for what the diagram states; smaller effects need lower noise or longer runs"
    return "none is needed: one explanation is left"


def statement(found: Diagnosis) -> str:
    """Return one paragraph in plain words."""
    before, after = found.score_before, found.score_after
    name = str(found.document.get("name", "the diagram"))
    if found.verdict == "consistent":
        text = (
            f"{name} explains the recording: what is left over has {found.before.misfit / found.before.freedom:.3g} "
            "times the variance of the noise, and no row of the catalogue explains more of it than noise would."
        )
        return text + _held_out(found)
    excess = found.before.misfit / found.before.freedom
    text = f"{name} does not explain the recording: it leaves {excess:.3g} times the variance of the noise."
    if found.verdict == "outside_catalogue":
        nearest = found.effects[0] if found.effects else None
        text += " No effect of the catalogue, alone or with others, explains it"
        if nearest is not None:
            left = found.after.misfit / found.after.freedom
            text += f": the nearest, {_list([e.physics for e in found.effects])}, leaves {left:.3g} times"
        text += "."
        if found.outside.get("description"):
            text += " " + str(found.outside["description"])
        return text + _held_out(found)
    for effect in found.effects:
        text += " " + _sentence(effect)
    if before.total is not None and after.total is not None:
        text += _held_out(found)
    return text


def _sentence(effect: Effect) -> str:
    names = list(effect.members)
    place = f"at {effect.places[0][0]}" if effect.places else ""
    fit = effect.candidate.fit
    known = {item.name: (j, item) for j, item in enumerate(fit.free)}
    values = []
    for name in effect.candidate.parameters:
        j, item = known[name]
        std = float(np.sqrt(max(fit.covariance[j, j], 0.0)))
        values.append(f"{name.rpartition('.')[2]} {_quantity(float(fit.theta[j]), std, item.unit)}")
    text = f"Missing is {names[0]} {place}" if len(names) == 1 else f"Missing {place} is one of {', '.join(names)}"
    return text + (f" ({', '.join(values)})." if values else ".")


def _quantity(value: float, std: float, unit: str) -> str:
    plain = "" if unit in ("", "1") else unit
    return f"{format_quantity(value, unit)} +- {std:.2g} {plain}".strip()


def _held_out(found: Diagnosis) -> str:
    before, after, floor = found.score_before.total, found.score_after.total, found.score_before.noise
    kind = "held-out runs" if found.held else "runs left out one by one"
    if before is None or floor is None:
        return ""
    if found.verdict == "consistent":
        return f" On {kind} its error is {before:.3g} of the signals (noise {floor:.3g})."
    if after is None:
        return f" On {kind} its error is {before:.3g} of the signals; the repaired diagram has no settled motion there."
    return f" On {kind} the error falls from {before:.3g} to {after:.3g} of the signals (noise {floor:.3g})."


def _list(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
