"""``rotorsim locate``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common

if TYPE_CHECKING:
    from rotorsim.identification.locate import Location

__all__ = ["command"]

SURE = 0.9  # probability of a place
NOT_EXPLAINED = 1e-3  # probability of the misfit


@click.command("locate")
@click.argument("diagram", metavar="DIAGRAM")
@click.argument("recording", metavar="RECORDING")
@click.option("--block", default="crack", show_default=True, help="Block whose force is moved from node to node.")
@click.option("--count", type=click.IntRange(1, 2), default=1, show_default=True, help="2: tries a pair at two nodes.")
@click.option("--measured-input", "given", multiple=True, metavar="PORT", help="Take this port as it was measured.")
@click.option("--out", metavar="FILE", help="Write the diagram with the block at the most probable place.")
@common.set_option
@common.without_option
@common.trust_option
@common.json_option
def command(
    diagram: str,
    recording: str,
    block: str,
    count: int,
    given: tuple[str, ...],
    out: str | None,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    as_json: bool,
) -> None:
    """Find the node at which a crack (or another force) acts: every node is tried and refitted.

    Exit code 1: the place is not sure, or the model does not explain the data even there.
    With --count 2 the block and a copy of it are tried at every pair of nodes, and compared with one alone.

    \b
    rotorsim locate fe_rigid measurements --block crack
    """
    from rotorsim.identification.files import with_values
    from rotorsim.identification.locate import locate
    from rotorsim.recordings.loading import load_recording

    common.check_target("--out", out, (".json",))
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    measured = load_recording(recording)
    found = locate(loaded, measured, block, count=count, given=given, trust_blocks=trust_blocks)
    single = locate(loaded, measured, block, given=given, trust_blocks=trust_blocks)[0] if count == 2 else None
    if out:
        from rotorsim.diagram.parse.fmt import format_document
        from rotorsim.files import write_atomically
        from rotorsim.model.load import load

        best = found[0]
        folder = Path(loaded.file).parent if loaded.file else None
        placed = load(best.document, folder=folder, trust_blocks=trust_blocks)
        document = with_values(placed, list(zip(best.estimate.free, best.estimate.theta.tolist(), strict=True)))
        write_atomically(out, format_document(document))
        common.note(f"written: {out}")
    sure = found[0].probability > SURE and found[0].estimate.goodness >= NOT_EXPLAINED
    if as_json:
        common.echo_json(_data(found, single))
        sys.exit(0 if sure else 1)
    rows = [
        (" and ".join(map(str, item.nodes)), f"{item.probability:.3g}", f"{item.misfit / item.estimate.freedom:.4g}")
        for item in found
    ]
    click.echo(common.table((f"node of {block}", "probability", "misfit / freedom"), rows))
    click.echo("\n" + _statement(found, single, block))
    sys.exit(0 if sure else 1)


def _criterion(item: Location) -> float:
    """Return the Bayesian information criterion: misfit and a charge for every parameter."""
    import math

    return item.misfit + len(item.values) * math.log(item.estimate.evaluation.rows)


def _statement(found: list[Location], single: Location | None, block: str) -> str:
    best = found[0]
    places = " and ".join(map(str, best.nodes))
    if single is None and best.probability <= SURE:
        return f"The node of {block} cannot be told: {places} is most probable, with {best.probability:.2g} only."
    if best.estimate.goodness < NOT_EXPLAINED:
        poor = f"; but even there the model leaves {best.estimate.excess:.3g} times the variance of the noise"
    else:
        poor = ""
    if single is None:
        return f"{block} acts at node {places} (probability {best.probability:.3g}){poor}."
    gain = _criterion(single) - _criterion(best)
    if gain > 10:
        return (
            f"Two of {block} at nodes {places} explain the data better than one (criterion lower by {gain:.3g}){poor}."
        )
    return (
        f"One {block} at node {single.nodes[0]} is enough: a second one gains nothing (criterion {-gain:+.3g}){poor}."
    )


def _data(found: list[Location], single: Location | None) -> dict[str, Any]:
    def one(item: Location) -> dict[str, Any]:
        return {
            "nodes": item.nodes,
            "probability": item.probability,
            "misfit": item.misfit,
            "freedom": item.estimate.freedom,
            "criterion": _criterion(item),
            "parameters": item.values,
        }

    return {"places": [one(item) for item in found], "one_alone": None if single is None else one(single)}
