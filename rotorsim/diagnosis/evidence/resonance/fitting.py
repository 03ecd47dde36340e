"""Recorded resonances, to which a diagram with modes far above the sample rate is fitted: by frequency and shape.

What a run shows of a linear diagram at rest is its modes. Each resonance that stands out is compared with one mode, in
ascending order: ln(f / f_measured) / FREQUENCY and sqrt(1 - MAC) / SHAPE are independent with variance 1 for a model as
good as models of rotors from drawings are. MAC: of the mode's shape at the sensors with the measured one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import process_time
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg
from scipy.optimize import least_squares
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.harmonic import Fit, left_out
from rotorsim.diagnosis.evidence.resonance.resonances import Resonance, resonances
from rotorsim.diagnosis.evidence.scoring import Score
from rotorsim.diagnosis.evidence.waveform.data import Channels, OfRuns, TimeRun, channels_of, read_run
from rotorsim.diagnosis.evidence.waveform.equations import measured_expression
from rotorsim.diagnosis.evidence.waveform.search import MOST_STEPS, STABLE
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear import linearisation as linear
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.recordings.recording import Recording, Run
from rotorsim.settled.equations import slots_of

__all__ = ["ModalSource", "Modes", "is_by_resonances", "modal_errors", "modal_score", "open_modal_source"]

FREQUENCY = 0.03  # relative: what a beam model from drawings is good for
SHAPE = 0.3  # sqrt(1 - MAC): a MAC of 0.91
WORK = 1e9  # steps of all runs times derivatives of states: seconds for one evaluation of hundreds
FAR = 3.0  # residual of a resonance that no mode is left for
LOWEST = 1e-3  # Hz: below is no mode but a drift
MOST_EVALUATIONS = 40
STEP = 1e-4  # of a parameter, for differences
AT_BOUND = 1e-6  # of a parameter or its usual size: how near the search comes to a bound that holds it
SEEN = 1e-9  # of the largest shape at the sensors


class Modes:
    """The modes of a linear diagram at rest, as its recorded channels see them."""

    def __init__(self, diagram: Diagram, channels: Channels, free: Sequence[Free]) -> None:
        self.model: Model = compile_diagram(diagram)
        linear.refuse_sampled(self.model, "a comparison of modes")
        self.slots = [slots_of(self.model, item) for item in free]
        trace = self.model.trace
        self._A = linear.jacobians(self.model)["A"]
        y = ca.vertcat(*[measured_expression(self.model, name) for name in channels.outputs])
        closed = ca.substitute(ca.jacobian(y, trace.x), trace.v, ca.SX.zeros(*trace.v.shape))
        self._C = MatrixFunction([trace.t, trace.x, trace.z, trace.p], closed)

    def parameters(self, theta: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return p with the free parameters in it."""
        out = p.copy()
        for value, slots in zip(theta, self.slots, strict=True):
            out[slots] = value
        return out

    def at(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies (k,) [Hz], ascending, and shapes over the channels (k, c) of the modes that they see."""
        x, z = np.zeros(self.model.n_x), self.model.z0(p)
        A, C = (f(np.zeros((1, 1)), x, z, p)[0] for f in (self._A, self._C))
        if not (np.isfinite(A).all() and np.isfinite(C).all()):
            raise np.linalg.LinAlgError("the linearised diagram is not finite at rest")
        _, group = connected_components(A != 0, directed=False)
        seen = np.isin(group, np.unique(group[np.abs(C).sum(axis=0) > 0]))
        values, vectors = scipy.linalg.eig(A[np.ix_(seen, seen)])
        shapes = (C[:, seen] @ vectors).T
        frequencies = np.abs(values) / (2 * np.pi)
        sizes = np.abs(shapes).max(axis=1) / np.maximum(np.abs(values), 1e-300)
        kept = (values.imag > 0) & (frequencies > LOWEST) & (sizes > SEEN * sizes.max(initial=0.0))
        order = np.argsort(frequencies[kept])
        return frequencies[kept][order], shapes[kept][order]


@dataclass(frozen=True, eq=False)
class ModalSource(OfRuns):
    """What a diagram is fitted to, in the place of `rotorsim.diagnosis.evidence.harmonic.Source`: M resonances.

    open: resonances that do not stand out. sizes: flat name -> largest magnitude of a recorded signal. without: the
    resonance (from 0) that takes no part in fits.
    """

    recording: Recording
    runs: tuple[TimeRun, ...]
    channels: Channels
    found: tuple[Resonance, ...]
    open: tuple[Resonance, ...]
    sizes: Mapping[str, float] = field(default_factory=dict)
    folder: str | None = None
    trust_blocks: bool = False
    without: int | None = None

    def largest(self) -> dict[str, float]:
        """Return the largest magnitude of every recorded signal, by its flat name."""
        return dict(self.sizes)

    def residual_of(self, frequencies: np.ndarray, shapes: np.ndarray) -> np.ndarray:
        """Return the residuals (2 M,) of modes in ascending order: frequency and shape of each resonance."""
        out = np.full(2 * len(self.found), FAR / FREQUENCY)
        for k, item in enumerate(self.found[: len(frequencies)]):
            overlap = abs(np.vdot(shapes[k], item.shape)) ** 2
            mac = overlap / float(np.vdot(shapes[k], shapes[k]).real)
            out[2 * k] = np.log(frequencies[k] / item.frequency) / FREQUENCY
            out[2 * k + 1] = np.sqrt(max(1 - mac, 0.0)) / SHAPE
        if self.without is not None:
            out[2 * self.without : 2 * self.without + 2] = 0.0
        return out

    def fit(
        self,
        document: Mapping[str, Any],
        starts: Sequence[Sequence[Mapping[str, float]]],
        *,
        most: int | None = None,
        linear_only: bool = False,
    ) -> Fit:
        """Return the best fit of a diagram from the best of all starts {free parameter: SI value}."""
        began = process_time()
        try:
            found = self._fit(document, starts, MOST_EVALUATIONS if most is None else most)
        except (RotorsimError, np.linalg.LinAlgError) as error:
            what = error.problems[0].what if isinstance(error, RotorsimError) else str(error)
            return Fit(document, failure=what, seconds=process_time() - began)
        return replace(found, seconds=process_time() - began)

    def _fit(self, document: Mapping[str, Any], starts: Sequence[Sequence[Mapping[str, float]]], most: int) -> Fit:
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
        J = _slopes(residual, theta, low, high)
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

    def _problem(self, document: Mapping[str, Any]) -> tuple[Modes, list[Free], Any]:
        diagram = self.load(document)
        modes = Modes(diagram, self.channels, diagram.free)
        p0 = modes.model.parameter_vector(self.runs[0].settings)

        def residual(theta: np.ndarray) -> np.ndarray:
            return self.residual_of(*modes.at(modes.parameters(theta, p0)))

        return modes, list(diagram.free), residual

    def _first(
        self, free: Sequence[Free], starts: Sequence[Sequence[Mapping[str, float]]], residual: Any
    ) -> np.ndarray:
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

    def promise(self, document: Mapping[str, Any], starts: Sequence[Sequence[Mapping[str, float]]]) -> float:
        """Return the misfit that one step of all parameters from the best start promises."""
        try:
            _, free, residual = self._problem(document)
            theta = self._first(free, starts[:1], residual)
            r = residual(theta)
            J = _slopes(residual, theta, np.array([f.low for f in free]), np.array([f.high for f in free]))
            left = r - J @ np.linalg.lstsq(J, r, rcond=1e-9)[0] if J.size else r
        except (RotorsimError, np.linalg.LinAlgError):
            return np.inf
        return float(left @ left)

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return the residuals of a diagram as it is, None where it has none."""
        try:
            _, free, residual = self._problem(document)
            return np.asarray(residual(np.array([item.value for item in free])))
        except (RotorsimError, np.linalg.LinAlgError):
            return None

    def frequencies(self, fit: Fit) -> np.ndarray:
        """Return the frequencies [Hz] of the modes of a fit that are compared with the M resonances."""
        modes, _, _ = self._problem(fit.document)
        p = modes.parameters(fit.theta, modes.model.parameter_vector(self.runs[0].settings))
        return modes.at(p)[0][: len(self.found)]


def _slopes(residual: Any, theta: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
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


def is_by_resonances(diagram: Diagram, recording: Recording) -> bool:
    """Return whether a diagram is compared by its resonances: no simulation follows its modes, or not in time.

    The fastest mode sets the steps between samples; each moves the states and their derivatives.
    """
    runs = [run for run in recording.runs if len(run.time) > 1]
    model = compile_diagram(diagram)
    if not runs or model.n_z or not model.n_x:
        return False
    A = linear.jacobians(model)["A"](np.zeros((1, 1)), model.x0(), model.z0(), model.p0)[0]
    if not np.isfinite(A).all():
        return False
    rates = np.linalg.eigvals(A)
    if not (np.abs(rates.imag) > np.abs(rates.real)).any():  # it has no resonance
        return False
    fastest = float(np.abs(rates).max())
    steps = [max(fastest * float(run.time[-1] - run.time[0]) / STABLE, len(run.time)) for run in runs]
    period = max(float(run.time[-1] - run.time[0]) / (len(run.time) - 1) for run in runs)
    return fastest * period > STABLE * MOST_STEPS or sum(steps) * model.n_x**2 > WORK


def open_modal_source(
    diagram: Diagram, recording: Recording, *, chosen: Sequence[Run] | None = None, trust_blocks: bool = False
) -> ModalSource:
    """Return the resonances of some runs (those to identify from). Raises RotorsimError with all that does not fit."""
    channels = channels_of(diagram, recording)
    chosen = recording.select("identify") if chosen is None else chosen
    if not chosen:
        hint = '"use": "identify" marks the runs that parameters are taken from'
        raise RotorsimError(Problem("no run to identify from", recording.name, hint=hint))
    runs = tuple(read_run(diagram, run, channels) for run in chosen)
    found = resonances(runs, channels.outputs, channels.inputs)
    strong = tuple(item for item in found if item.strong)
    if not strong:
        hint = "its modes are too fast to be simulated at this sample rate; what is compared are resonances"
        raise RotorsimError(Problem("no resonance stands out in the recording", recording.name, hint=hint))
    sizes = {name: float(np.abs(values).max()) for run in runs for name, values in run.values.items()}
    left = tuple(item for item in found if not item.strong)
    folder = str(Path(diagram.file).parent) if diagram.file else None
    return ModalSource(recording, runs, channels, strong, left, sizes, folder, trust_blocks)


def modal_errors(source: ModalSource, fit: Fit) -> np.ndarray | None:
    """Return the relative errors f / f_measured - 1 of the M frequencies of a fit, None where it has no such modes."""
    measured = np.array([item.frequency for item in source.found])
    try:
        found = source.frequencies(fit)
    except (RotorsimError, np.linalg.LinAlgError):
        return None
    return found / measured - 1 if len(found) == len(measured) else None


def modal_score(source: ModalSource, fit: Fit, held: Sequence[ModalSource] = ()) -> Score:
    """Return the root mean square error of frequencies of held-out runs, or of resonances left out one by one.

    The diagram is refitted to the others each time. The floor is the spread of a resonance over the channels.
    """
    errors: list[np.ndarray | None] = []
    for part in held:
        errors.append(modal_errors(part, fit))
    for k in range(len(source.found) if not held else 0):
        document = values_in(fit.document, fit.values)
        found = modal_errors(source, replace(source, without=k).fit(document, []))
        errors.append(None if found is None else found[k : k + 1])
    floor = np.concatenate([[item.spread / item.frequency for item in part.found] for part in held or (source,)])
    known = [item for item in errors if item is not None]
    size = _rms(np.concatenate(known)) if len(known) == len(errors) else float("nan")
    return Score({"frequencies": size}, {"frequencies": _rms(floor)})


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
