"""How much of what is to be explained each effect explains, and what all of them leave over: share, place, size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from rotorsim.block import In
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.harmonic import Fit, Source
from rotorsim.diagnosis.evidence.scoring import Held, HeldScore, predict, score, standardised
from rotorsim.diagnosis.search.naming import Named
from rotorsim.diagnosis.search.places import open_places
from rotorsim.diagnosis.search.proof import Share, share_explained
from rotorsim.diagnosis.search.trials import Candidate, is_adequate
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.identification.estimate import NOT_EXPLAINED
from rotorsim.identification.likelihood import Likelihood

if TYPE_CHECKING:
    from rotorsim.diagnosis.conclude.conclusions import Effect

__all__ = ["Explained", "explanations", "is_force", "residual_of"]

SLIGHT = 1.2  # times the variance of the noise: less cannot be told from noise of some channels that is not as modelled
CHANCE = 1e-3  # probability that noise alone makes any order of a residual
FAILURES = (RotorsimError, ValueError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Explained:
    """share: of what is explainable, with its interval; None: not known.

    explainable: the share of all that is left without the effect that a free force or signal at its place explains;
    None where no such signal can be put there, and all counts as explainable.
    """

    share: Share | None
    explainable: float | None


def explanations(
    named: Named, effects: Sequence[Effect], source: Source, held: Sequence[Held]
) -> tuple[Explained, ...]:
    """Return of each effect how much it explains in runs that took no part, beside the others."""
    after = _runs(named.fit, source, held) if effects else None
    return tuple(
        Explained(None, None) if after is None else _explained(effect.candidate, found.before, after, source, held)
        for effect, found in zip(effects, named.rounds, strict=False)
    )


def _explained(item: Candidate, without: Fit, after: HeldScore, source: Source, held: Sequence[Held]) -> Explained:
    before = _runs(without, source, held)
    if before is None:
        return Explained(None, None)
    least = _least(item, without, source, held)
    share = share_explained(before, after, least)
    if least is None or share is None:
        return Explained(share, None)
    left = sum(misfit - rows for misfit, rows in before.runs)
    free = sum(misfit - rows for misfit, rows in least)
    return Explained(share, float(np.clip(1 - free / left, 0.0, 1.0)) if left > 0 else None)


def _runs(fit: Fit, source: Source, held: Sequence[Held]) -> HeldScore | None:
    """Return what a fit leaves in runs that took no part: held-out ones, or each left out of the others."""
    document = values_in(fit.document, fit.values)
    if held:
        return score(document, source, held)
    try:
        runs = standardised(predict(document, source, Held(source.recording, source.harmonics)))
    except FAILURES:
        runs = None
    if runs is None and len(fit.left_out):  # as it was when it was fitted
        runs = tuple((float(misfit), fit.rows / len(fit.left_out)) for misfit in fit.left_out)
    return None if runs is None else HeldScore({}, {}, None, 0, runs)


def _least(item: Candidate, without: Fit, source: Source, held: Sequence[Held]) -> list[tuple[float, float]] | None:
    found: list[tuple[float, float]] = []
    for part in held or (None,):
        places = open_places(without, source, part)
        runs = None if places is None else places.least(item.insertion)
        if runs is None:
            return None
        found += runs
    return found


def is_force(base: Fit, source: Source) -> bool:
    """Return whether free harmonics of a force at some one place explain what a linear diagram leaves over.

    Errors of channels, each by itself, are not in displacement and current as the loop demands of a force.
    """
    if base.misfit <= SLIGHT * base.freedom:
        return False
    places = open_places(base, source)
    if places is None:
        return False
    for key in {name.partition("[")[0]: None for name in places.places}:
        by_node: dict[str, list[str]] = {}
        for name in places.places:
            port, _, index = name.partition("[")
            if port == key:
                by_node.setdefault(index.rpartition(",")[0], []).append(name)
        for names in by_node.values():
            misfit, rows = (sum(part) for part in zip(*places.free("force", *names), strict=True))
            if chi2.sf(misfit, max(rows, 1)) >= NOT_EXPLAINED:
                return True
    return False


def residual_of(base: Fit, after: Fit, source: Source) -> Mapping[str, Any] | None:
    """Return what a fit leaves over beyond noise: its share, where it acts most likely, and its size there.

    The share is that of the misfit of the fitted runs beyond noise that the diagram as given leaves. Place: of the
    forces and readings with free harmonics in every run, beside the diagram as given with the values of the fit, the
    one that takes up most; size: root mean square over runs, of the orders that noise alone does not make. None where
    noise explains all.
    """
    if after.failure or is_adequate(after):
        return None
    share = (after.misfit - after.freedom) / max(base.misfit - base.freedom, 1e-300)
    data: dict[str, Any] = {
        "share": 1.0 if after is base else float(min(share, 1.0)),
        "excess_variance": after.misfit / after.freedom,
        "place": None,
        "size": None,
    }
    try:
        best = _best_place(base, after, source)
    except FAILURES:
        best = None
    return data if best is None else {**data, **best}


def _best_place(base: Fit, after: Fit, source: Source) -> dict[str, Any] | None:
    known = {name: value for name, value in after.values.items() if name in base.values}
    diagram = source.load(values_in(base.document, {**base.values, **known}))
    targets = [
        f"{block}.{port.name}"
        for block, node in diagram.nodes.items()
        for port in node.inputs.values()
        if isinstance(port.declaration, In) and port.declaration.additive
    ]
    experiment = source.open(diagram, inject=targets)
    if not experiment.motion.is_linear:
        return None
    likelihood = Likelihood(experiment)
    runs = Held(source.recording, source.harmonics)
    fitted = predict(values_in(after.document, after.values), source, runs)
    if fitted.experiment.predicted != experiment.predicted:
        return None
    count = likelihood.c
    D = fitted.likelihood.data[:, :, :count] - fitted.evaluation.Y[:, :, :count]
    if D.shape[:2] != (len(experiment.runs), likelihood.orders) or not np.isfinite(D).all():
        return None
    transfer = likelihood.response(experiment.theta0).transfer()
    best: tuple[float, dict[str, Any]] | None = None
    for place, H in _places(diagram, targets, transfer, experiment.predicted):
        gain, size = _taken(likelihood, D, H)
        if size and (best is None or gain > best[0]):
            rms = float(np.sqrt(sum(value**2 for value in size.values())))
            orders = {str(k): value for k, value in size.items()}
            unit = place.pop("unit")
            best = gain, {"place": place, "size": {"value": rms, "unit": unit, "orders": orders}}
    return None if best is None else best[1]


def _places(
    diagram: Diagram, targets: Sequence[str], transfer: np.ndarray, predicted: Sequence[str]
) -> list[tuple[dict[str, Any], np.ndarray]]:
    """Return places with what unit harmonics there change in the predicted channels, (R, orders, c, axes)."""
    found: list[tuple[dict[str, Any], np.ndarray]] = []
    at = 0
    for name in targets:
        block, _, key = name.partition(".")
        port = diagram.nodes[block].inputs[key]
        width = port.shape[-1] if port.shape else 1
        size = int(np.prod(port.shape)) if port.shape else 1
        for node in range(size // width):
            place = {"block": block, "port": key, "node": node + 1 if size > width else None, "unit": port.unit or ""}
            found.append((place, transfer[..., at + node * width : at + (node + 1) * width]))
        at += size
    groups: dict[tuple[str, int | None], list[int]] = {}
    for c, name in enumerate(predicted):
        port_name, _, index = name.partition("[")
        parts = index.rstrip("]").split(",") if index else []
        groups.setdefault((port_name, int(parts[0]) if len(parts) > 1 else None), []).append(c)
    for (port_name, at_node), columns in groups.items():
        block, _, key = port_name.rpartition(".")
        unit = diagram.nodes[block].outputs[key].unit if block in diagram.nodes else ""
        one = np.zeros((*transfer.shape[:3], len(columns)), complex)
        for v, c in enumerate(columns):
            one[:, :, c, v] = 1.0
        found.append(({"block": block, "port": key, "node": at_node, "unit": unit or ""}, one))
    return found


def _taken(likelihood: Likelihood, D: np.ndarray, H: np.ndarray) -> tuple[float, dict[int, float]]:
    """Return the misfit beyond chance that free harmonics take up, and the rms of each order that noise does not make.

    D (R, orders, c): left over; H (R, orders, c, axes): by unit harmonics.
    """
    R, width = len(D), H.shape[-1]
    gain, sizes = 0.0, {}
    for k in range(1, likelihood.orders):
        taken, squares = 0.0, 0.0
        for r in range(R):
            columns = np.concatenate([H[r, k], 1j * H[r, k]], axis=1)
            white = likelihood.white_at(r, k, np.column_stack([columns, D[r, k]]))
            factors = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=1e-10)[0]
            taken += float(np.sum((white[:, :-1] @ factors) ** 2))
            squares += float(np.sum(factors**2))
        gain += taken - 2 * width * R
        if chi2.sf(taken, 2 * width * R) < CHANCE / likelihood.orders:
            sizes[k] = float(np.sqrt(2 * squares / R))
    return gain, sizes
