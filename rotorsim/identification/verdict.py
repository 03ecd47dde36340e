"""Which parameters the data determine, which only in combination with others, and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rotorsim.criteria import CRITERIA, Z90
from rotorsim.diagram.diagram import Free
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT
from rotorsim.units import format_quantity


@dataclass(frozen=True)
class Combination:
    """A linear combination of parameters that is known much better than they are: sum of factors * parameters."""

    factors: dict[str, float]
    value: float
    std: float
    unit: str

    @property
    def expression(self) -> str:
        """The combination as text: 'a - 4930 b'."""
        text = ""
        for name, factor in self.factors.items():
            sign = " - " if factor < 0 else " + " if text else ""
            size = "" if abs(abs(factor) - 1) < 1e-12 else f"{abs(factor):.4g} "
            text += f"{sign if text or factor < 0 else ''}{size}{name}"
        return text.strip()


@dataclass(frozen=True)
class Verdict:
    """Whether one parameter is identified; why not; with which others it is confused, and what is known instead."""

    identifiable: bool
    reason: str
    partners: tuple[str, ...] = ()
    combination: Combination | None = None


class Uncertain(Protocol):
    """Estimated parameters theta (m,) [SI] with what is judged of them."""

    @property
    def free(self) -> tuple[Free, ...]:
        """The free parameters as they were before."""

    @property
    def theta(self) -> np.ndarray:
        """The estimates (m,)."""

    @property
    def at_bound(self) -> np.ndarray:
        """Whether the search ended at a bound, (m,)."""

    @property
    def covariance(self) -> np.ndarray:
        """The covariance of theta (m, m)."""

    def conditional(self, j: int) -> float:
        """Return the standard deviation of parameter j if all others were known."""


def relative_width(value: float, half_width: float, unit: str) -> float:
    """Return the half width of an interval as part of the value; of one radian for an angle."""
    scale = 1.0 if unit == ANGLE_UNIT else abs(value)
    return half_width / scale if scale > 0 else np.inf


def judge(
    estimate: Uncertain, intervals: np.ndarray, *, precision: float = CRITERIA.precision, widen: float = 1.0
) -> list[Verdict]:
    """Return the verdict on every parameter.

    A parameter is identified when half of its 90 % interval is at most ``precision`` of its value (of one radian for
    an angle). Otherwise it is uncertain by itself, or only together with others: then the best known combination is
    given.
    """
    covariance = estimate.covariance * widen**2
    std = np.sqrt(np.maximum(np.diag(covariance), 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.nan_to_num(covariance / np.outer(std, std))
    verdicts = []
    for j, item in enumerate(estimate.free):
        value = float(estimate.theta[j])
        half = float(intervals[j, 1] - intervals[j, 0]) / 2
        width = relative_width(value, half, item.unit)
        if not item.low <= value <= item.high:
            text = f"{format_quantity(value, item.unit)} is outside its physical bounds: the data or the model are not"
            verdicts.append(Verdict(False, text + " right for it"))
        elif estimate.at_bound[j] and item.series and value > item.scale:
            least = format_quantity(float(intervals[j, 0]), item.unit)
            verdicts.append(Verdict(False, f"it is as good as rigid: the data say only that it is above {least}"))
        elif estimate.at_bound[j]:
            near = item.low if abs(value - item.low) <= abs(value - item.high) else item.high
            text = f"the search ended at its physical bound {format_quantity(near, item.unit)}"
            verdicts.append(Verdict(False, text + ": the data or the model are not right for it"))
        elif width <= precision:
            verdicts.append(Verdict(True, f"known within {_percent(width, item.unit)}"))
        else:
            verdicts.append(_not_identified(estimate, covariance, correlation, j, width, precision))
    return verdicts


def _not_identified(
    estimate: Uncertain, covariance: np.ndarray, correlation: np.ndarray, j: int, width: float, precision: float
) -> Verdict:
    item = estimate.free[j]
    others = [k for k in np.argsort(-np.abs(correlation[j])) if k != j and abs(correlation[j, k]) > CRITERIA.correlated]
    others = [k for k in others if not estimate.at_bound[k]]
    alone = estimate.conditional(j) * covariance[j, j] ** 0.5 / max(estimate.covariance[j, j] ** 0.5, 1e-300)
    alone_width = relative_width(float(estimate.theta[j]), Z90 * alone, item.unit)
    if not others or alone_width > CRITERIA.partners * width:
        text = (
            f"the data say too little about it: its 90 % interval is +-{_percent(width, item.unit)}, and would be "
            f"+-{_percent(alone_width, item.unit)} if all other parameters were known"
        )
        return Verdict(False, text)
    names = tuple(estimate.free[k].name for k in others)
    combination = _combination(estimate, covariance, j, others)
    text = (
        f"cannot be told from {_list(names)} with these data (correlation {correlation[j, others[0]]:+.4f}): by itself "
        f"it is known within +-{_percent(width, item.unit)} only, but {combination.expression} is "
        f"{combination.value:.5g} +- {Z90 * combination.std:.2g} {combination.unit}"
    )
    return Verdict(False, text, names, combination)


def _combination(estimate: Uncertain, covariance: np.ndarray, j: int, others: list[int]) -> Combination:
    """Return parameter j less its regression on the others: what is left is known best."""
    inner = covariance[np.ix_(others, others)]
    factors = np.linalg.lstsq(inner, covariance[others, j], rcond=1e-12)[0]
    weights = {
        estimate.free[j].name: 1.0,
        **{estimate.free[k].name: -float(f) for k, f in zip(others, factors, strict=True)},
    }
    value = float(estimate.theta[j] - factors @ estimate.theta[others])
    variance = float(covariance[j, j] - factors @ covariance[others, j])
    return Combination(weights, value, float(np.sqrt(max(variance, 0.0))), estimate.free[j].unit)


def _percent(width: float, unit: str) -> str:
    if unit == ANGLE_UNIT:
        return f"{np.degrees(width):.2g} deg"
    return f"{100 * width:.2g} %" if np.isfinite(width) else "any amount"


def _list(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
