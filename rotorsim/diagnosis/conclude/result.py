"""The result of a diagnosis: effects with their equivalence classes and places, fits, scores, verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from typing import Any

from rotorsim._shown import Shown
from rotorsim.criteria import Z90
from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.conclude.shares import Explained
from rotorsim.diagnosis.conclude.unknown_force import UnknownForce
from rotorsim.diagnosis.conclude.validation import Proof
from rotorsim.diagnosis.evidence.evidence import Evidence, Score
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass, spots_of
from rotorsim.diagnosis.evidence.opened import Converter
from rotorsim.diagnosis.search.candidates import Candidate
from rotorsim.diagnosis.search.selection import Selection
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import Recording

VERDICTS = ("consistent", "missing_physics", "outside_catalogue", "not_identifiable")


@dataclass(frozen=True, eq=False)
class Effect:
    """One missing effect: the chosen candidate, its equivalence class with probabilities, classes of places.

    rivals: of the other members of the class the best candidate each.
    """

    candidate: Candidate
    members: Mapping[str, float]
    rivals: Mapping[str, Candidate]
    places: tuple[PlaceClass, ...]

    @property
    def physics(self) -> str:
        """The name of the physics."""
        return self.candidate.insertion.physics

    @property
    def spots(self) -> tuple[Spot, ...]:
        """Where it may act, the likeliest first."""
        return spots_of(self.places)

    def spot_of(self, physics: str) -> Spot | None:
        """Return where a member of the class acts, as it explains the data best; None where it is not known."""
        item = self.candidate if physics == self.physics else self.rivals.get(physics)
        return None if item is None else item.insertion.spot

    def at(self, physics: str) -> str:
        """Return in words where a member of the class acts: its place, with all that no data tell from it."""
        spot = self.spot_of(physics)
        if spot is None:
            return ""
        return next((one.words for one in self.places if spot in one.places), spot.words)

    def depends_on(self, physics: str) -> str:
        """Return the signal, beside that of its place, which a member of the class depends on; empty where on none."""
        item = self.candidate if physics == self.physics else self.rivals.get(physics)
        return "" if item is None else item.insertion.depends_on


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Diagnosis(Shown):
    """The answer to why a diagram and a recording differ; see `diagnose`.

    effects: what is missing (or, outside the catalogue, what was nearest). before, after: fits of the diagram as
    given and repaired; document: the repaired one; scores of both. places, rejected (physics, why), open: (physics, how
    far it came), where a fit was not carried to the end. detectable: physics -> smallest size that would have been
    seen, where nothing was found. proof: what hold-out runs say; explained: by effect; residual: beyond noise.
    signals: what is missing, as signals in time: of each effect, or of what is outside the catalogue.
    unpredicted: whether nothing predicts the first of them. unknown: a force outside the catalogue. converters: whose
    quantisation steps the readings show; given: the evidence without them. recordings: as they were given,
    held-out ones last.
    """

    verdict: str
    effects: tuple[Effect, ...]
    before: Fit
    after: Fit
    document: Mapping[str, Any]
    score_before: Score
    score_after: Score
    selection: Selection
    evidence: Evidence
    given: Evidence
    recordings: tuple[Recording | OrderRecording, ...]
    held_out: bool
    places: tuple[PlaceClass, ...] = ()
    rejected: tuple[tuple[str, str], ...] = ()
    open: tuple[tuple[str, str], ...] = ()
    warnings: tuple[Problem, ...] = ()
    detectable: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    signals: tuple[MissingSignal, ...] = ()
    unpredicted: bool = False
    unknown: UnknownForce | None = None
    proof: Proof | None = None
    explained: Sequence[Explained] = ()
    residual: Mapping[str, Any] | None = None
    converters: Sequence[Converter] = ()
    next_experiment: str = ""
    statement: str = ""

    _figure = "rotorsim.report.diagnosis.compared:before_and_after_figure"

    def __repr__(self) -> str:
        return f"Diagnosis({self.verdict}: {self.statement})"

    @property
    def spots(self) -> tuple[Spot, ...]:
        """Where anything may act, the likeliest first."""
        return spots_of(self.places)

    @property
    def searched(self) -> tuple[Effect, ...]:
        """The effects that a search found, without what is read off the data."""
        return tuple(effect for effect in self.effects if not effect.candidate.insertion.read_off)

    @property
    def twice(self) -> bool:
        """Whether one effect was taken twice at one place: together they stand for a law that neither has."""
        return taken_twice(self.effects)

    def inside(self, spot: Spot) -> tuple[str, ...]:
        """Return the blocks with equations of their own (FMUs) at a place: what acts there may be inside them."""
        diagram = self._as_given
        port = spot.block, spot.port
        behind = [wire.target.block for wire in diagram.wires if (wire.source.block, wire.source.port) == port]
        alone = behind if len({*behind}) == 1 else []  # else what is inside one of them does not reach the others
        names = dict.fromkeys([spot.block, *alone]) if spot.side != "reading" else {}
        return tuple(name for name in names if name in diagram.nodes and diagram.nodes[name].block.opaque)

    @cached_property
    def _as_given(self) -> Diagram:
        return self.evidence.load(self.before.document)

    def measured(self, effect: Effect) -> dict[str, tuple[float, float, str]]:
        """Return the parameters of an effect that the signals gave by themselves: value, standard deviation, unit."""
        insertion, line = effect.candidate.insertion, self.evidence.line
        values = {} if line is None else dict.fromkeys(insertion.from_lines, (*line, "rad/s"))
        for signal in self.signals:
            if insertion.from_course and signal.physics == insertion.physics:
                values |= {key: signal.known(value) for key, value in insertion.from_course.items()}
        for converter in self.converters:
            if converter.insertion is insertion:
                step, declared = converter.step, insertion.kind.parameters
                values |= {key: (step.size, step.std, declared[key].unit or "") for key in insertion.from_steps}
        return values


def taken_twice(effects: Sequence[Effect]) -> bool:
    """Return whether one effect was taken twice at one place, or behind itself: at the output of its own block.

    Of a law and a case of it, as of a rub and a clearance, whether the data allow both to be the same.
    """
    laws = [effect.candidate.insertion for effect in effects]
    given = {Spot(law.name, port): law.spot for law in laws for port in law.fault.through.values()}
    at: list[Spot] = []
    for law in laws:
        spot, passed = law.spot, {law.spot}
        while (spot := given.get(spot, spot)) not in passed:
            passed.add(spot)
        at.append(spot)
    pairs = combinations(zip(at, effects, strict=True), 2)
    return any(spot == other and _may_be_one(one, two) for (spot, one), (other, two) in pairs)


def _may_be_one(one: Effect, two: Effect) -> bool:
    """Return whether two effects have one law, or one that is a case of the other's and as likely as it."""
    a, b = one.candidate.insertion, two.candidate.insertion
    case = a.physics in b.fault.special_cases or b.physics in a.fault.special_cases
    return a.physics == b.physics or (case and bool({*one.members} & {*two.members}))


