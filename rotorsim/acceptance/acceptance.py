"""Acceptance of a machine after ISO 14839 and API 617, by its diagram and by recordings of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rotorsim.acceptance.conditions import Conditions, conditions_of
from rotorsim.acceptance.criterion import MET, NOT_JUDGED, NOT_MET, UNSURE, Criterion, Part
from rotorsim.acceptance.damping import damped_modes
from rotorsim.acceptance.displacement import measured_displacement, modelled_displacement
from rotorsim.acceptance.probes import refuse_units
from rotorsim.acceptance.rotor import mode_shapes, support_map
from rotorsim.acceptance.stability_margins import measured_stability, modelled_margins
from rotorsim.acceptance.unbalance import unbalance_cases
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import provenance
from rotorsim.model.compiled import Model, model_for_runs
from rotorsim.recordings.injection import InjectionRecording
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import ANGLE, TACHO, Recording

AnyRecording = Recording | OrderRecording


@dataclass(frozen=True, eq=False)
class Acceptance:
    """All that was judged of a machine. verdict rests on the criteria that are required, not on advice."""

    name: str
    conditions: Conditions
    parts: tuple[Part, ...]
    diagram: Diagram | None = None
    recordings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """Every criterion of every part."""
        return tuple(one for part in self.parts for one in part.criteria)

    @property
    def verdict(self) -> str:
        """Verdict: the worst of all required criteria: "not met", "unsure", "not judged"; else "met"."""
        verdicts = [one.verdict for one in self.criteria if one.required]
        return next((one for one in (NOT_MET, UNSURE, NOT_JUDGED) if one in verdicts), MET if verdicts else NOT_JUDGED)

    def count(self, verdict: str, *, required: bool = True) -> int:
        """Return how many criteria have a verdict."""
        return sum(one.verdict == verdict and one.required is required for one in self.criteria)

    def __repr__(self) -> str:
        return f"Acceptance({self.name}: {self.statement})"

    @property
    def statement(self) -> str:
        """The verdict in words."""
        parts = [f"{self.count(one)} {one}" for one in (MET, NOT_MET, UNSURE, NOT_JUDGED) if self.count(one)]
        advice = self.count(NOT_MET, required=False)
        return f"{', '.join(parts) or 'nothing to judge'}{f'; advice: {advice} not met' if advice else ''}"


def accept(
    diagram: Diagram | Model | None = None,
    recordings: Sequence[AnyRecording] | AnyRecording = (),
    *,
    operating: tuple[float, float] | None = None,
    trip: float | None = None,
    clearance: float | Mapping[str, float] | None = None,
    planes: Sequence[str] = (),
    mass: float | None = None,
    zone: str = "A",
    cross_coupling: Mapping[str, float] | None = None,
) -> Acceptance:
    """Judge a machine by ISO 14839-2 and -3 and by API 617, by its diagram, by recordings of it, or by both.

    operating, trip [rad/s]: operating speeds (default: the diagram's speed), trip speed (default: 1.05 times).
    clearance [m]: radial, of all probes or by two-axis signal. planes: of unbalance, such as ``rotor.force[4]``
    (default: where blocks ``unbalance`` act). mass [kg] of the rotor (default: from its equations). zone: the worst of
    ISO 14839 that is accepted. cross_coupling [N/m]: anticipated, by plane. What cannot be judged says why.

    Raises RotorsimError for impossible conditions, and without a diagram and a recording.
    Source: ISO 14839-2:2004; ISO 14839-3:2006; API 617 (8th ed., 2014); API RP 684 (2nd ed., 2005).
    """
    given = [recordings] if isinstance(recordings, Recording | OrderRecording) else list(recordings)
    if diagram is None and not given:
        raise RotorsimError(Problem("nothing to judge: give a diagram, a recording, or both", "accept"))
    model = None if diagram is None else model_for_runs(diagram)
    if model is not None:
        _refuse_foreign(model, given)
    refuse_units(one for one in given if not isinstance(one, InjectionRecording))
    conditions = conditions_of(
        model,
        operating=operating,
        trip=trip,
        clearance=clearance,
        planes=planes,
        mass=mass,
        zone=zone,
        cross_coupling=cross_coupling,
    )
    parts = [] if model is None else list(_modelled(model, conditions))
    for recording in given:
        parts += _measured(recording, conditions)
    names = tuple(recording.name for recording in given)
    return Acceptance(
        name=names[0] if model is None else model.diagram.name,
        conditions=conditions,
        parts=tuple(parts),
        diagram=None if model is None else model.diagram,
        recordings=names,
        provenance={} if model is None else provenance(model, None, "accept"),
    )


def _refuse_foreign(model: Model, recordings: Sequence[AnyRecording]) -> None:
    """Raise RotorsimError for recordings of what the diagram has not: those of another machine."""
    problems = []
    for recording in recordings:
        ports = {one.signal for one in recording.channels.values()}
        known = {
            f"{name}.{port}" for name, node in model.diagram.nodes.items() for port in (*node.inputs, *node.outputs)
        }
        foreign = sorted(ports - known - {ANGLE, TACHO})
        if foreign:
            hint = "is it of this machine? recording.json names what its channels measure"
            what = f"the diagram '{model.diagram.name}' has no {', '.join(foreign)}"
            problems.append(Problem(what, recording.name, hint=hint))
    if problems:
        raise RotorsimError(*problems)


def _modelled(model: Model, given: Conditions) -> Iterator[Part]:
    yield modelled_displacement(model, given)
    yield modelled_margins(model, given)
    yield unbalance_cases(model, given)
    yield damped_modes(model, given)
    yield support_map(model, given)
    yield mode_shapes(model, given)


def _measured(recording: AnyRecording, given: Conditions) -> Iterator[Part]:
    from rotorsim.acceptance.run_ups import measured_critical_speeds, run_ups_of  # loads half a second of statistics

    if isinstance(recording, InjectionRecording):
        yield measured_stability(recording, given)
    elif isinstance(recording, OrderRecording):
        yield measured_critical_speeds(recording, given)
    else:
        changing = run_ups_of(recording)
        if changing:
            yield measured_critical_speeds(recording, given)
        if len(changing) < len(recording.runs):
            yield measured_displacement(recording, given)
