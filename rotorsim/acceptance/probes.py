"""What is wrong with the probes of a recording: nothing that they show is a proof that a limit is met."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rotorsim.errors import Problem, RotorsimError
from rotorsim.measure.order_vectors import usable
from rotorsim.recordings.orders import OrderChannel, OrderRecording
from rotorsim.recordings.recording import Channel, Recording
from rotorsim.units import parse_unit

DISPLACEMENT = "displacement"


def examined(recording: Recording | OrderRecording) -> tuple[Recording | OrderRecording, dict[tuple[str, str], str]]:
    """Return a recording without probes that show nothing, and run and column of displacements that cannot be so.

    The latter with what is wrong, in words, for those that were left out, too.
    Raises RotorsimError where speeds or sizes are not to be believed: lost pulses, for example.
    """
    sound, problems = usable(recording, moving=False)
    said = {one.subject: one.what for one in problems}
    channels: Mapping[str, Channel] = recording.channels
    columns = [key for key, one in channels.items() if one.signal.endswith(DISPLACEMENT) and _is_judged(one)]
    every = {(run.id, column): f"{run.id}: column {column}" for run in recording.runs for column in columns}
    return sound, {key: said[subject] for key, subject in every.items() if subject in said}


def _is_judged(channel: Channel) -> bool:
    """Return whether samples, or 1X: a table may have a 2X that is too small to show."""
    return not isinstance(channel, OrderChannel) or channel.order == 1


def refuse_units(recordings: Iterable[Recording | OrderRecording]) -> None:
    """Raise RotorsimError for displacements that are no lengths: volts of a probe say nothing without its scale."""
    length = parse_unit("m").dimension
    problems = []
    for recording in recordings:
        for column, one in recording.channels.items():
            if one.signal.endswith(DISPLACEMENT) and parse_unit(one.unit).dimension != length:
                hint = "give the values times the scale of the probe, as a length"
                what = f"'{one.signal}' in {one.unit} is no displacement"
                problems.append(Problem(what, f"{recording.name}: column {column}", hint=hint))
    if problems:
        raise RotorsimError(*problems)
