"""The diagram as given, made ready for a diagnosis: values that nobody measured are free, meshes fine enough."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.free import uncertain
from rotorsim.diagram.resolve.settings import Settings
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.meshes import on_fine_meshes
from rotorsim.model.load import load


def with_uncertain(diagram: Diagram) -> dict[str, Any]:
    """Return the document with parameters free that their blocks declare with a tolerance, as priors."""
    document = copy.deepcopy(dict(diagram.document))
    wanted = document.setdefault("identify", {})
    for full, tolerance in uncertain(diagram).items():
        block, _, key = full.partition("[")[0].rpartition(".")
        wanted[full] = {"prior": {"std": tolerance}}
        _write_out(document, block, key, diagram.nodes[block].values[key])
    for item in diagram.free:
        block, _, key = item.base.rpartition(".")
        if "[" in item.name and block:
            _write_out(document, block, key, diagram.nodes[block].values[key])
        elif "[" in item.name:
            document["parameters"][item.base] = diagram.parameters[item.base].tolist()
    return document


def first_free(diagram: Diagram) -> frozenset[str]:
    """Return the names of the parameters that a diagram frees itself, or by a tolerance: they are no effect's."""
    known = load(with_uncertain(diagram), folder=diagram.folder, trust_blocks=diagram.trusted)
    return frozenset(item.name for item in known.free)


def _write_out(document: dict[str, Any], block: str, key: str, values: np.ndarray) -> None:
    """Write all entries of a parameter, so that each can be replaced."""
    if values.ndim and block in document["blocks"]:
        document["blocks"][block].setdefault("parameters", {})[key] = values.tolist()


@dataclass(frozen=True, eq=False)
class _DocumentFit:
    """A fit to evidence, as meshes are refined for it."""

    diagram: Diagram
    evidence: Evidence
    fit: Fit

    @property
    def estimate(self) -> _DocumentFit:
        """What the fit leaves."""
        return self

    @property
    def adequate(self) -> bool:
        """Whether noise explains what it leaves."""
        return is_adequate(self.fit)

    def change(self, block: str, parts: int) -> float:
        """Return the square of what a finer mesh changes in the whitened prediction, 0 where there is none."""
        document = values_in(self.fit.document, self.fit.values)
        coarse, fine = (self.evidence.residual(d) for d in (document, self._meshed(document, block, parts)))
        if coarse is None or fine is None:
            return 0.0
        return float((fine - coarse) @ (fine - coarse))

    def finer(self, block: str, parts: int) -> _DocumentFit:
        """Return the fit with a finer mesh, from where this one ended. Raises RotorsimError."""
        finer = self.evidence.fit(self._meshed(self.fit.document, block, parts), [[dict(self.fit.values)]])
        if finer.failure:
            raise RotorsimError(Problem(finer.failure, block))
        return replace(self, fit=finer)

    def worse_by(self, other: _DocumentFit) -> float:
        """Return how much more another fit leaves."""
        return other.fit.misfit - self.fit.misfit

    def _meshed(self, document: Mapping[str, Any], block: str, parts: int) -> Mapping[str, Any]:
        return Settings.of({f"{block}.{self.diagram.nodes[block].block.refinement}": parts}).written_in(document)


def base_fit(diagram: Diagram, evidence: Evidence) -> tuple[Fit, list[str]]:
    """Return the fit of a diagram to a recording, on meshes so fine that finer ones change nothing; what was refined.

    See `on_fine_meshes`.
    """
    found = evidence.fit(with_uncertain(diagram), [])
    if found.failure:
        return found, []
    meshed, notes = on_fine_meshes(diagram, _DocumentFit(diagram, evidence, found))
    return meshed.fit, notes
