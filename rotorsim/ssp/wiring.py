"""Wires between the FMUs of a diagram, through blocks of gain and offset where a feed is not one to one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorsim.fmi.description.model import FmuUnit
from rotorsim.fmi.ports import FmuPort
from rotorsim.ssp.flat import Feed
from rotorsim.units import compatible

Table = tuple[tuple[int, int], ...]  # what becomes of whole numbers


@dataclass(frozen=True)
class At:
    """An entry of a port of a block: the k-th, row-major."""

    block: str
    port: FmuPort
    k: int

    def end(self) -> str:
        """Return the end of a wire at this entry."""
        inside = ",".join(str(i + 1) for i in np.unravel_index(self.k, self.port.shape)) if self.port.shape else ""
        return f"{self.block}.{self.port.name}" + (f"[{inside}]" if inside else "")

    def scale(self) -> tuple[float, float]:
        """Return (f, o): SI value = f * value of the FMU + o."""
        factor, offset = self.port.scales[self.k]
        return float(factor), float(offset)


class Wiring:
    """Adds wires, and to ``blocks`` the gains, constants and sums that they go through."""

    def __init__(self, blocks: dict[str, Any]) -> None:
        self.blocks = blocks
        self.wires: list[list[str]] = []
        self.names: Counter[str] = Counter()

    def join(self, feeds: Iterable[tuple[Feed, At, At]]) -> None:
        """Wire every source to its target: whole ports where every entry goes to its own."""
        groups: dict[tuple[str, str, str, str, float, float, Table], list[tuple[At, At]]] = {}
        for feed, source, target in feeds:
            line = _between(source.scale(), target.scale(), feed)
            key = source.block, source.port.name, target.block, target.port.name, *line, _whole(feed)
            groups.setdefault(key, []).append((source, target))
        for (block, port, other, into, factor, offset, table), pairs in groups.items():
            given, wanted = pairs[0][0].port, pairs[0][1].port
            straight = [(a.k, b.k) for a, b in pairs] == [(k, k) for k in range(len(wanted.entries))]
            whole = given.shape == wanted.shape and straight
            ends = [(f"{block}.{port}", f"{other}.{into}")] if whole else [(a.end(), b.end()) for a, b in pairs]
            plain = compatible(given.unit, wanted.unit) != "same"  # converted, or not to be: a gain has no units
            for start, end in ends:
                start = self.mapped(start, f"{other}_{into}", table)
                start = self.transformed(
                    start, f"{other}_{into}", (factor, offset), wanted.shape if whole else (), plain
                )
                self.wires.append([start, end])

    def shown(self, feed: Feed, source: At, name: str) -> str:
        """Return the end to be recorded as an output of the system, in SI units: the source, or what is made of it."""
        unit: FmuUnit | None = feed.unit.known if feed.unit else None
        line = _between(source.scale(), (unit.factor, unit.offset) if unit else source.scale(), feed)
        return self.transformed(source.end(), name, line, ())

    def mapped(self, start: str, name: str, table: Table) -> str:
        """Return the end that holds what a table makes of whole numbers; others stay as they are.

        Broken lines: every number of the table between its neighbours, and outside lines of slope one.
        """
        if not table:
            return start
        known = dict(table)
        points = sorted({k + step for k in known for step in (-2, -1, 0, 1, 2)})
        values = [float(known.get(k, k)) for k in points]
        given = {"breakpoints": [float(k) for k in points], "values": values, "outside": "extrapolate"}
        block = self._add(f"{name}_map", {"type": "lookup_table", "parameters": given})
        self.wires.append([start, f"{block}.input"])
        return f"{block}.output"

    def transformed(
        self, start: str, name: str, line: Sequence[float], shape: Sequence[int], plain: bool = False
    ) -> str:
        """Return the end that holds factor * start + offset; plain: behind a block even if that is the same."""
        factor, offset = line
        if factor != 1.0 or (plain and not offset):
            gain = self._add(f"{name}_gain", {"type": "gain", "parameters": {"gain": factor}})
            self.wires.append([start, f"{gain}.input"])
            start = f"{gain}.output"
        if offset:
            value = np.full(tuple(shape), offset).tolist()
            constant = self._add(f"{name}_offset", {"type": "constant", "parameters": {"value": value}})
            total = self._add(f"{name}_sum", {"type": "sum"})
            self.wires += [[start, f"{total}.input1"], [f"{constant}.output", f"{total}.input2"]]
            start = f"{total}.output"
        return start

    def _add(self, name: str, block: dict[str, Any]) -> str:
        made = name
        while made in self.blocks:
            self.names[name] += 1
            made = f"{name}_{self.names[name] + 1}"
        self.blocks[made] = block
        return made


def _whole(feed: Feed) -> Table:
    """Return the table of a feed, without what stays as it is."""
    pairs = sorted((int(given), int(wanted)) for given, wanted in (feed.table or {}).items())
    return tuple((given, wanted) for given, wanted in pairs if given != wanted)


def _between(given: tuple[float, float], wanted: tuple[float, float], feed: Feed) -> tuple[float, float]:
    """Return (a, b): what a feed makes of a signal in SI units. given, wanted: SI value = f * value there + o."""
    (f, o), (into, at) = given, wanted
    factor = feed.factor * into / f
    offset = into * (feed.offset - feed.factor * o / f) + at
    nothing = 1e-12 * max(abs(into * feed.offset), abs(factor * o), abs(at))
    exact = abs(factor - 1.0) < 1e-12
    return 1.0 if exact else float(factor), 0.0 if abs(offset) <= nothing else float(offset)
