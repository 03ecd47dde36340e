"""What is set on top of a document, and what that makes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.parse.document import FlatDocument
from rotorsim.diagram.parse.source import is_too_deep
from rotorsim.errors import Place, Problem, RotorsimError, near_miss

SET = "set"  # key of what was set inside of sub-diagrams, in the document of a diagram; no file has it


@dataclass(frozen=True)
class Settings:
    """What is set on top of a document: diagram parameters, parameters of blocks by flat name, the solver.

    inner: names of parameters of sub-diagrams ("part/k").
    """

    parameters: dict[str, Any] = field(default_factory=dict)
    blocks: dict[str, dict[str, Any]] = field(default_factory=dict)
    solver: dict[str, Any] = field(default_factory=dict)
    inner: set[str] = field(default_factory=set)

    @staticmethod
    def of(given: Mapping[str, Any]) -> Settings:
        """Sort settings by what their names mean. Raises RotorsimError for what is no mapping."""
        if not isinstance(given, Mapping) or is_too_deep(dict(given)):
            raise RotorsimError(Problem("settings are a mapping of names to values", hint='set={"speed": "1500 rpm"}'))
        settings = Settings()
        for name, value in given.items():
            value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
            block, dot, parameter = str(name).rpartition("." if "." in str(name) else "/")
            if not block:
                settings.parameters[str(name)] = value
            elif block == "solver" and dot == ".":
                settings.solver[parameter] = value
            else:
                settings.blocks.setdefault(block, {})[parameter] = value
                settings.inner.update([str(name)] if dot == "/" else [])
        return settings

    def check(self, flat: FlatDocument) -> None:
        """Report names that the document does not have."""
        wrong = [name for name in self.inner if name.rpartition("/")[0] in flat.blocks]
        for name in [*(name for name in self.parameters if name not in flat.parameters), *wrong]:
            known = [*flat.parameters, *(f"{b}.{p}" for b, raw in flat.blocks.items() for p in raw.parameters)]
            flat.problems.error(f"no diagram parameter '{name}'", name, Place("--set"), near_miss(name, known))
        for name in [name for name in self.blocks if name not in flat.blocks and name not in flat.sub_diagrams]:
            known = [*flat.blocks, *flat.sub_diagrams]
            flat.problems.error(f"no block '{name}'", name, Place("--set"), near_miss(name, known))

    def written_in(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return a document with the settings in it; those inside sub-diagrams are kept under SET."""
        result = dict(data)
        if self.parameters:
            result["parameters"] = {**result["parameters"], **self.parameters}
        if self.solver:
            result["solver"] = {**result.get("solver", {}), **self.solver}
        own = {name: values for name, values in self.blocks.items() if name in data["blocks"]}
        if own:
            written = {
                name: {**data["blocks"][name], "parameters": {**data["blocks"][name].get("parameters", {}), **values}}
                for name, values in own.items()
            }
            result["blocks"] = {**result["blocks"], **written}
        others = {name: values for name, values in self.blocks.items() if name not in own}
        inside = {f"{name}.{key}": value for name, values in others.items() for key, value in values.items()}
        return {**result, SET: {**result.get(SET, {}), **inside}} if inside else result


def with_finer_mesh(diagram: Diagram, name: str, parts: int) -> Diagram:
    """Return a diagram with another value of the option by which a block is refined; its ports stay as they are."""
    node = diagram.nodes[name]
    option = node.block.refinement
    assert option is not None
    block = type(node.block)({**vars(node.block.option), option: parts}, node.block.wired)
    states = {key: block.declared_shape(state) for key, state in block.active_states().items()}
    changed = replace(node, block=block, state_shapes=states)
    document = Settings.of({f"{name}.{option}": parts}).written_in(diagram.document)
    return replace(diagram, nodes={**diagram.nodes, name: changed}, document=document)
