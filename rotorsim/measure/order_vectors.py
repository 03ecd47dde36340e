"""Order vectors over the speed, of recordings, of tables, and of diagrams whose clock changes its speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.measure.checks import AT_FAULT, UNUSABLE, check_signals
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import ANGLE, TACHO, Recording
from rotorsim.recordings.writing import as_recording
from rotorsim.settled.periodic import settled_start
from rotorsim.signals.orders.extraction import Positions, tracked_recording
from rotorsim.signals.orders.filtered import Passband, filtered_recording
from rotorsim.signals.orders.slow_roll import without_slow_roll
from rotorsim.signals.orders.steady import steady_recording
from rotorsim.signals.turning import is_run_up
from rotorsim.simulation.run import simulate

ORDERS = (1, 2)  # of samples, where none are named


@dataclass(frozen=True, eq=False)
class OrderVectors:
    """Order vectors of some runs, and of sampled ones the samples and mean positions; what a reader must know of them.

    turns: of a row; slow_roll: speeds [rad/s] between which the mean vector was subtracted.
    """

    orders: OrderRecording
    sampled: Recording | None = None
    positions: Sequence[Positions] = ()
    turns: int = 1
    slow_roll: tuple[float, float] | None = None
    notes: tuple[str, ...] = field(default=())

    def without_slow_roll(self, low: float, high: float) -> OrderVectors:
        """Return these less the mean vector between two speeds [rad/s]."""
        return replace(self, orders=without_slow_roll(self.orders, low, high), slow_roll=(low, high))

    def of_single_turns(self, orders: Sequence[int]) -> OrderVectors:
        """Return rows of one turn, which modes are fitted to: in longer ones a vector may change by more than they say.

        Where samples are too few for these, the rows as they are.
        """
        if self.turns == 1 or self.sampled is None:
            return self
        own = {run.id for run in self.orders.runs}
        try:
            rows, _ = tracked_recording(self.sampled, orders, 1, [run for run in self.sampled.runs if run.id in own])
        except RotorsimError:
            said = f"critical speeds are told from rows of {self.turns} turns: samples are too few for rows of one"
            return replace(self, notes=(*self.notes, said))
        rows = rows if self.slow_roll is None else without_slow_roll(rows, *self.slow_roll)
        return replace(
            self, orders=rows, turns=1, notes=(*self.notes, "critical speeds are told from rows of one turn")
        )


def run_as_recorded(diagram: Diagram) -> tuple[Recording, list[str]]:
    """Return the run of a diagram as a recording, and notes on its start.

    From settled motion at the speed that a ramp begins with, if it turns then: from rest it would ring there.
    Raises RotorsimError, with exit code 1, for a run that diverges.
    """
    signals = tuple(dict.fromkeys([*map(str, diagram.record), ANGLE]))
    initial, notes = _settled_at_first(diagram)
    result = simulate(diagram, record=signals, initial=initial)
    if result.status != "finished":
        raise RotorsimError(Problem(result.message, diagram.name), exit_code=1)
    return as_recording(result, diagram.name), notes


def _settled_at_first(diagram: Diagram) -> tuple[np.ndarray | None, list[str]]:
    ramps = [
        name
        for name, node in diagram.nodes.items()
        if node.block.category == "clock" and getattr(node.block.option, "profile", "") == "ramp"
    ]
    if len(ramps) != 1 or not float(diagram.nodes[ramps[0]].values["speed"]):
        return None, []
    try:
        return settled_start(diagram, parameters={f"{ramps[0]}.acceleration": 0.0}), []
    except RotorsimError as error:
        return None, [f"the run begins from rest: {error.problems[0].what}"]


def check_vectors(recording: OrderRecording) -> list[Problem]:
    """Return what is suspicious about order vectors: "constant_signal", of a probe that shows nothing."""
    found = []
    for run in recording.runs:
        for column in recording.channels:
            known = run.vectors[column][np.isfinite(run.vectors[column])]
            if len(known) > 1 and (known == known[0]).all():
                what = f"constant signal: all {len(known)} vectors are the same"
                subject = f"{run.id}: column {column}"
                found.append(Problem(what, subject, Place(run.file), severity="warning", code="constant_signal"))
    return found


def usable(
    recording: Recording | OrderRecording, runs: Sequence[str] = (), *, moving: bool = True
) -> tuple[Recording | OrderRecording, list[Problem]]:
    """Return a recording without probes that show nothing, and what is wrong with them and others.

    runs: those that count. Raises RotorsimError, with exit code 1, where speeds or sizes are not to be believed, and
    where nothing moves; moving False: all are kept then.
    """
    counted = [run.id for run in recording.runs if run.id in runs] or [run.id for run in recording.runs]
    if isinstance(recording, Recording):
        wrong = check_signals(replace(recording, runs=tuple(run for run in recording.runs if run.id in counted)))
    else:
        wrong = check_vectors(replace(recording, runs=tuple(run for run in recording.runs if run.id in counted)))
    refused = [one for one in wrong if one.code in UNUSABLE and one.severity == "error"]
    if refused:
        raise RotorsimError(*refused, exit_code=1)
    still = {one.subject for one in wrong if one.code == "constant_signal"}
    probes = [column for column, one in recording.channels.items() if one.signal not in (ANGLE, TACHO)]
    dead = {column for column in probes if all(f"{id}: column {column}" in still for id in counted)}
    if len(dead) == len(probes):
        if moving:
            raise RotorsimError(Problem("no channel shows a motion", recording.name), exit_code=1)
        dead = set()
    said = [one for one in wrong if one.code in AT_FAULT]
    if isinstance(recording, Recording):
        return replace(recording, channels={k: v for k, v in recording.channels.items() if k not in dead}), said
    return replace(recording, channels={k: v for k, v in recording.channels.items() if k not in dead}), said


def order_vectors(
    read: Recording | OrderRecording, runs: Sequence[str] = (), orders: Sequence[int] = (), turns: int = 1
) -> OrderVectors:
    """Return the order vectors of runs (default: all), of rows of some turns: as exported, or tracked in samples.

    Runs at constant speeds alone are a row each. Raises RotorsimError where there are none.
    """
    if isinstance(read, OrderRecording):
        if turns > 1:
            raise RotorsimError(Problem("turns: the rows of this table are as they were exported", read.name))
        known = sorted({one.order for one in read.channels.values()})
        missing = [order for order in orders if order not in known]
        if missing:
            hint = f"there: {', '.join(f'{order}X' for order in known)}"
            raise RotorsimError(Problem(f"no channel of order {', '.join(map(str, missing))}", read.name, hint=hint))
        return OrderVectors(replace(read, runs=tuple(run for run in read.runs if not runs or run.id in runs)))
    chosen = [run for run in read.runs if run.id in runs] if runs else None
    rising = [run for run in chosen or read.runs if is_run_up(read, run)]
    if not rising and len(chosen or read.runs) > 1:
        if turns > 1:
            raise RotorsimError(Problem("turns: runs at constant speeds are a row each", read.name))
        steady, positions = steady_recording(read, orders or ORDERS, chosen)
        return OrderVectors(steady, read, positions)
    tracked, positions = tracked_recording(read, orders or ORDERS, turns, chosen)
    left = [run.id for run in read.runs if run.id not in {own.id for own in tracked.runs}]
    notes = (f"at one speed, and left out: {', '.join(left)}",) if left and not runs else ()
    return OrderVectors(tracked, read, positions, turns, notes=notes)


def filtered_vectors(
    read: Recording | OrderRecording,
    runs: Sequence[str],
    orders: Sequence[int],
    width: Passband,
    lines: Sequence[float] = (),
) -> OrderVectors:
    """Return the order vectors of runs (default: all) by the Vold-Kalman filter; lines [Hz] are separated."""
    if isinstance(read, OrderRecording):
        raise RotorsimError(Problem("a filter needs samples: these are order vectors", read.name))
    chosen = [run for run in read.runs if run.id in runs] if runs else None
    filtered, positions = filtered_recording(read, orders or ORDERS, width, lines, chosen)
    return OrderVectors(filtered, read, positions)