@dataclass(frozen=True)
class Estimated:
    """A parameter of a fit: value, standard deviation, 90 % interval within its bounds (infinite where open), unit."""

    value: float
    std: float
    interval: tuple[float, float]
    unit: str
    at_bound: bool = False


def estimates(fit: Fit) -> dict[str, Estimated]:
    """Return the parameters of a fit by name: what all of statement, diagnosis.json and report say of them."""
    return {
        item.name: Estimated(float(fit.theta[j]), fit.std(j), fit.interval90(j), item.unit, bool(fit.at_bound[j]))
        for j, item in enumerate(fit.free)
    }


def interval(value: float, std: float) -> tuple[float, float]:
    """Return the 90 % interval of an estimate."""
    return value - Z90 * std, value + Z90 * std


def untried_of(selection: Selection) -> dict[str, str]:
    """Return the hypotheses, in words, that a part that failed or an error kept from being fitted, and what it was."""
    stopped: dict[str, str] = {}
    for n, found in enumerate(selection.rounds):
        names = [item.insertion.physics for item in selection.chosen[:n]]
        beside = f" beside {' and '.join(names)}" if names else ""
        fitted = {(item.insertion.physics, item.insertion.spot) for item in found.tried if not item.fit.stopped}
        for one in (item.insertion for item in found.tried):
            if (one.physics, one.spot) not in fitted:
                why = next(item.fit.failure for item in found.tried if item.insertion is one)
                stopped.setdefault(f"{one.physics} at {one.spot.words}{beside}", why)
    return stopped
