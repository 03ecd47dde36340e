"""``rotorsim locate``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    Chosen,
    diagram_argument,
    file_option,
    given_options,
    json_option,
    measured_input_option,
    note,
    recording_argument,
    show,
    show_problems,
)
from rotorsim.criteria import CRITERIA
from rotorsim.report.text.table import table

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.identification.locate import Location


@click.command("locate")
@diagram_argument
@recording_argument
@click.option("--block", default="crack", show_default=True, help="Block whose force is moved from node to node.")
@click.option("--count", type=click.IntRange(1, 2), default=1, show_default=True, help="2: tries a pair at two nodes.")
@measured_input_option
@file_option("--out", suffixes=(".json",), help="Write the diagram with the block at the most probable place.")
@given_options
@json_option
def command(
    chosen: Chosen, recording: str, block: str, count: int, given: tuple[str, ...], out: str | None, as_json: bool
) -> int:
    """Find the node at which a crack (or another force) acts: every node is tried and refitted.

    Exit code 1: the place is not sure, the model does not explain the data even there, the recording contradicts what
    the model holds at a value, or a node could not be fitted.
    With --count 2 the block and a copy of it are tried at every pair of nodes, and compared with one alone.

    \b
    rotorsim locate fe_rigid measurements --block crack
    """
    from rotorsim.identification.held import is_contradicted
    from rotorsim.identification.locate import locate
    from rotorsim.recordings.loading import load_recording

    loaded, measured = chosen.open(), load_recording(recording)
    locations = locate(loaded, measured, block, count=count, given=given)
    alone = locate(loaded, measured, block, given=given) if count == 2 else None
    single = None if alone is None else alone[0]
    show_problems([*locations.warnings, *(alone.warnings if alone else [])])
    failed = {**locations.failed, **(alone.failed if alone else {})}
    if out:
        _save(locations[0], loaded, out)
        note(f"written: {out}")
    rows = [
        (" and ".join(map(str, item.nodes)), f"{item.probability:.3g}", f"{item.misfit / item.estimate.freedom:.4g}")
        for item in locations
    ]
    places = table((f"node of {block}", "probability", "misfit / freedom"), rows)
    said = " ".join([_statement(locations, single, block), *map(_not_tried, failed.items())])
    show(as_json, lambda: _data(locations, single, failed), lambda: f"{places}\n\n{said}")
    best = locations[0]
    sure = best.probability > CRITERIA.located and best.estimate.goodness >= CRITERIA.not_explained
    return 0 if sure and not failed and not is_contradicted(locations.warnings) else 1


def _save(best: Location, diagram: Diagram, file: str) -> None:
    """Write the diagram with the block at a place, with the values identified there."""
    from rotorsim.diagram.parse.fmt import format_document
    from rotorsim.files import write_atomically
    from rotorsim.identification.files import as_written
    from rotorsim.model.load import load

    folder = diagram.folder
    placed = load(best.document, folder=folder, trust_blocks=diagram.trusted)
    values = list(zip(best.estimate.free, best.estimate.theta.tolist(), strict=True))
    document, notes = as_written(placed, values)
    show_problems(notes)
    write_atomically(file, format_document(document))


def _criterion(item: Location) -> float:
    """Return the Bayesian information criterion: misfit and a charge for every parameter."""
    return item.misfit + len(item.values) * math.log(item.estimate.evaluation.rows)


def _statement(locations: list[Location], single: Location | None, block: str) -> str:
    best = locations[0]
    places = " and ".join(map(str, best.nodes))
    if single is None and best.probability <= CRITERIA.located:
        return f"The node of {block} cannot be located: {places} is most probable, with {best.probability:.2g} only."
    poor = f"; but even there the residual variance is {best.estimate.excess:.3g} times the noise"
    poor = poor if best.estimate.goodness < CRITERIA.not_explained else ""
    if single is None:
        return f"{block} acts at node {places} (probability {best.probability:.3g}){poor}."
    gain = _criterion(single) - _criterion(best)
    if gain > 10:
        return f"Two of {block} at nodes {places} explain the data better than one (BIC lower by {gain:.3g}){poor}."
    return f"One {block} at node {single.nodes[0]} is enough: a second one gains nothing (BIC {-gain:+.3g}){poor}."


def _not_tried(failed: tuple[tuple[int, ...], str]) -> str:
    nodes, why = failed
    return f"Node {' and '.join(map(str, nodes))} could not be fitted, so that nothing is said of it ({why})."


def _data(locations: list[Location], single: Location | None, failed: Mapping[tuple[int, ...], str]) -> dict[str, Any]:
    def one(item: Location) -> dict[str, Any]:
        return {
            "nodes": item.nodes,
            "probability": item.probability,
            "misfit": item.misfit,
            "freedom": item.estimate.freedom,
            "criterion": _criterion(item),
            "parameters": item.values,
        }

    return {
        "places": [one(item) for item in locations],
        "one_alone": None if single is None else one(single),
        "failed": [{"nodes": nodes, "why": why} for nodes, why in failed.items()],
    }
