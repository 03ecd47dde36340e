"""A fault at a place of a diagram: what is wired, cut and read, and where its parameters start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import floor, log10
from typing import Any

import numpy as np

from rotorsim.block import Block
from rotorsim.fault import Course, Dominant, Fault, Lines, Longest, Of, Onset, Sampled, Steps

LEAST = "least"  # before the name of a signal: its size in the run in which it is smallest
RATE = "rate of"  # before the name of a signal: its largest rate of change
LONGEST = "longest run"  # among the largest magnitudes of signals: how long it is [s]
SAMPLED = "step between samples"  # among the largest magnitudes of signals: the longest [s]
DOMINANT = "dominant frequency"  # among the largest magnitudes of signals: of the line that stands out most [rad/s]
ONSETS = ("first onset", "second onset", "third onset")  # among the largest magnitudes of signals: see `Onset` [s]
LAW_ALONE = "law"  # the block of a law alone
LINES = "lines"  # among the largest magnitudes of signals: the frequency of asynchronous lines


STARTS_TRIED = 8  # of a law that are tried; of more, those that add most nearly what is missing, else the first
FAR_FROM_BOTH_ENDS = 0.06  # radians a sample: a frequency, where no line is known

Law = tuple[str, int, bool]  # see `Insertion.law`


@dataclass(frozen=True)
class Spot:
    """A place in a diagram: a port of a block, and the node (from 1) where it has nodes.

    beside: the only node of another block to which this one is wired: where along the shaft it stands. side: of a
    signal, what is behind the place: "" what takes it, "reading" its recording, "both"; "branch": this input alone, of
    several that take it.
    """

    block: str
    port: str
    node: int | None = None
    beside: int | None = field(default=None, compare=False)
    side: str = ""

    def __str__(self) -> str:
        return f"{self.block}.{self.port}" + (f"[{self.node}]" if self.node is not None else "")

    @property
    def words(self) -> str:
        """The place in words: what of a signal is meant."""
        words = {"reading": "the reading of {}", "both": "{}, its reading too", "branch": "the branch into {}"}
        return words.get(self.side, "{}").format(self)


@dataclass(frozen=True, eq=False)
class Insertion:
    """A fault at a spot. name: of the block that carries it. wires: added; cut: taken out (source, target).

    measured: what recordings mean with it. values: parameters and options of the block. variant: of several
    declarations for one physics.
    """

    kind: type[Block]
    fault: Fault
    spot: Spot
    name: str
    wires: tuple[tuple[str, str], ...] = ()
    cut: tuple[tuple[str, str], ...] = ()
    measured: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)
    feeds: Mapping[str, str] = field(default_factory=dict)
    variant: int = 0

    @property
    def physics(self) -> str:
        """The name of the physics."""
        return self.fault.physics

    @property
    def law(self) -> Law:
        """Physics, variant, and whether it follows another signal: what it does, wherever it acts."""
        return self.physics, self.variant, bool(self.depends_on)

    @property
    def depends_on(self) -> str:
        """The signal that is its ``argument``; empty where it has none."""
        return self.feeds.get(self.fault.argument, "")

    @property
    def key(self) -> str:
        """A text that identifies this insertion among all of a diagram."""
        of = f"({self.depends_on})" if self.depends_on else ""
        return f"{self.physics}/{self.variant}{of}@{self.spot}{self.spot.side}"

    @property
    def free(self) -> tuple[str, ...]:
        """The names under which its parameters are free."""
        return tuple(f"{self.name}.{key}" for key in self.fault.free)

    @property
    def grows(self) -> bool:
        """Whether it has a state that starts with every run, however long the machine has turned."""
        return any(state.fresh for state in self.kind.states.values())

    @property
    def finer(self) -> Insertion:
        """The same with a finer approximation of its law, if it has one."""
        return replace(self, values={**self.values, **self.fault.finer})

    def approximated(self, document: Mapping[str, Any]) -> dict[str, Any]:
        """Return a document that has this insertion in it, with its approximation of the law."""
        block = document["blocks"][self.name]
        kept = {key: value for key, value in self.values.items() if key in self.fault.finer}
        changed = {**block, "parameters": {**block.get("parameters", {}), **kept}}
        return {**document, "blocks": {**document["blocks"], self.name: changed}}

    @property
    def from_lines(self) -> tuple[str, ...]:
        """The parameters that take the frequency of asynchronous lines."""
        return tuple(key for key, item in self.fault.fixed.items() if isinstance(item, Lines))

    @property
    def begins_at_line(self) -> bool:
        """Whether it begins at the line that stands out of the residual: what hum in one reading is, too."""
        return any(isinstance(start, Dominant) for starts in self.fault.free.values() for start in starts)

    @property
    def from_steps(self) -> tuple[str, ...]:
        """The parameters that take the quantisation step of readings."""
        return tuple(key for key, item in self.fault.fixed.items() if isinstance(item, Steps))

    @property
    def from_course(self) -> dict[str, str]:
        """The parameters that take a value of a free signal, and which."""
        return {key: item.value for key, item in self.fault.fixed.items() if isinstance(item, Course)}

    @property
    def stated_once(self) -> tuple[str, ...]:
        """The names of the parameters that follow the size of the data and are not fitted at first."""
        fixed = self.fault.fixed.items()
        return tuple(f"{self.name}.{key}" for key, item in fixed if isinstance(item, (Of, Longest)))

    @property
    def smoothed(self) -> tuple[str, ...]:
        """The names of the parameters that follow the rate of samples: times by which a law is only approximated."""
        return tuple(f"{self.name}.{key}" for key, item in self.fault.fixed.items() if isinstance(item, Sampled))

    @property
    def read_off(self) -> bool:
        """Whether it is read off the data, and never fitted: steps of a converter, the course of a signal."""
        return bool(self.from_steps or self.from_course)

    def document(
        self,
        document: Mapping[str, Any],
        start: Mapping[str, float] | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> dict[str, Any]:
        """Return the document with the fault in it and its parameters free, from starts {parameter: SI value}.

        limits: (low, high) of its free parameters, where they are narrower than what the block allows.
        """
        new = {**document, "blocks": dict(document["blocks"]), "identify": dict(document.get("identify", {}))}
        kept: dict[str, Any] = {}
        if self.fault.enters in ("replace", "move"):
            block = new["blocks"][self.name]
            known = {*self.kind.parameters, *self.kind.options}
            kept = {key: value for key, value in block.get("parameters", {}).items() if key in known}
            if block["type"] != self.kind.type_name:
                followed = {v[1:] for v in kept.values() if isinstance(v, str) and v.startswith("$")}
                for name in followed & set(new["identify"]):  # other bounds may hold for the new type
                    new["identify"][name] = {k: v for k, v in new["identify"][name].items() if k not in ("low", "high")}
        parameters = {**kept, **self.values, **(start or {})}
        new["blocks"][self.name] = {"type": self.kind.type_name, "parameters": parameters}
        if self.cut or self.wires:
            cut = {(_plain(a), _plain(b)) for a, b in self.cut}
            new["wires"] = [w for w in new["wires"] if (_plain(w[0]), _plain(w[1])) not in cut]
            new["wires"] += [list(wire) for wire in self.wires]
        if self.measured:
            new["measured"] = {**new.get("measured", {}), **self.measured}
        ends = limits or {}
        bounds = {key: dict(zip(("low", "high"), ends.get(key, ()), strict=False)) for key in self.fault.free}
        free = {f"{self.name}.{key}": given for key, given in bounds.items()}
        new["identify"] |= free
        return new

    def alone(
        self,
        parameters: Mapping[str, Any],
        limits: Mapping[str, tuple[float, float]],
        driving: Mapping[str, tuple[str, tuple[int, ...]]],
        output: str,
    ) -> dict[str, Any]:
        """Return the document of a diagram of the block alone, `LAW_ALONE`, driven by recorded signals.

        driving: of each signal, the input and its shape. output: that is recorded. limits: see `document`.
        """
        blocks = {
            name: {"type": "recorded", "parameters": {"value": np.zeros(shape).tolist()}}
            for name, (_, shape) in driving.items()
        }
        bounds = {key: dict(zip(("low", "high"), limits.get(key, ()), strict=False)) for key in self.fault.free}
        return {
            "schema_version": 1,
            "name": self.physics,
            "blocks": {**blocks, LAW_ALONE: {"type": self.kind.type_name, "parameters": dict(parameters)}},
            "wires": [[f"{name}.output", f"{LAW_ALONE}.{port}"] for name, (port, _) in driving.items()],
            "record": [f"{LAW_ALONE}.{output}"],
            "identify": {f"{LAW_ALONE}.{key}": limit for key, limit in bounds.items()},
        }


def _plain(end: str) -> str:
    return end.replace(" ", "")


def sizes_at(insertion: Insertion, largest: Mapping[str, float]) -> dict[str, float]:
    """Return the magnitudes of the inputs of an insertion that are known (at their node or any).

    largest: magnitudes of signals by their flat names, and what `LEAST`, `DOMINANT`, `ONSETS`, `LINES`, `LONGEST` and
    `SAMPLED` stand for. Of signals that bound the insertion but do not feed it, those of the block where it acts.
    """
    sizes = {key: value for key, value in largest.items() if key in (DOMINANT, *ONSETS, LINES, LONGEST, SAMPLED)}
    bounds = [item.input for item in insertion.fault.most.values() if isinstance(item, Of)]
    for key, source in (*((key, f"{insertion.spot.block}.{key}") for key in bounds), *insertion.feeds.items()):
        for which in ("", f"{LEAST} ", f"{RATE} "):
            signal = f"{which}{source}".rstrip("]")
            here = [v for name, v in largest.items() if name.startswith((f"{signal},", f"{signal}]"))]
            port = [v for name, v in largest.items() if name.partition("[")[0] == signal.partition("[")[0]]
            if here or port:
                sizes[which + key] = max(here or port)
    return sizes


def starts_of(insertion: Insertion, largest: Mapping[str, float]) -> list[dict[str, float]]:
    """Return the starts of an insertion: every combination that its fault declares, {parameter: SI value}.

    largest: the largest magnitude of each input of the block at its place, for starts that follow the data.
    """
    combined: list[dict[str, float]] = [{}]
    for key, options in insertion.fault.free.items():
        low, high = limits_of(insertion, largest).get(key, (-np.inf, np.inf))
        values = [float(np.clip(_number(item, largest), low, high)) for item in options]
        combined = [{**start, key: value} for start in combined for value in dict.fromkeys(values)]
    return combined


def limits_of(insertion: Insertion, largest: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return (low, high) of the free parameters that the data bound more narrowly than the block does."""
    limits = {}
    for key, item in insertion.fault.most.items():
        known = largest.get(
            SAMPLED if isinstance(item, Sampled) else LONGEST if isinstance(item, Longest) else item.input
        )
        if key not in insertion.fault.free or not known:
            continue
        declared = insertion.kind.parameters[key]
        most = _number(item, largest)
        least = declared.low if declared.low is not None else declared.above
        if (declared.high is None or most < declared.high) and (least is None or most > least):
            # an open end is left by a thousandth of the way, as where a value is given (diagram.resolve.free)
            low = -most if least is None else least if declared.low is not None else least + 1e-3 * (most - least)
            limits[key] = (low, most)
    return limits


