"""What an identification says, whatever the recording was compared by."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from rotorsim._shown import Shown
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Problem
from rotorsim.identification.advice import Advice
from rotorsim.identification.harmonic.profile import joint_factor
from rotorsim.identification.verdict import Verdict
from rotorsim.identification.waveform.estimate import TimeEstimate


@dataclass(frozen=True)
class Identified:
    """One identified parameter (SI): value, standard deviation, central 90 % interval, and the verdict on it.

    joint90: intervals that hold all parameters at once with 90 %. at_bound: the search ended at a physical bound; the
    interval is then one-sided, and std is what it stands for.
    """

    name: str
    value: float
    std: float
    interval90: tuple[float, float]
    joint90: tuple[float, float]
    unit: str
    verdict: Verdict
    at_bound: bool = False


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Identification(Shown, ABC):
    """What a recording says about the free parameters of a diagram.

    correlation: (m, m). fit: "identify" and "hold_out" -> signal -> NRMSE; noise_floor: signal -> what no model can
    undercut. excess: variance of the residual over that of the noise (1 for a right model); None for the regression,
    which does not weigh. adequate: the model explains the data within noise. diagram: with meshes as the data want;
    sha256: of the document as given. free: the parameters as they were before, with start values and bounds.
    `HarmonicIdentification` of a turning shaft, `TimeIdentification` of samples in time.
    """

    method: str
    parameters: Mapping[str, Identified]
    correlation: np.ndarray
    fit: Mapping[str, Mapping[str, float]]
    noise_floor: Mapping[str, float]
    excess: float | None
    adequate: bool
    statement: str
    advice: tuple[Advice, ...]
    warnings: tuple[Problem, ...]
    diagram: Diagram
    sha256: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    free: tuple[Free, ...] = ()

    _figure = "rotorsim.report.identification.parameters:parameters_figure"
    _beside: ClassVar[str] = ""  # "module:function" of the figures beside what was measured, by name

    @property
    @abstractmethod
    def run_ids(self) -> list[str]:
        """The runs that were identified from."""

    @abstractmethod
    def misfit_data(self) -> dict[str, Any]:
        """Return how large the residual is, in the form of identification.json."""

    def figures_beside(self, recording: Any) -> Mapping[str, Any]:
        """Return the figures of the model beside a recording by name, None where there is nothing to show."""
        module, _, function = self._beside.partition(":")
        figures: Mapping[str, Any] = getattr(import_module(module), function)(self, recording)
        return figures

    def __repr__(self) -> str:
        return f"Identification({self.statement})"

    def to_table(self) -> list[dict[str, Any]]:
        """Return one row per parameter (SI): value, std, ends of the 90 % interval, unit, whether identifiable."""
        return [
            {
                "parameter": item.name,
                "value": item.value,
                "std": item.std,
                "low90": item.interval90[0],
                "high90": item.interval90[1],
                "unit": item.unit,
                "identifiable": item.verdict.identifiable,
            }
            for item in self.parameters.values()
        ]

    @property
    def values(self) -> dict[str, float]:
        """The identified values by name, SI."""
        return {name: item.value for name, item in self.parameters.items()}

    @property
    def open(self) -> tuple[str, ...]:
        """The parameters that the data do not determine."""
        return tuple(name for name, item in self.parameters.items() if not item.verdict.identifiable)


def identified(estimate: TimeEstimate, verdicts: Sequence[Verdict]) -> tuple[dict[str, Identified], np.ndarray]:
    """Return the parameters of an output-error estimate with verdicts, and their correlation (m, m)."""
    std = np.sqrt(np.diag(estimate.covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.nan_to_num(estimate.covariance / np.outer(std, std))
    theta, intervals = estimate.theta, estimate.intervals
    joint = theta[:, None] + joint_factor(correlation) * (intervals - theta[:, None])
    parameters = {
        item.name: Identified(
            item.name,
            float(theta[j]),
            float(estimate.std[j]),
            (float(intervals[j, 0]), float(intervals[j, 1])),
            (max(float(joint[j, 0]), item.low), min(float(joint[j, 1]), item.high)),
            item.unit,
            verdicts[j],
            bool(estimate.at_bound[j]),
        )
        for j, item in enumerate(estimate.free)
    }
    return parameters, correlation


def sentences(parameters: Mapping[str, Identified], advice: Sequence[Advice], tried: str) -> list[str]:
    """Return what was found in plain words; tried: the changes of the experiment that were, where none helps."""
    sure = [name for name, item in parameters.items() if item.verdict.identifiable]
    parts = [f"{len(sure)} of {len(parameters)} parameters are identified" + (f": {', '.join(sure)}." if sure else ".")]
    parts += [
        f"{name} is not: {item.verdict.reason}." for name, item in parameters.items() if not item.verdict.identifiable
    ]
    if advice:
        best = advice[0]
        parts.append(f"Next experiment: {best.change}; it would determine {', '.join(best.solves)}.")
    elif len(sure) < len(parameters) and tried:
        parts.append(f"No change of {tried} that was tried would determine them.")
    return parts
