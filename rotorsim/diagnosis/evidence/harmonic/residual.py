"""Where the residual of a fit acts: free harmonics of forces and of readings, place by place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit
from rotorsim.diagnosis.evidence.harmonic.bounds import additive_inputs, open_bounds
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.diagnosis.evidence.harmonic.scoring import predict
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.harmonic.likelihood import Likelihood


def free_amplitudes(
    likelihood: Likelihood, r: int, k: int, H: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Return the amplitudes (axes,) at one order of one run that explain most, and the misfit that they take and leave.

    min |W (d - H f)|^2 over complex f; H (c, axes): by unit amplitudes, d (c,): the residual, W: whitening.
    """
    white = likelihood.white_at(r, k, np.column_stack([H, 1j * H, d]))
    parts = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=1e-10)[0]
    explained = white[:, :-1] @ parts
    rest = white[:, -1] - explained
    f = parts[: H.shape[1]] + 1j * parts[H.shape[1] :]
    return f, float(explained @ explained), float(rest @ rest)


def is_force(fit: Fit, runs: HarmonicRuns) -> bool:
    """Return whether free harmonics of a force at some one place explain the residual of a linear diagram.

    Errors of channels, each by itself, are not in displacement and current as the loop demands of a force.
    """
    bounds = open_bounds(fit, runs) if fit.misfit > CRITERIA.slight * fit.freedom else None
    if bounds is None:
        return False
    nodes: dict[tuple[str, str], list[str]] = {}
    for name in bounds.places:
        port, _, index = name.partition("[")
        nodes.setdefault((port, index.rpartition(",")[0]), []).append(name)
    for names in nodes.values():
        misfit, rows = (sum(part) for part in zip(*bounds.free("force", *names), strict=True))
        if chi2.sf(misfit, max(rows, 1)) >= CRITERIA.not_explained:
            return True
    return False


def residual_place(base: Fit, after: Fit, runs: HarmonicRuns) -> dict[str, Any] | None:
    """Return the place of the residual of a fit and its size there: root mean square over runs, of orders beyond noise.

    Of the forces and readings with free harmonics in every run, beside the diagram as given with the values of the fit,
    the one that takes up most.
    """
    known = {name: value for name, value in after.values.items() if name in base.values}
    try:
        diagram = runs.load(values_in(base.document, {**base.values, **known}))
        targets = additive_inputs(diagram)
        experiment = runs.open(diagram, inject=targets)
        if not experiment.motion.is_linear:
            return None
        fitted = predict(values_in(after.document, after.values), runs)
    except FAILURES:
        return None
    likelihood = Likelihood(experiment)
    D = fitted.likelihood.data[:, :, : likelihood.c] - fitted.evaluation.Y[:, :, : likelihood.c]
    alike = fitted.experiment.predicted == experiment.predicted
    if not alike or D.shape[:2] != (len(experiment.runs), likelihood.orders) or not np.isfinite(D).all():
        return None
    transfer = likelihood.response(experiment.theta0).transfer()
    best: tuple[float, dict[str, Any]] | None = None
    for place, unit, H in _places(diagram, targets, transfer, experiment.predicted):
        gain, sizes = taken_at(likelihood, D, H)
        if sizes and (best is None or gain > best[0]):
            rms = float(np.sqrt(sum(value**2 for value in sizes.values())))
            orders = {str(k): value for k, value in sizes.items()}
            best = gain, {"place": place, "size": {"value": rms, "unit": unit, "orders": orders}}
    return None if best is None else best[1]


def _places(
    diagram: Diagram, targets: Sequence[str], transfer: np.ndarray, predicted: Sequence[str]
) -> Iterator[tuple[dict[str, Any], str, np.ndarray]]:
    """Yield places with their units, and what unit harmonics there change in the channels, (R, orders, c, axes)."""
    at = 0
    for name in targets:
        block, _, key = name.partition(".")
        port = diagram.nodes[block].inputs[key]
        width = port.shape[-1] if port.shape else 1
        size = int(np.prod(port.shape)) if port.shape else 1
        for node in range(size // width):
            place = {"block": block, "port": key, "node": node + 1 if size > width else None}
            yield place, port.unit or "", transfer[..., at + node * width : at + (node + 1) * width]
        at += size
    groups: dict[tuple[str, int | None], list[int]] = {}
    for c, name in enumerate(predicted):
        port_name, _, index = name.partition("[")
        parts = index.rstrip("]").split(",") if index else []
        groups.setdefault((port_name, int(parts[0]) if len(parts) > 1 else None), []).append(c)
    for (port_name, at_node), columns in groups.items():
        block, _, key = port_name.rpartition(".")
        unit = diagram.nodes[block].outputs[key].unit if block in diagram.nodes else ""
        ones = np.broadcast_to(np.eye(len(predicted), dtype=complex)[:, columns], (*transfer.shape[:3], len(columns)))
        yield {"block": block, "port": key, "node": at_node}, unit or "", ones


def taken_at(likelihood: Likelihood, D: np.ndarray, H: np.ndarray) -> tuple[float, dict[int, float]]:
    """Return the misfit beyond chance that free harmonics take up, and the rms of each order that noise does not make.

    D (R, orders, c): residual; H (R, orders, c, axes): by unit harmonics.
    """
    R, unknowns = len(D), 2 * H.shape[-1] * len(D)
    gain, sizes = 0.0, {}
    for k in range(1, likelihood.orders):
        every = [free_amplitudes(likelihood, r, k, H[r, k], D[r, k]) for r in range(R)]
        taken = sum(item[1] for item in every)
        gain += taken - unknowns
        if chi2.sf(taken, unknowns) < CRITERIA.chance / likelihood.orders:
            sizes[k] = float(np.sqrt(2 * sum(float((np.abs(item[0]) ** 2).sum()) for item in every) / R))
    return gain, sizes
