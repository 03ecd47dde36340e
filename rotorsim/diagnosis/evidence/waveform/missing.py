"""The missing signal at a place, estimated from all outputs, and what the law that was found adds there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Insertion, Spot
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass, SignalRun
from rotorsim.diagnosis.evidence.waveform.dominant_line import line_beside_noise
from rotorsim.diagnosis.evidence.waveform.laws import spot_of
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.linearised import LinearisedRun, Place, linearised, simulated_signals
from rotorsim.identification.waveform.predictability import predictability
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.unknown_input import Smoothed, UnknownInputs, smoothed_motion

BINS = 20  # of equal numbers of samples, and of equal width, whose means are what a map of one signal explains
SAME_MOTION = (
    0.1  # rms difference of simulated signals of two runs, of their standard deviation: a hundredth of the power
)
EIGHTHS = 8  # of each run, as far as it has samples, whose powers are compared
AT_REST = 1e-4  # of the mean square of a simulated signal: what it has at least, a hundredth of its amplitude
OWN = 0.9  # of what the best explains: what explains as much and comes before it is drawn


@dataclass(frozen=True, eq=False)
class Linearised:
    """A fitted diagram along its runs: where signals may be added, and what they change."""

    diagram: Diagram
    search: OutputErrorSearch
    evaluation: Evaluation
    places: Sequence[Place]
    runs: list[LinearisedRun]
    noise: np.ndarray

    @property
    def sampled(self) -> Sequence[SampledRun]:
        """The runs as they were measured."""
        return self.search.runs

    def about_the_motion(self, times: int) -> Linearised:
        """Return a nonlinear diagram linearised about the motion that was measured, found in some steps."""
        here = self
        for _ in range(0 if all(run.constant for run in self.runs) else times):
            motion = smoothed_motion(here.runs, self.noise)
            if not all(np.isfinite(states).all() for states in motion):
                break
            here = replace(here, runs=linearised(self.diagram, self.search, self.evaluation, self.places, motion))
        return here

    def about(self, motion: Sequence[Mapping[str, np.ndarray]]) -> Linearised:
        """Return a diagram linearised about a motion, states (N,) by name; itself where that lacks some of them."""
        names = self.search.systems[0].equations.state_names
        if not all({*names} <= {*states} for states in motion):
            return self
        states = [np.column_stack([of_run[name] for name in names]) for of_run in motion]
        return replace(self, runs=linearised(self.diagram, self.search, self.evaluation, self.places, states))

    def unknown(self, *, known: bool = False) -> UnknownInputs:
        """Return the hypotheses of a signal at each place; known: the parameters stay as they are."""
        runs = self.runs
        if known:
            runs = [replace(run, by_output=run.by_output[:, :, :0], by_wire=run.by_wire[:, :, :0]) for run in runs]
        return UnknownInputs(runs, self.noise)


@dataclass(frozen=True, eq=False)
class _Law:
    """What a law reads, by name, and in each run what it adds (N,), and what it reads (N,)."""

    reads: str
    added: list[np.ndarray]
    read: list[np.ndarray]


def missing_signal(
    here: Linearised,
    repaired: tuple[Diagram, OutputErrorSearch, Evaluation] | None,
    effect: Insertion | None,
    spot: Spot,
    classes: Sequence[PlaceClass],
    unit_of: Callable[[str], str | None],
) -> MissingSignal | None:
    """Return the signal at a place, that of an effect if there is one; None where none shows.

    repaired: the diagram with the effect; the parameters of ``here`` are then those that were found beside it.
    """
    k = _place(here, spot)
    unknown = here.unknown(known=repaired is not None)
    estimates = [] if k is None else unknown.estimates([k])
    if k is None or not estimates:
        return None
    smoothed = _at_samples(unknown.smoothed(estimates[:1])[0], here.runs)
    law = None if effect is None or repaired is None else _law(effect, repaired)
    over, values = _explaining(here, smoothed, law)
    runs = [
        SignalRun(
            run.id,
            run.time,
            smoothed.added[r],
            smoothed.std[r],
            values[r],
            None if law is None else law.added[r],
            None if law is None else law.read[r] if over == law.reads else values[r],
        )
        for r, run in enumerate(here.sampled)
    ]
    at = spot_of(here.places[k])
    physics = "" if effect is None else effect.physics
    unit, over_unit = unit_of(here.places[k].port), unit_of(over)
    share = explained_by(np.concatenate(values), np.concatenate(smoothed.added))
    residuals = np.concatenate([run.residual / here.noise for run in here.runs])
    without, left = float(np.mean(residuals**2)), estimates[0].misfit / residuals.size
    ports = [*dict.fromkeys(place.port for place in here.places)]
    simulated = simulated_signals(here.diagram, here.search, here.evaluation, ports)
    predicted, again = _predicted(here, smoothed, simulated), _repeated(here, smoothed, simulated)
    found = MissingSignal(
        at, unit, over, over_unit, share, tuple(runs), tuple(classes), left, without, predicted, again, physics
    )
    line = line_beside_noise(smoothed.added, here.runs[0].dt)
    return replace(found, follows=power_exponent(found, simulated), line=line)


def _predicted(here: Linearised, smoothed: Smoothed, simulated: Sequence[np.ndarray]) -> float:
    """Return the share of a signal that a black box predicts of what is simulated without it, and of time."""
    beside = [np.column_stack([run.time - run.time[0], own]) for run, own in zip(here.sampled, simulated, strict=True)]
    poles = np.linalg.eigvals(here.runs[0].F.mean(axis=0))
    return predictability([added[:, None] for added in smoothed.added], beside, poles).structure


def power_exponent(signal: MissingSignal, simulated: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return the exponent by which the power of a signal follows that of what is simulated, and its standard deviation.

    By least squares of the logarithms of mean squares of `EIGHTHS` of each run, of what is simulated averaged over
    all that moves. That of a signal scatters by 2 tau / T in a stretch of T (`MissingSignal.known`), if not by more.
    """
    whole, added = np.concatenate(simulated), np.concatenate([run.added for run in signal.runs])
    mean, size = whole.mean(axis=0), whole.std(axis=0)
    moves = size > 0
    powers, own, spread = [], [], []
    for run, values in zip(signal.runs, simulated, strict=True):
        for part in np.array_split(np.arange(len(run.time)), min(EIGHTHS, len(run.time))):
            squares = np.mean(((values[part][:, moves] - mean[moves]) / size[moves]) ** 2, axis=0)
            powers.append(float(np.mean(np.log(squares + AT_REST))))
            own.append(float(np.log(np.mean((run.added[part] - added.mean()) ** 2) + AT_REST**2 * added.var())))
            spread.append(2 * signal.correlation_time / (len(part) * float(np.median(np.diff(run.time)))))
    x, y = np.array(powers) - np.mean(powers), np.array(own) - np.mean(own)
    if len(x) < 3 or not moves.any() or not x.any():
        return 0.0, np.inf
    exponent = float(x @ y / (x @ x))
    scatter = max(float(np.mean(spread)), float(np.sum((y - exponent * x) ** 2)) / (len(x) - 2))
    return exponent, float(np.sqrt(scatter / (x @ x)))


