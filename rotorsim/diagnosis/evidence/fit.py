"""A diagram at its most likely parameters: what every fit to every sort of evidence gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA, Z90
from rotorsim.diagram.diagram import Free
from rotorsim.errors import RotorsimError
from rotorsim.identification.harmonic.coordinates import stretched
from rotorsim.model.heard import listener

DEFERRED = "is nonlinear, and not fitted yet"

# Groups of starts {free parameter: SI value}: of each group the most promising ones are followed.
Starts = Sequence[Sequence[Mapping[str, float]]]


FAILURES = (RotorsimError, ValueError, np.linalg.LinAlgError)  # of a diagram that cannot be compared with data


def reason_of(error: Exception) -> str:
    """Return in words why a diagram cannot be compared with data; of a part that fails, with its name."""
    if not isinstance(error, RotorsimError):
        return str(error) or type(error).__name__
    problem = error.problems[0]
    return f"{problem.subject}: {problem.what}" if _of_part(error) else problem.what


def _of_part(error: Exception) -> bool:
    """Return whether a part whose equations are elsewhere has failed."""
    subject = error.problems[0].subject if isinstance(error, RotorsimError) else ""
    return any(one.kind and one.subject == subject for one in listener().mishaps)


def _empty() -> np.ndarray:
    return np.zeros(0)


@dataclass(frozen=True)
class Effort:
    """How far a fit is carried. Evidence that fits at less than another's cost may do more.

    most: a limit of evaluations. linear_only: the failure of a diagram that is nonlinear is DEFERRED. beyond: a misfit;
    what leaves more after the first steps is not followed. lost: whether a fit that has lost the measured motion is
    begun again with short parts of the runs, which takes as long as two others.
    """

    most: int | None = None
    linear_only: bool = False
    beyond: float = np.inf
    lost: bool = True


TO_THE_END = Effort()


@dataclass(frozen=True, eq=False)
class Fit:
    """A diagram at its most likely parameters.

    free, theta (m,), covariance (m, m), at_bound (m,). misfit: |r|^2 of the whitened residual; equations: real ones, of
    which rows remain after nuisance parameters. run_misfit, left_out (R,): |r|^2 of each run, and when it is predicted
    from the others. goodness: probability of a larger misfit. failure: why there is no fit; stopped: a part whose
    equations are elsewhere failed, or the process, which says nothing of the diagram. nonlinear: in its states.
    seconds: CPU time. standing: nuisance parameters of the diagram as given (default: all of this one). line_misfit,
    line_rows: |r|^2 and equations of the asynchronous lines. ends (m, 2): 90 % intervals within the bounds. alone (m,):
    standard deviations with all other parameters of the same block known. starts: the states at the first samples of
    runs in time.
    """

    document: Mapping[str, Any]
    free: tuple[Free, ...] = ()
    theta: np.ndarray = field(default_factory=_empty)
    covariance: np.ndarray = field(default_factory=_empty)
    at_bound: np.ndarray = field(default_factory=_empty)
    misfit: float = np.inf
    rows: int = 0
    equations: int = 0
    run_misfit: np.ndarray = field(default_factory=_empty)
    left_out: np.ndarray = field(default_factory=_empty)
    goodness: float = 0.0
    failure: str = ""
    stopped: bool = False
    nonlinear: bool = False
    seconds: float = 0.0
    standing: int | None = None
    line_misfit: float = 0.0
    line_rows: int = 0
    ends: np.ndarray = field(default_factory=_empty)
    alone: np.ndarray = field(default_factory=_empty)
    starts: np.ndarray = field(default_factory=_empty)

    @property
    def freedom(self) -> int:
        """Degrees of freedom: equations less parameters."""
        return max(self.rows - len(self.free), 1)

    @property
    def excess_variance(self) -> float:
        """The residual variance, as a multiple of that of the noise."""
        return self.misfit / self.freedom

    @property
    def criterion(self) -> float:
        """Bayesian information criterion with the noise as it was measured: misfit and a charge per free parameter.

        Nuisance parameters that the diagram as given has cost what noise alone gives them, so that it is no merit to
        leave fewer means of slow states open; those that a law adds cost as much as its parameters.
        """
        added = 0 if self.standing is None else max(self.nuisances - self.standing, 0)
        charged = (len(self.free) + added) * float(np.log(max(self.equations, self.rows, 2)))
        return self.misfit + (self.nuisances - added) + charged

    @property
    def nuisances(self) -> int:
        """Nuisance parameters, such as the means of states that have not settled."""
        return max(self.equations - self.rows, 0)

    @property
    def widening(self) -> float:
        """The factor on intervals where the diagram does not explain the data."""
        unexplained = self.goodness < CRITERIA.not_explained
        return float(np.sqrt(max(self.excess_variance, 1.0))) if unexplained else 1.0

    def interval90(self, j: int) -> tuple[float, float]:
        """Return the 90 % interval of a parameter, within its bounds: one-sided at one, infinite if undetermined."""
        value, item = float(self.theta[j]), self.free[j]
        ends = self.ends[j] if len(self.ends) else value + Z90 * self.std(j) * np.array([-1.0, 1.0]) / self.widening
        low, high = (stretched(item, value, float(end), self.widening) for end in ends)
        return max(low, item.low), min(high, item.high)

    def std(self, j: int) -> float:
        """Return the standard deviation of a parameter; at a bound, that which its one-sided interval stands for."""
        if self.at_bound[j] and len(self.ends):
            return self.widening * float(np.abs(self.ends[j] - self.theta[j]).max()) / Z90
        return self.widening * float(np.sqrt(max(float(self.covariance[j, j]), 0.0)))

    @property
    def values(self) -> dict[str, float]:
        """The parameters by name, SI."""
        return {item.name: float(v) for item, v in zip(self.free, self.theta, strict=True)}


def failed_fit(document: Mapping[str, Any], error: Exception, **more: Any) -> Fit:
    """Return the fit of a diagram that cannot be compared with data."""
    return Fit(document, failure=reason_of(error), stopped=_of_part(error), **more)


def is_adequate(fit: Fit) -> bool:
    """Return whether noise can make the residual of a fit."""
    if fit.failure:
        return False
    return fit.goodness >= CRITERIA.not_explained or fit.misfit <= CRITERIA.model_error * fit.freedom


def is_noise(fit: Fit) -> bool:
    """Return whether noise can make the residual, of few asynchronous lines beside many harmonics too."""
    return is_adequate(fit) and float(chi2.sf(fit.line_misfit, max(fit.line_rows, 1))) >= CRITERIA.not_explained


def is_astray(item: Free, value: float, sizes: Sequence[float]) -> bool:
    """Return whether a parameter is `astray` times the sizes that were stated or known.

    What is in series is rigid where it is large, which is no effect: it goes astray where it is small.
    """
    known = [size for size in sizes if size > 0]
    if item.series:
        return bool(known) and CRITERIA.astray * abs(value) < min(known)
    return bool(known) and abs(value) > CRITERIA.astray * max(known)


def fit_to_plain(fit: Fit) -> dict[str, Any]:
    """Return a fit as plain data, without its document."""
    values = {item.name: getattr(fit, item.name) for item in fields(Fit) if item.name not in ("document", "free")}
    plain = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
    return {**plain, "free": [asdict(item) for item in fit.free]}


def fit_from_plain(document: Mapping[str, Any], plain: Mapping[str, Any]) -> Fit:
    """Return the fit of a document from plain data."""
    values: dict[str, Any] = {name: np.array(v) if isinstance(v, list) else v for name, v in plain.items()}
    values["free"] = tuple(Free(**item) for item in plain["free"])
    return Fit(document, **values)
