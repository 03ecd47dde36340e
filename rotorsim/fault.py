"""How a block enters a diagram that lacks its physics: the declaration that makes it a candidate of a diagnosis.

This module imports nothing else of rotorsim, so that a block file needs only it and `rotorsim.block`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

ENTRIES = ("force", "shaft", "wire", "reading", "signal", "replace", "move")


@dataclass(frozen=True)
class Of:
    """A start that follows the data: ``factor`` times the largest magnitude of an input of the block at its place.

    least: that of the run in which it is smallest, else of the one in which it is largest. power: of the magnitude.
    per: a time that follows the data, by which it is divided where the parameter is a rate. rate: of the largest rate
    of change instead; where that is not known, that of the line that stands out most.
    """

    input: str
    factor: float
    least: bool = False
    power: int = 1
    per: Longest | Sampled | None = None
    rate: bool = False


@dataclass(frozen=True)
class Longest:
    """A time that follows the data: ``factor`` times the length of the longest run.

    power: of the length; -1 for a rate.
    """

    factor: float
    power: int = 1


@dataclass(frozen=True)
class Sampled:
    """A time that follows the data: ``factor`` times the step between samples in time, the longest of all runs.

    power: of the step; -1 for a frequency.
    """

    factor: float
    power: int = 1


@dataclass(frozen=True)
class Dominant:
    """A frequency [rad/s] that follows the data: of the line that stands out most of what the diagram leaves."""


@dataclass(frozen=True)
class Onset:
    """A time [s] that follows the data: where what the diagram leaves changes in all runs; order: 0, 1, 2, ever faster.

    An eighth, three or five eighths of the longest run where nothing is known of that.
    """

    order: int


@dataclass(frozen=True)
class Lines:
    """A value that follows the data: the frequency [rad/s] of lines that do not follow the shaft."""


@dataclass(frozen=True)
class Steps:
    """A value that follows the data: the step between readings of the signal, where it is coarser than their noise."""


@dataclass(frozen=True)
class Course:
    """A value that follows the data: of a free signal that nothing predicts, its "rms" or its "correlation_time"."""

    value: str


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Declare physics that a model may leave out, and how this block adds it to a diagram.

    physics: its name in a diagnosis. enters:

    - "force": the block's outputs that have the unit of an additive input of a block (N, N m, or whatever is wired)
      go there. Its inputs come from the outputs of the same name of that block, at the same node; those that it does
      not have (``theta``, ``speed``) from the one block that has them.
    - "shaft": the same at all nodes of a block at once, of which it takes all that it ``inherits``.
    - "wire": the block stands in a wire that leads from a block of category ``between[0]`` to one of category
      ``between[1]`` ("*": to every block); ``through`` maps its inputs to its outputs. The wire is known by the name
      of the input (the output of that name of the source); further outputs go to optional inputs of their name. With
      ``recorded`` "after" a recording of that signal means the block's output, with "before" its input. ``joined``:
      whether only the blocks that take the first of ``through`` take the others from here.
    - "reading": only the recording sees the block's output (``through``), not the diagram.
    - "signal": the block's ``output`` takes the place of any scalar signal, its ``input``: for all blocks that take it,
      for one of several, for its recording, or for all of these. Of diagrams in which nothing turns. ``argument``: an
      input that takes another scalar signal of the diagram, every one in turn. ``own``: the physics that is the same
      law of one signal, at which it is tried instead where the other signal, behind gains, enters the same sum, or the
      same product for what does not add. ``of_integral``: its name where the other signal is the integral of its own.
      ``adds``: what it adds to a signal does not depend on that signal, so that behind a sum it is the same.
    - "replace": the block takes the place of one whose type is in ``of``, which may be its own type; parameters of
      equal name keep their values.
    - "move": a block of this type acts at another place.

    options: of the block where it enters. free: parameter -> starts (SI numbers, `Of`, `Longest`, `Sampled`, or
    `Dominant`), all of them tried; bounds are those of the parameter; what is not free keeps its default. fixed:
    parameters that are set once, to a number or by `Of` or `Sampled`, and not fitted, or by `Lines`: it is tried only
    where the recording has lines that call for it. By `Steps`: the block is a converter, a "reading", which is put in
    where readings show its steps; harmonics are compared with what goes into it. By `Course`: it is a "signal" of
    which no simulation knows the course, put in where a free signal explains the data that nothing predicts.
    most: what the magnitude of a free parameter can be at most, beside the bounds of the parameter. sizes: parameters
    that the effect is proportional to: where the data tell none of them from zero, there is no effect.
    simpler: parameter -> the value (or infinity) at which this is another physics, and which: where the data do not
    tell them apart, the other one is meant. holds: further physics that it is a case of, at no one value: what holds
    another and explains no more than its further parameters cost is no rival of it.
    in_drift: parameters that only the drift of 1X within the runs shows: free where that is fitted, too.
    finer: options of a finer approximation of the law, which takes its place where the data show the difference.
    inherits: parameters and options that take the value that the block at the place has under the same name;
    "crack.sag" takes that of the one block of type crack, if there is one. law: in words, what the effect does with
    speed, order and amplitude.
    confused_with: physics that read alike; told_apart_by: the experiment that separates them; told_apart_at_rest_by: on
    a machine that does not turn, where that is another one.
    convention: what no run shows and is fixed, so that values and intervals hold only with it: said with them.
    """

    physics: str
    enters: str
    free: Mapping[str, tuple[float | Of | Longest | Sampled | Dominant | Onset, ...]] = field(default_factory=dict)
    fixed: Mapping[str, float | Of | Longest | Sampled | Lines | Steps | Course] = field(default_factory=dict)
    most: Mapping[str, Of | Longest | Sampled] = field(default_factory=dict)
    sizes: tuple[str, ...] = ()
    simpler: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    holds: tuple[str, ...] = ()
    in_drift: tuple[str, ...] = ()
    of: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    finer: Mapping[str, Any] = field(default_factory=dict)
    between: tuple[str, str] = ("rotor", "controller")
    through: Mapping[str, str] = field(default_factory=dict)
    argument: str = ""
    own: str = ""
    of_integral: str = ""
    recorded: str = "after"
    joined: bool = False
    inherits: tuple[str, ...] = ()
    law: str = ""
    adds: bool = False
    confused_with: tuple[str, ...] = ()
    told_apart_by: str = ""
    told_apart_at_rest_by: str = ""
    convention: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        if self.enters not in ENTRIES:
            raise ValueError(f"enters must be one of {', '.join(ENTRIES)}, not '{self.enters}'")
        if self.recorded not in ("before", "after"):
            raise ValueError(f"recorded must be 'before' or 'after', not '{self.recorded}'")

    @property
    def special_cases(self) -> frozenset[str]:
        """The physics that it holds as cases of its own law."""
        return frozenset((*self.holds, *(other for _, other in self.simpler.values())))

    def variants(self, *changes: Mapping[str, Any]) -> tuple[Fault, ...]:
        """Return this declaration and others that differ from it by some of its fields."""
        return (self, *(replace(self, **change) for change in changes))
