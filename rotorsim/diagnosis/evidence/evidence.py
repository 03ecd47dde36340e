"""What recordings say of a diagram: the interface by which search and conclusions meet every sort of recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Insertion, Spot
from rotorsim.diagnosis.evidence.change import Change
from rotorsim.diagnosis.evidence.fit import TO_THE_END, Effort, Fit, Starts
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass
from rotorsim.diagram.diagram import Diagram
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import Recording


@dataclass(frozen=True)
class Terms:
    """How statements name what the evidence is made of."""

    noise: str = "the noise"
    left_out: str = "runs left out one by one"
    predicted: str = "runs left out"
    signals: str = "of the signals (noise {})"
    more_runs: str = "runs at more speeds and amplitudes"
    another: str = ""  # what separates hypotheses where nothing is declared; empty: what is searched was
    searched: str = "no other speed or gain"  # separates hypotheses, where no further run was found
    driven: str = "driven so"  # how runs must be, that every signal moves by more than its noise
    turns: bool = True  # whether the experiments that faults declare are those of a turning shaft


@dataclass(frozen=True)
class Score:
    """NRMSE per port and noise floor per port (not a number where nothing is predicted).

    rms: of the error by signal, with its unit, where errors are those of samples. reason: why nothing is predicted.
    """

    ports: Mapping[str, float]
    floor: Mapping[str, float]
    rms: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    reason: str = ""

    @property
    def total(self) -> float | None:
        """NRMSE over all ports."""
        return _mean(self.ports)

    @property
    def noise(self) -> float | None:
        """Noise floor over all ports."""
        return _mean(self.floor)


@dataclass(frozen=True, kw_only=True)
class HeldScore(Score):
    """Score of hold-out runs whose expected misfit is known: chi-squared of ``rows`` equations, for a right diagram.

    misfit: None where it is not known (see reason). runs: (misfit, equations) of each run.
    """

    misfit: float | None = None
    rows: int = 0
    runs: tuple[tuple[float, float], ...] = ()


def _mean(values: Mapping[str, float]) -> float | None:
    found = np.array(list(values.values()))
    return float(np.sqrt(np.mean(found**2))) if found.size and np.isfinite(found).all() else None


@dataclass(frozen=True, eq=False)
class Unknown:
    """What is known of a force: plain data for diagnosis.json, and a description in words."""

    data: Mapping[str, Any] = field(default_factory=dict)
    words: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Promise:
    """The misfit that a fault may leave, and from where its parameters are to start, {free parameter: SI value}.

    start: empty where nothing is known of it, so that it begins as declared. without: what would be left so without it,
    where that is known. exact: whether a fit leaves that, but for
    what parameters of the diagram do not do in proportion. std: of the parameters of the fault, where they are known.
    """

    misfit: float
    start: Mapping[str, float] = field(default_factory=dict)
    without: float = np.inf
    exact: bool = False
    std: Mapping[str, float] = field(default_factory=dict)


class Promising(Protocol):
    """What promises something of faults, in a process of its own."""

    def promises(self, items: Sequence[Insertion]) -> list[Promise | None]:
        """Return the misfit that each insertion can leave, None where nothing is known of it."""


class Bounds(Promising, Protocol):
    """What can be known of the misfit beside a fault before it is put in.

    by_law: what the law itself promises by linear theory; else a lower bound of what any law at its place can leave.
    """

    @property
    def by_law(self) -> bool:
        """Whether bounds are those of laws, not of places."""

    @property
    def sure(self) -> bool:
        """Whether promises of laws are nearly what their fits leave, so that a diagram is linear."""

    @property
    def classes(self) -> Sequence[PlaceClass]:
        """The classes of places of which a free signal explains the same; none where that was not asked."""

    @property
    def deviance(self) -> float:
        """-2 log likelihood of the likeliest free signal; infinite where that was not asked, or none shows."""

    @property
    def carried(self) -> Mapping[str, float]:
        """The largest magnitude of signals as measured outputs show them, by flat name; none where nothing is known."""


class Validation(Protocol):
    """Hold-out runs, or runs left out one by one, with the misfit that noise and uncertain parameters make there."""

    @property
    def held_out(self) -> bool:
        """Whether runs are held out for good."""

    def score(self, fit: Fit) -> HeldScore:
        """Return the score of a fit on hold-out runs; without any, on runs left out one by one (refitted each time)."""

    def runs_of(self, fit: Fit) -> Sequence[tuple[float, float]] | None:
        """Return misfit and equations of each hold-out run, or of each run when it is predicted from the others."""

    def least(self, item: Insertion, without: Fit) -> list[tuple[float, float]] | None:
        """Return misfit and equations of each run with free harmonics at the place of an insertion."""

    def is_force(self, fit: Fit) -> bool:
        """Return whether free harmonics of a force at one place explain the residual of a fit."""

    def residual_place(self, base: Fit, after: Fit) -> Mapping[str, Any] | None:
        """Return where the residual of a fit acts most likely ("place"), and its size there ("size")."""


class Evidence(Protocol):
    """Recorded signals, and how well a diagram predicts them.

    A diagram is handed over as its document. Four implementations: `HarmonicEvidence` (a turning shaft),
    `WaveformEvidence` (samples in time), `ResonanceEvidence` (frequencies and shapes of modes), `OrderEvidence` (order
    vectors over the speed), chosen by `open_evidence`.
    """

    @property
    def recording(self) -> Recording | OrderRecording:
        """The recording that it was made from."""

    @property
    def terms(self) -> Terms:
        """How statements name it."""

    @property
    def recorded(self) -> Sequence[str]:
        """The flat names of the recorded signals."""

    @property
    def alike(self) -> bool:
        """Whether all runs have one speed and the same settings, which almost anything explains."""

    @property
    def costly(self) -> bool:
        """Whether fits take so long that only laws that promise most are fitted."""

    @property
    def weighed_by(self) -> Mapping[Any, float]:
        """The variance of the noise of each signal, by which promises of laws weigh them; empty where it is known."""

    @property
    def unjudged(self) -> str:
        """Why structure of the residual would not show, so that nothing is `consistent`; empty: it would."""

    @property
    def independent(self) -> bool:
        """Whether the equations are independent, so that the probability of a misfit has its usual meaning."""

    @property
    def line(self) -> tuple[float, float] | None:
        """The asynchronous frequency and its standard deviation [rad/s], where there is one."""

    @property
    def validation(self) -> Validation | None:
        """Hold-out runs with their expected misfit; None where only their errors are known."""

    def load(self, document: Mapping[str, Any]) -> Diagram:
        """Return the diagram of a document as it is compared with the recording. Raises RotorsimError."""

    def largest(self) -> Mapping[str, float]:
        """Return the largest magnitude of every recorded signal by flat name, for starts and bounds."""

    def fit(self, document: Mapping[str, Any], starts: Starts, effort: Effort = TO_THE_END) -> Fit:
        """Return the best fit of a diagram from groups of starts; what a start does not name begins as written."""

    def promise(self, document: Mapping[str, Any], starts: Starts) -> float:
        """Return the misfit that a few steps from the best start promise."""

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return the whitened residual of a diagram as it is, None where it has none."""

    def score(self, fit: Fit) -> Score:
        """Return the score of a fit on hold-out runs, or on parts of the recording left out one by one."""

    def refines_meshes(self, document: Mapping[str, Any]) -> bool:
        """Return whether errors of a mesh in the diagram may show in the residual."""

    def bounds(self, fit: Fit, better: Fit | None = None) -> Bounds | None:
        """Return lower bounds of the misfit beside a fit, None where there are none (it is not linear).

        better: a fit with more, whose parameters of the diagram are right; of laws they are promises then.
        """

    def laws(self, fit: Fit) -> Promising | None:
        """Return what laws beside a fit leave by linear theory, None where bounds say that, or nothing does."""

    def structure(self, fit: Fit) -> float:
        """Return the share of the residual of a fit that is predictable, and no noise, 0 where it is not asked."""

    def unexplained(self, fit: Fit) -> float:
        """Return the share of what effects leave that is predictable, 0 where it is not asked of details of a law."""

    def recalibrated(self, fit: Fit) -> Evidence | None:
        """Return the evidence with noise estimated from a fit that leaves less than it assumed; None if it does not."""

    def at(self, fit: Fit) -> Fit:
        """Return a fit to other evidence (other noise, or drift) as this one judges it, at the same parameters."""

    def finished(self, fit: Fit, chosen: Sequence[Insertion]) -> Fit:
        """Return a fit with what the chosen faults state once free as well, where that explains more."""

    def sharpened(self, fit: Fit, chosen: Sequence[Insertion]) -> tuple[Evidence, Fit]:
        """Return a fit with finer approximations of laws that follow the rate of samples, and the evidence for it."""

    def widened(self, fit: Fit) -> Fit:
        """Return a fit with what its covariance holds of nuisances that a whole run shares, as an open shaft angle."""

    def with_drift(self, variance: float = 1.0) -> Evidence | None:
        """Return the evidence with how 1X drifts within the runs, None where that is not asked.

        variance: of that drift, as a multiple of what noise makes.
        """

    def separation(self, first: Fit, second: Fit) -> Change | None:
        """Return the further run that separates two hypotheses most; None if none does, or none was searched."""

    def unknown_force(self, document: Mapping[str, Any], spot: Spot) -> Unknown:
        """Return orders, laws and lines of the force at a place that explains the residual best."""

    def missing_signal(
        self, without: Fit, after: Fit, effect: Insertion | None, spot: Spot, classes: Sequence[PlaceClass]
    ) -> MissingSignal | None:
        """Return the free signal at a place that explains what a fit leaves; None where none shows, or none is sought.

        effect: that acts there, which the fit is without. after: the fit with all effects. classes: of places of free
        signals, the likeliest first.
        """

    def remarks(self, before: Fit, after: Fit, inserted: Sequence[str]) -> list[str]:
        """Return sentences about this sort of recording; inserted: names of the blocks that a repair puts in."""

    def open_questions(self) -> str:
        """Return what would have to be measured for what remains open whatever the diagram is; empty: nothing."""


