"""Evidence of a machine at rest: recorded resonances, by frequency and shape, compared with the modes of a diagram.

For diagrams with modes far above the sample rate, which no simulation follows in time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Defaults, Score, Terms
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit, Starts, left_out, reason_of
from rotorsim.diagnosis.evidence.resonance.drive import driven_at
from rotorsim.diagnosis.evidence.resonance.modes import Modes
from rotorsim.diagnosis.evidence.resonance.resonances import Resonance
from rotorsim.diagnosis.evidence.waveform.data import SampledRuns
from rotorsim.diagram.diagram import Free

__all__ = ["ResonanceEvidence"]

FAR = 3.0  # residual of a resonance that no mode is left for
MOST_EVALUATIONS = 40
STEP = 1e-4  # of a parameter, for differences
AT_BOUND = 1e-6  # of a parameter or its usual size: how near the search comes to a bound that holds it
TERMS = Terms(
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
    """M resonances. open: resonances that do not stand out. held: of hold-out runs, recording by recording.

    without: the resonance (from 0) that takes no part in fits.
    """

    found: tuple[Resonance, ...]
    open: tuple[Resonance, ...]
    held: tuple[ResonanceEvidence, ...] = ()
    without: int | None = None

    terms = TERMS

    def _residual_of(self, frequencies: np.ndarray, shapes: np.ndarray) -> np.ndarray:
        """Return the residuals (2 M,) of modes in ascending order: frequency and shape of each resonance."""
        out = np.full(2 * len(self.found), FAR / CRITERIA.frequency)
        for k, item in enumerate(self.found[: len(frequencies)]):
            overlap = abs(np.vdot(shapes[k], item.shape)) ** 2
            mac = overlap / float(np.vdot(shapes[k], shapes[k]).real)
            out[2 * k] = np.log(frequencies[k] / item.frequency) / CRITERIA.frequency
            out[2 * k + 1] = np.sqrt(max(1 - mac, 0.0)) / CRITERIA.shape
        if self.without is not None:
            out[2 * self.without : 2 * self.without + 2] = 0.0
        return out

    def fit(
        self, document: Mapping[str, Any], starts: Starts, *, most: int | None = None, linear_only: bool = False
    ) -> Fit:
        """Return the best fit of a diagram from the best of all starts {free parameter: SI value}."""
        began = process_time()
        try:
            found = self._fit(document, starts, MOST_EVALUATIONS if most is None else most)
        except FAILURES as error:
            return Fit(document, failure=reason_of(error), seconds=process_time() - began)
        return replace(found, seconds=process_time() - began)

    def _fit(self, document: Mapping[str, Any], starts: Starts, most: int) -> Fit:
        _, free, residual = self._problem(document)
        low, high = np.array([item.low for item in free]), np.array([item.high for item in free])
        theta = self._first(free, starts, residual)
        if len(free) and most > 1:
            scale = np.maximum(np.abs(theta), 1e-12)
            ends = least_squares(
                lambda q: residual(q * scale),
                theta / scale,
                bounds=(low / scale, high / scale),
                x_scale="jac",
                diff_step=STEP,
                max_nfev=most,
            )
            theta = ends.x * scale
        r = residual(theta)
        J = _jacobian(residual, theta, low, high)
        near = AT_BOUND * np.maximum(np.abs(theta), [item.scale for item in free])  # by itself nothing is near to zero
        at_bound = (theta <= low + near) | (theta >= high - near)
        count = len(r)
        misfit = float(r @ r)
        norm = np.linalg.norm(J, axis=0)
        norm = np.where(norm > 0, norm, 1.0)
        inverse = np.linalg.pinv((J / norm).T @ (J / norm), rcond=1e-12, hermitian=True) / np.outer(norm, norm)
        goodness = float(chi2.sf(misfit, max(count - len(free), 1)))
        energies = (r.reshape(-1, 2) ** 2).sum(axis=1)
        sizes = [2] * len(self.found)
        return Fit(
            document=document,
            free=tuple(free),
            theta=theta,
            covariance=inverse,
            at_bound=at_bound,
            misfit=misfit,
            rows=count,
            run_misfit=energies,
            left_out=left_out(r, J, sizes),
            goodness=goodness,
        )

    def _problem(self, document: Mapping[str, Any]) -> tuple[Modes, list[Free], Residual]:
        diagram = self.load(document)
        modes = Modes(diagram, self.channels, diagram.free)
        p0 = modes.model.parameter_vector(self.runs[0].settings)

        def residual(theta: np.ndarray) -> np.ndarray:
            return self._residual_of(*modes.at(modes.parameters(theta, p0)))

        return modes, list(diagram.free), residual

    def _first(self, free: Sequence[Free], starts: Starts, residual: Residual) -> np.ndarray:
        names = [item.name for item in free]
        trials = []
        for start in [start for group in starts for start in group] or [{}]:
            theta = np.array([item.value for item in free])
            for name, value in start.items():
                if name in names:
                    item = free[names.index(name)]
                    theta[names.index(name)] = np.clip(value, item.low, item.high)
            r = residual(theta)
            trials.append((float(r @ r), theta))
        return min(trials, key=lambda pair: pair[0])[1]

    def promise(self, document: Mapping[str, Any], starts: Starts) -> float:
        """Return the misfit that one step of all parameters from the best start promises."""
        try:
            _, free, residual = self._problem(document)
            theta = self._first(free, starts[:1], residual)
            r = residual(theta)
            J = _jacobian(residual, theta, np.array([f.low for f in free]), np.array([f.high for f in free]))
            left = r - J @ np.linalg.lstsq(J, r, rcond=1e-9)[0] if J.size else r
        except FAILURES:
            return np.inf
        return float(left @ left)

    def frequencies(self, fit: Fit) -> np.ndarray:
        """Return the frequencies [Hz] of the modes of a fit that are compared with the M resonances."""
        modes, _, _ = self._problem(fit.document)
        p = modes.parameters(fit.theta, modes.model.parameter_vector(self.runs[0].settings))
        return modes.at(p)[0][: len(self.found)]

    def errors(self, fit: Fit) -> np.ndarray | None:
        """Return the relative errors f / f_measured - 1 of the M frequencies of a fit, None where modes are missing."""
        measured = np.array([item.frequency for item in self.found])
        try:
            modes = self.frequencies(fit)
        except FAILURES:
            return None
        return modes / measured - 1 if len(modes) == len(measured) else None

    def score(self, fit: Fit) -> Score:
        """Return the root mean square error of frequencies of hold-out runs, or of resonances left out one by one.

        The diagram is refitted to the others each time. The floor is the spread of a resonance over the channels.
        """
        errors = [part.errors(fit) for part in self.held]
        for k in range(len(self.found) if not self.held else 0):
            document = values_in(fit.document, fit.values)
            every = self.errors(replace(self, without=k).fit(document, []))
            errors.append(None if every is None else every[k : k + 1])
        floor = np.concatenate([[item.spread / item.frequency for item in part.found] for part in self.held or (self,)])
        known = [item for item in errors if item is not None]
        size = _rms(np.concatenate(known)) if len(known) == len(errors) else float("nan")
        return Score({"frequencies": size}, {"frequencies": _rms(floor)})

    @property
    def missing(self) -> list[Resonance]:
        """The resonances of some size that no mode stands for."""
        return [item for item in self.open if item.level >= CRITERIA.resonance_level]

    def open_questions(self) -> str:
        """Return what would show where a resonance that no mode stands for comes from."""
        if not self.missing:
            return ""
        where = ", ".join(f"{item.frequency:.1f} Hz" for item in self.missing)
        wanted = f"sensors along the second axis, and a sweep through the other bearing, about {where}, which is open: "
        return f"{wanted}a mode of the other plane, or of a part that is not in the diagram, moves there"

    def remarks(self, before: Fit, after: Fit, inserted: Sequence[str]) -> list[str]:
        """Return the frequencies measured, of the diagram and of the repaired one, what is open, where it is driven."""
        text = f"Resonances: {', '.join(f'{item.frequency:.1f}' for item in self.found)} Hz measured"
        for when, fit in (("before", before), *((("after", after),) if after is not before else ())):
            text += f"; {', '.join(f'{value:.1f}' for value in self.frequencies(fit))} Hz {when}"
            errors = self.errors(fit)
            text += "" if errors is None else f" (relative error {_rms(errors):.3g} rms)"
        parts = [f"{text}."]
        for item in self.missing:
            near = min((other.frequency for other in self.found), key=lambda value: abs(value - item.frequency))
            parts.append(f"Open: {item.frequency:.1f} Hz, beside {near:.1f} Hz; the diagram has no mode for it.")
        weak = [f"{item.frequency:.0f}" for item in self.open if item.level < CRITERIA.resonance_level]
        parts += [f"Not compared: weak peaks at {', '.join(weak)} Hz."] if weak else []
        return [*parts, *driven_at(self, self.found, values_in(after.document, after.values))]


def _jacobian(residual: Residual, theta: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return d residual / d theta by central differences within the bounds."""
    columns = []
    for j in range(len(theta)):
        step = STEP * max(abs(theta[j]), 1e-9)
        ends = []
        for sign in (1, -1):
            moved = theta.copy()
            moved[j] = np.clip(theta[j] + sign * step, low[j], high[j])
            ends.append((moved[j], residual(moved)))
        width = ends[0][0] - ends[1][0]
        columns.append((ends[0][1] - ends[1][1]) / width if width else np.zeros_like(ends[0][1]))
    return np.stack(columns, axis=1) if columns else np.zeros((len(residual(theta)), 0))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