def _repeated(here: Linearised, smoothed: Smoothed, simulated: Sequence[np.ndarray]) -> float | None:
    """Return the largest correlation of a signal between two runs that are simulated alike; None without such runs."""
    found = []
    for a, b in combinations(range(len(simulated)), 2):
        one, other = simulated[a], simulated[b]
        if one.shape == other.shape and np.isclose(here.sampled[a].dt, here.sampled[b].dt):
            off, spread = np.sqrt(((one - other) ** 2).mean(axis=0)), one.std(axis=0)
            if (off <= SAME_MOTION * spread).all() and spread.any():
                found.append(float(np.corrcoef(smoothed.added[a], smoothed.added[b])[0, 1]))
    return max(found, default=None)


def _at_samples(smoothed: Smoothed, runs: Sequence[LinearisedRun]) -> Smoothed:
    """Return a signal at the samples: one that acts through states alone is held from each to the next."""
    if any(run.D[:, :, smoothed.place].any() for run in runs):
        return smoothed

    def between(values: np.ndarray) -> np.ndarray:
        return np.asarray((values + np.concatenate([values[:1], values[:-1]])) / 2)

    return replace(smoothed, added=[*map(between, smoothed.added)], std=[*map(between, smoothed.std)])


def _place(here: Linearised, spot: Spot) -> int | None:
    """Return the place of a spot: its port, or what is wired to an input."""
    wired = (wire.source for wire in here.diagram.wires if str(wire.target) == str(spot))
    at = {spot_of(place): k for k, place in enumerate(here.places)}
    return next((at[one] for one in (spot, *(Spot(end.block, end.port) for end in wired)) if one in at), None)


