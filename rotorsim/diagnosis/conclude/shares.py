"""How much each effect explains of what can be explained on hold-out runs, and the residual of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, t

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.evidence.evidence import Validation
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate
from rotorsim.diagnosis.search.selection import Selection

Pairs = Sequence[tuple[float, float]]  # misfit and equations of each run


@dataclass(frozen=True)
class Share:
    """A share and its 90 % interval (None of a single run)."""

    value: float
    interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class Explained:
    """share: of what is explainable, with its interval; None: not known.

    explainable: the share of all that is left without the effect that a free force or signal at its place explains;
    None where no such signal can be put there, and all counts as explainable.
    """

    share: Share | None = None
    explainable: float | None = None


def explanations(selection: Selection, validation: Validation) -> tuple[Explained, ...]:
    """Return of each effect how much it explains of hold-out runs, beside the others."""
    after = validation.runs_of(selection.fit) if selection.chosen else None
    pairs = zip(selection.chosen, selection.rounds, strict=False)
    return tuple(
        Explained() if after is None else _explained(item.insertion, found.before, after, validation)
        for item, found in pairs
    )


def _explained(item: Insertion, without: Fit, after: Pairs, validation: Validation) -> Explained:
    before = validation.runs_of(without)
    if before is None:
        return Explained()
    least = validation.least(item, without)
    share = share_explained(before, after, least)
    if least is None or share is None:
        return Explained(share)
    unexplained, free = (sum(misfit - rows for misfit, rows in pairs) for pairs in (before, least))
    return Explained(share, float(np.clip(1 - free / unexplained, 0.0, 1.0)) if unexplained > 0 else None)


def share_explained(before: Pairs, after: Pairs, least: Pairs | None = None) -> Share | None:
    """Return the share of what is to be explained in hold-out runs that a repair explains.

    sum_r (b_r - a_r) / sum_r (b_r - f_r), of each run r the misfit less the number of equations: before b, after a,
    and f with free harmonics of a force or signal at the place of the repair, least (default: zero). Interval: Student,
    by leaving out one run after the other (jackknife; Quenouille, Biometrika 43 (1956) 353). None where nothing is to
    be explained, or it is not known.
    """
    if not before or len(before) != len(after) or (least is not None and len(least) != len(after)):
        return None
    b, a = (np.array([misfit - rows for misfit, rows in pairs]) for pairs in (before, after))
    f = np.zeros(len(b)) if least is None else np.array([misfit - rows for misfit, rows in least])
    to_explain = float((b - f).sum())
    rows = sum(pair[1] for pair in before)
    if not np.isfinite([*b, *a, *f]).all() or to_explain <= chi2.isf(CRITERIA.surprise, rows) - rows:
        return None
    value, R = float((b - a).sum()) / to_explain, len(b)
    if R < 2:
        return Share(min(value, 1.0))
    without = np.array([np.delete(b - a, r).sum() / np.delete(b - f, r).sum() for r in range(R)])
    spread = float(np.sqrt((R - 1) / R * ((without - without.mean()) ** 2).sum()))
    half = float(t.isf((1 - CRITERIA.level) / 2, R - 1)) * spread
    return Share(min(value, 1.0), (value - half, min(value + half, 1.0)))


def residual_of(base: Fit, after: Fit, validation: Validation) -> Mapping[str, Any] | None:
    """Return the residual of a fit beyond noise: its share, where it acts most likely, and its size there.

    The share is that of the misfit of the fitted runs beyond noise that the diagram as given leaves. Place and size:
    see `Validation.residual_place`. None where noise explains all.
    """
    if after.failure or is_adequate(after):
        return None
    share = (after.misfit - after.freedom) / max(base.misfit - base.freedom, 1e-300)
    share = 1.0 if after is base else float(min(share, 1.0))
    place = validation.residual_place(base, after) or {"place": None, "size": None}
    return {"share": share, "excess_variance": after.excess_variance, **place}
