"""Evidence of a machine at rest: recorded resonances, by frequency and shape, compared with the modes of a diagram.

For diagrams with modes far above the sample rate, which no simulation follows in time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Defaults, Score, Terms
from rotorsim.diagnosis.evidence.fit import FAILURES, Effort, Fit, Starts
from rotorsim.diagnosis.evidence.resonance.drive import driven_at
from rotorsim.diagnosis.evidence.resonance.modes import Modes
from rotorsim.diagnosis.evidence.resonance.resonances import Resonance
from rotorsim.diagnosis.evidence.waveform.runs import SampledRuns
from rotorsim.diagram.diagram import Free
from rotorsim.identification.left_out import left_out

UNMATCHED_RESIDUAL = 3.0  # residual of a resonance that no mode is left for
MOST_SOLUTIONS = 40
DIFFERENCE_STEP = 1e-4  # of a parameter, for differences
AT_BOUND = 1e-6  # of a parameter or its usual size: how near the search comes to a bound that holds it
RESONANCE_TERMS = Terms(
    noise=f"the error of models from drawings ({CRITERIA.frequency:.0%} of a frequency)",
    left_out="resonances left out one by one",
    predicted="resonances left out",
    signals="of the frequencies (their spread over the sensors {})",
    more_runs="runs at more amplitudes and frequencies of what drives it",
    another="another input, or a sensor elsewhere",
    turns=False,
)

Residual = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class ResonanceEvidence(SampledRuns, Defaults):
    """M resonances that stand out. weak: those that do not. held: of hold-out runs, recording by recording.

    without: the resonance (from 0) that takes no part in fits.
    """

    strong: tuple[Resonance, ...]
    weak: tuple[Resonance, ...]
    held: tuple[ResonanceEvidence, ...] = ()
    without: int | None = None

    terms = RESONANCE_TERMS

    def _residual_of(self, frequencies: np.ndarray, shapes: np.ndarray) -> np.ndarray:
        """Return the residuals (2 M,) of modes in ascending order: frequency and shape of each resonance."""
        out = np.full((len(self.strong), 2), UNMATCHED_RESIDUAL / CRITERIA.frequency)
        for k, (item, frequency, shape) in enumerate(zip(self.strong, frequencies, shapes, strict=False)):
            mac = abs(np.vdot(shape, item.shape)) ** 2 / float(np.vdot(shape, shape).real)
            out[k, 0] = np.log(frequency / item.frequency) / CRITERIA.frequency
            out[k, 1] = np.sqrt(max(1 - mac, 0.0)) / CRITERIA.shape
        if self.without is not None:
            out[self.without] = 0.0
        return out.ravel()

    def _fit(self, document: Mapping[str, Any], starts: Starts, effort: Effort) -> Fit:
        free, residual = self._problem(document)
        low, high = _bounds(free)
        theta = _best_start(free, starts, residual)
        if len(free) and (effort.most is None or effort.most > 1):
            scale = np.maximum(np.abs(theta), 1e-12)
            solution = least_squares(
                lambda q: residual(q * scale),
                theta / scale,
                bounds=(low / scale, high / scale),
                x_scale="jac",
                diff_step=DIFFERENCE_STEP,
                max_nfev=MOST_SOLUTIONS if effort.most is None else effort.most,
            )
            theta = solution.x * scale
        r, J = residual(theta), _jacobian(residual, theta, low, high)
        near = AT_BOUND * np.maximum(np.abs(theta), [item.scale for item in free])  # by itself nothing is near to zero
        norm = np.linalg.norm(J, axis=0)
        norm = np.where(norm > 0, norm, 1.0)
        misfit = float(r @ r)
        return Fit(
            document=document,
            free=tuple(free),
            theta=theta,
            covariance=np.linalg.pinv((J / norm).T @ (J / norm), rcond=1e-12, hermitian=True) / np.outer(norm, norm),
            at_bound=(theta <= low + near) | (theta >= high - near),
            misfit=misfit,
            rows=len(r),
            run_misfit=(r.reshape(-1, 2) ** 2).sum(axis=1),
            left_out=left_out(r, J, [2] * len(self.strong)),
            goodness=float(chi2.sf(misfit, max(len(r) - len(free), 1))),
        )

    def _modes(self, document: Mapping[str, Any]) -> Modes:
        return Modes(self.load(document), self.channels, self.runs[0].settings)

    def _problem(self, document: Mapping[str, Any]) -> tuple[Sequence[Free], Residual]:
        """Return the free parameters of a diagram and the residual as a function of them. Raises RotorsimError."""
        modes = self._modes(document)
        return modes.free, lambda theta: self._residual_of(*modes.at(theta))

    def promise(self, document: Mapping[str, Any], starts: Starts) -> float:
        """Return the misfit that one step of all parameters from the best start promises."""
        try:
            free, residual = self._problem(document)
            theta = _best_start(free, starts[:1], residual)
            r, J = residual(theta), _jacobian(residual, theta, *_bounds(free))
            left = r - J @ np.linalg.lstsq(J, r, rcond=1e-9)[0] if J.size else r
        except FAILURES:
            return np.inf
        return float(left @ left)

    def frequencies(self, fit: Fit) -> np.ndarray:
        """Return the frequencies [Hz] of the modes of a fit that are compared with the M resonances."""
        return self._modes(fit.document).at(fit.theta)[0][: len(self.strong)]

    def errors(self, fit: Fit) -> np.ndarray:
        """Return the relative errors f / f_measured - 1 of the M frequencies of a fit; NaN where modes are missing."""
        measured = np.array([item.frequency for item in self.strong])
        try:
            modes = self.frequencies(fit)
        except FAILURES:
            modes = measured[:0]
        return modes / measured - 1 if len(modes) == len(measured) else np.full(len(measured), np.nan)

    def score(self, fit: Fit) -> Score:
        """Return the root mean square error of frequencies of hold-out runs, or of resonances left out one by one.

        The diagram is refitted to the others each time. The floor is the spread of a resonance over the channels.
        """
        errors = [part.errors(fit) for part in self.held]
        for k in range(len(self.strong) if not self.held else 0):
            refitted = replace(self, without=k).fit(values_in(fit.document, fit.values), [])
            errors.append(self.errors(refitted)[k : k + 1])
        floor = [item.spread / item.frequency for part in self.held or (self,) for item in part.strong]
        return Score({"frequencies": _rms(np.concatenate(errors))}, {"frequencies": _rms(np.array(floor))})

    @property
    def missing(self) -> list[Resonance]:
        """The resonances of some size that no mode stands for."""
        return [item for item in self.weak if item.level >= CRITERIA.resonance_level]

    def open_questions(self) -> str:
        """Return what would show where a resonance that no mode stands for comes from."""
        if not self.missing:
            return ""
        where = ", ".join(f"{item.frequency:.1f} Hz" for item in self.missing)
        wanted = f"sensors along the second axis, and a sweep through the other bearing, about {where}, which is open: "
        return f"{wanted}a mode of the other plane, or of a part that is not in the diagram, moves there"

    def remarks(self, before: Fit, after: Fit, inserted: Sequence[str]) -> list[str]:
        """Return the frequencies measured, of the diagram and of the repaired one, what is open, where it is driven."""
        text = f"Resonances: {', '.join(f'{item.frequency:.1f}' for item in self.strong)} Hz measured"
        for when, fit in (("before", before), *((("after", after),) if after is not before else ())):
            text += f"; {', '.join(f'{value:.1f}' for value in self.frequencies(fit))} Hz {when}"
            errors = self.errors(fit)
            text += f" (relative error {_rms(errors):.3g} rms)" if np.isfinite(errors).all() else ""
        parts = [f"{text}."]
        for item in self.missing:
            near = min((other.frequency for other in self.strong), key=lambda value: abs(value - item.frequency))
            parts.append(f"Open: {item.frequency:.1f} Hz, beside {near:.1f} Hz; the diagram has no mode for it.")
        weak = [f"{item.frequency:.0f}" for item in self.weak if item.level < CRITERIA.resonance_level]
        parts += [f"Not compared: weak peaks at {', '.join(weak)} Hz."] if weak else []
        return [*parts, *driven_at(self, self.strong, values_in(after.document, after.values))]


def _bounds(free: Sequence[Free]) -> np.ndarray:
    """Return lower and upper bounds of free parameters, (2, m)."""
    return np.array([[item.low for item in free], [item.high for item in free]])


def _best_start(free: Sequence[Free], starts: Starts, residual: Residual) -> np.ndarray:
    """Return the free parameters of the start of least misfit, within the bounds; as written where there is none."""
    written = {item.name: item.value for item in free}
    every = [start for group in starts for start in group] or [{}]
    trials = [np.clip([{**written, **start}[item.name] for item in free], *_bounds(free)) for start in every]
    return min(trials, key=lambda theta: float(np.sum(residual(theta) ** 2)))


def _jacobian(residual: Residual, theta: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return d residual / d theta by central differences within the bounds."""
    steps = DIFFERENCE_STEP * np.diag(np.maximum(np.abs(theta), 1e-9))
    above, below = np.clip(theta + steps, low, high), np.clip(theta - steps, low, high)
    width = np.maximum(np.diag(above - below), 1e-300)
    changes = [residual(after) - residual(before) for after, before in zip(above, below, strict=True)]
    return np.stack(changes, axis=1) / width if changes else np.zeros((len(residual(theta)), 0))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
