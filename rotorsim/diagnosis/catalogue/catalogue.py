"""The fault catalogue of a diagnosis: the declared faults of all blocks that are to be tried."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.fault import Sampled


@dataclass(frozen=True)
class Catalogue:
    """registry: block types whose faults are candidates. physics: only these (default: all). trust: run user blocks."""

    registry: Registry = field(default_factory=Registry)
    physics: frozenset[str] | None = None
    trust: bool = False

    @classmethod
    def of(cls, diagram: Diagram, physics: Collection[str] | None = None) -> Catalogue:
        """Return the catalogue of a diagram: built-in faults and, if it is trusted, those of its block folders."""
        folders = diagram.document.get("block_folders", []) if diagram.trusted and diagram.file else []
        registry = Registry([Path(diagram.file).parent / name for name in folders])
        return cls(registry, None if physics is None else frozenset(physics), diagram.trusted)

    def only(self, physics: Collection[str]) -> Catalogue:
        """Return the catalogue with these physics only."""
        return replace(self, physics=frozenset(physics))

    @property
    def smoothed(self) -> frozenset[str]:
        """The types of blocks whose laws are approximated by times that follow the rate of samples."""
        return frozenset(
            name
            for name, block in self.registry.all_types().items()
            if any(isinstance(value, Sampled) for fault in block.faults for value in fault.fixed.values())
        )

    def candidates(self, diagram: Diagram, recorded: Iterable[str]) -> list[Insertion]:
        """Return every fault of the catalogue at every place of a diagram where its ports fit."""
        every = insertions(diagram, recorded, self.registry)
        return [item for item in every if self.physics is None or item.physics in self.physics]