def _law(effect: Insertion, repaired: tuple[Diagram, OutputErrorSearch, Evaluation]) -> _Law | None:
    """Return what a law adds in the repaired diagram: in a signal its output less its input, as a force its output.

    None unless both are one number.
    """
    diagram, search, evaluation = repaired
    node = diagram.nodes.get(effect.name)
    if node is None or effect.fault.enters not in ("signal", "force"):
        return None
    wires = [wire for wire in diagram.wires if wire.target.block == effect.name]
    outputs = [port for port in node.outputs.values() if port.shape == ()]
    scalar = [wire for wire in wires if node.inputs[wire.target.port].shape == ()]
    if len(outputs) != 1 or not scalar:
        return None
    reads = str(scalar[0].source)
    signals = simulated_signals(diagram, search, evaluation, [str(outputs[0]), reads])
    through = 1.0 if effect.fault.enters == "signal" else 0.0
    return _Law(reads, [both[:, 0] - through * both[:, 1] for both in signals], [both[:, 1] for both in signals])


def _explaining(here: Linearised, smoothed: Smoothed, law: _Law | None) -> tuple[str, list[np.ndarray]]:
    """Return the signal that the missing one is drawn against: what its law reads, or else what the place carries.

    Unless a map of its rate, of another signal (one number) or its rate, or of time explains more.
    """
    added = np.concatenate(smoothed.added)
    found: dict[str, list[np.ndarray]] = {}
    for k, place in enumerate(here.places):
        found.setdefault(place.port, [wires[:, k] for wires in smoothed.wires])
    own = here.places[smoothed.place].port if law is None else law.reads
    if law is not None:
        found.setdefault(own, law.read)
    found |= {
        f"rate of {name}": [np.gradient(value, run.time) for value, run in zip(values, here.sampled, strict=True)]
        for name, values in list(found.items())
    }
    if law is not None or len(here.runs) > 1:  # any slow signal of a single run is a map of time
        found["time"] = [run.time for run in here.sampled]
    shares = {name: explained_by(np.concatenate(values), added) for name, values in found.items()}
    best = max(shares, key=lambda name: shares[name])
    chosen = next(name for name in (own, f"rate of {own}", best) if shares[name] >= OWN * shares[best])
    return chosen, found[chosen]


def explained_by(over: np.ndarray, added: np.ndarray) -> float:
    """Return the share of the variance of a signal (N,) that a map of another (N,) explains, by means of bins.

    Bins end at quantiles and at equal distances: a law may act where the signal seldom is.
    """
    inner = np.linspace(0, 1, BINS + 1)[1:-1]
    edges = np.sort(np.concatenate([np.quantile(over, inner), over.min() + np.ptp(over) * inner]))
    which, y = np.digitize(over, edges), added - added.mean()
    sums, counts = np.bincount(which, y), np.bincount(which)
    total = float(y @ y)
    return float((sums**2 / np.maximum(counts, 1)).sum()) / total if total > 0 else 0.0