def scales_of(item: Insertion, start: Mapping[str, float]) -> dict[str, float]:
    """Return powers of ten below where parameters start that have an open bound: its distance follows their values."""
    opened = {key: item.kind.parameters[key].above for key in item.fault.free}
    above = {key: (low, start[key] - low) for key, low in opened.items() if low is not None and start[key] > low}
    return {key: low + 10.0 ** floor(log10(size)) for key, (low, size) in above.items()}


def fixed_of(insertion: Insertion, largest: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of an insertion that are set once and not fitted."""
    fixed = insertion.fault.fixed.items()
    return {key: _number(item, largest) for key, item in fixed if not isinstance(item, (Steps, Course))}


def _number(item: float | Of | Longest | Sampled | Dominant | Onset | Lines, largest: Mapping[str, float]) -> float:
    if isinstance(item, Lines):
        return largest[LINES]
    if isinstance(item, Dominant):
        return largest.get(DOMINANT, FAR_FROM_BOTH_ENDS / largest.get(SAMPLED, 1e-3))
    if isinstance(item, Onset):
        return largest.get(ONSETS[item.order], (2 * item.order + 1) / 8 * largest.get(LONGEST, 1.0))
    if isinstance(item, Longest):
        return item.factor * largest.get(LONGEST, 1.0) ** item.power
    if isinstance(item, Sampled):
        return item.factor * largest.get(SAMPLED, 1e-3) ** item.power
    if not isinstance(item, Of):
        return float(item)
    size = largest.get(item.input, 1.0)
    size = largest.get(f"{LEAST} {item.input}", size) if item.least else size
    if item.rate:
        size = largest.get(f"{RATE} {item.input}", size * _number(Dominant(), largest))
    size = size or 1.0  # what stands still has no size
    return item.factor * size**item.power / (1.0 if item.per is None else _number(item.per, largest))
