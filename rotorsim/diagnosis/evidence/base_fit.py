"""The diagram as given, made ready for a diagnosis: values that nobody measured are free, meshes fine enough."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagram.diagram import Diagram

FINEST = 8
BY_HALVING = 256  # of the square of what meshes get wrong, by half the length: cubic elements err with its fourth power


def with_uncertain(diagram: Diagram) -> dict[str, Any]:
    """Return the document with parameters free that their blocks declare with a tolerance, as priors."""
    document = copy.deepcopy(dict(diagram.document))
    wanted = document.setdefault("identify", {})
    for name, node in diagram.nodes.items():
        for key, declared in node.block.parameters.items():
            full = f"{name}.{key}"
            if declared.tolerance is None or key in node.references or "/" in name:
                continue
            if not any(str(given).partition("[")[0] == full for given in wanted):
                wanted[full] = {"prior": {"std": declared.tolerance}}
                _write_out(document, name, key, node.values[key])
    for item in diagram.free:
        block, _, key = item.base.rpartition(".")
        if "[" in item.name and block:
            _write_out(document, block, key, diagram.nodes[block].values[key])
        elif "[" in item.name:
            document["parameters"][item.base] = diagram.parameters[item.base].tolist()
    return document


def _write_out(document: dict[str, Any], block: str, key: str, values: np.ndarray) -> None:
    """Write all entries of a parameter, so that each can be replaced."""
    if values.ndim and block in document["blocks"]:
        document["blocks"][block].setdefault("parameters", {})[key] = values.tolist()


def base_fit(diagram: Diagram, evidence: Evidence) -> tuple[Fit, list[str]]:
    """Return the fit of a diagram to a recording, on meshes so fine that finer ones change nothing; what was refined.

    A block that declares ``refinement`` is refined until a finer mesh changes the whitened prediction by less than
    `Criteria.mesh_visible` (sum of squares).
    """
    found = evidence.fit(with_uncertain(diagram), [])
    notes: list[str] = []
    for name, node in diagram.nodes.items():
        option = node.block.refinement
        if option is None or found.failure:
            continue
        level = int(getattr(node.block.option, option))
        while level < FINEST:
            change = _change(found, evidence, name, option, 2 * level)
            if change <= CRITERIA.mesh_visible:
                break
            finer = evidence.fit(_with_option(found.document, name, option, 2 * level), [[dict(found.values)]])
            if finer.failure:
                break
            found, level = finer, 2 * level
            notes.append(f"{name}: {option} {level}, for what the coarser mesh gets wrong shows in these data")
            if level >= FINEST and change > BY_HALVING * CRITERIA.mesh_visible:
                notes[-1] += "; a finer one would show, too"
    return found, notes[-1:]


def _change(fit: Fit, evidence: Evidence, block: str, option: str, value: int) -> float:
    """Return the square of what a finer mesh changes in the whitened prediction, 0 where there is none."""
    document = values_in(fit.document, fit.values)
    coarse, fine = (evidence.residual(d) for d in (document, _with_option(document, block, option, value)))
    if coarse is None or fine is None:
        return 0.0
    return float((fine - coarse) @ (fine - coarse))


def _with_option(document: Mapping[str, Any], block: str, option: str, value: int) -> Mapping[str, Any]:
    changed = dict(document["blocks"][block])
    changed["parameters"] = {**changed.get("parameters", {}), option: value}
    return {**document, "blocks": {**document["blocks"], block: changed}}