class Defaults:
    """What evidence answers that has nothing of its own to say."""

    independent = True
    costly = False

    @property
    def weighed_by(self) -> Mapping[Any, float]:
        """Nothing: it is known, and stays."""
        return {}

    @property
    def unjudged(self) -> str:
        """Nothing: structure of the residual would show."""
        return ""

    @property
    def terms(self) -> Terms:
        """Those of a turning shaft."""
        return Terms()

    @property
    def alike(self) -> bool:
        """False: runs are not compared by their speeds."""
        return False

    @property
    def line(self) -> tuple[float, float] | None:
        """None: no asynchronous line is separated."""
        return None

    @property
    def validation(self) -> Validation | None:
        """None: only the errors of hold-out runs are known."""
        return None

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return None: meshes are taken as they are."""
        return None

    def refines_meshes(self, document: Mapping[str, Any]) -> bool:
        """Return False: errors of meshes are below those of the evidence."""
        return False

    def bounds(self, fit: Fit, better: Fit | None = None) -> Bounds | None:
        """Return None: nothing is known of places but by trying them."""
        return None

    def laws(self, fit: Fit) -> Promising | None:
        """Return None: nothing is known of laws but what bounds say."""
        return None

    def structure(self, fit: Fit) -> float:
        """Return 0: the noise was measured, and the misfit says all."""
        return 0.0

    def unexplained(self, fit: Fit) -> float:
        """Return 0: the noise was measured, and the misfit says all."""
        return 0.0

    def recalibrated(self, fit: Fit) -> Evidence | None:
        """Return None: the noise was measured, whatever a diagram leaves."""
        return None

    def at(self, fit: Fit) -> Fit:
        """Return the fit: there was no recalibration."""
        return fit

    def finished(self, fit: Fit, chosen: Sequence[Insertion]) -> Fit:
        """Return the fit: what a fault states once stays."""
        return fit

    def sharpened(self, fit: Fit, chosen: Sequence[Insertion]) -> tuple[Self, Fit]:
        """Return the fit: no law follows the rate of samples."""
        return self, fit

    def widened(self, fit: Fit) -> Fit:
        """Return the fit: its covariance holds all."""
        return fit

    def with_drift(self, variance: float = 1.0) -> Evidence | None:
        """Return None: samples in time hold it, orders do not."""
        return None

    def separation(self, first: Fit, second: Fit) -> Change | None:
        """Return None: no further runs were searched."""
        return None

    def unknown_force(self, document: Mapping[str, Any], spot: Spot) -> Unknown:
        """Return nothing: a force is described by its map only."""
        return Unknown()

    def missing_signal(
        self, without: Fit, after: Fit, effect: Insertion | None, spot: Spot, classes: Sequence[PlaceClass]
    ) -> MissingSignal | None:
        """Return None: signals are not estimated in time."""
        return None

    def remarks(self, before: Fit, after: Fit, inserted: Sequence[str]) -> list[str]:
        """Return nothing: the statement says all."""
        return []

    def open_questions(self) -> str:
        """Return nothing: what remains open is in the statement."""
        return ""
