"""Fits of diagrams to order vectors over the speed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.stats import f as fisher

from rotorsim.diagnosis.evidence.fit import Effort, Fit, Starts
from rotorsim.diagnosis.evidence.orders.noise import DETERMINED_BY_ROWS, RowNoise
from rotorsim.diagnosis.evidence.waveform.first_order import FirstOrder
from rotorsim.identification.in_orders import refuse_fast
from rotorsim.identification.waveform.estimate import PART
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.noise import Stretch, independent_stretches, products_of
from rotorsim.identification.waveform.noise_model import SIMULATION_DIVERGES
from rotorsim.identification.waveform.order_tracking import OrderSearch
from rotorsim.identification.waveform.search import MOST_SIMULATIONS
from rotorsim.model.heard import surviving

FIRST_STEPS = 4  # from each start, before the best is followed
FOLLOWED = 3  # starts of a law: those that promise most
REFINED_EVALUATIONS = 4  # for one that is asked for: they are cheap


def fitted(
    document: Mapping[str, Any],
    search: OrderSearch,
    noise: Mapping[str, RowNoise],
    starts: Starts,
    effort: Effort,
    old: Collection[str],
) -> Fit:
    """Return the best fit of a document from those of all starts that promise most; old: names that are no effect."""
    first = search.first()
    refuse_fast(search, first)
    every = [start for group in starts for start in group] or [{}]
    begun = [*surviving(lambda point: search.minimise(point, FIRST_STEPS), _points(search, first, every, old))]
    begun = [one for one in begun if np.isfinite(one.cost)]
    if not begun:
        return Fit(document, failure=SIMULATION_DIVERGES)
    limit = MOST_SIMULATIONS if effort.most is None else REFINED_EVALUATIONS * effort.most
    return summary(document, search, search.minimise(min(begun, key=attrgetter("cost")).unknowns, limit), noise)


def promised(search: OrderSearch, starts: Starts, old: Collection[str]) -> float:
    """Return the misfit that the sensitivities promise at the best start of an effect; see `FirstOrder`."""
    own = [start for group in starts for start in group if not old & start.keys()]
    return FirstOrder(search, search.first(), own or [{}], old).promise


def _points(
    search: OrderSearch, first: np.ndarray, starts: Sequence[Mapping[str, float]], old: Collection[str]
) -> list[np.ndarray]:
    """Return the points from which a law is followed: the best of its own starts, and beside the diagram as given."""
    own = [start for start in starts if not old & start.keys()]
    beside = [start for start in starts if old & start.keys()]
    points = FirstOrder(search, first, own, old).points(FOLLOWED) if own else []
    best = points[0] if points else first
    points += [search.stated(best, {k: v for k, v in start.items() if k in old}) for start in beside[:1]]
    return [*{point.tobytes(): point for point in points}.values()]


def summary(document: Mapping[str, Any], search: OrderSearch, end: Evaluation, noise: Mapping[str, RowNoise]) -> Fit:
    """Return a fit from the end of a search."""
    if not np.isfinite(end.reached().cost):
        return Fit(document, failure=SIMULATION_DIVERGES)
    count, stretches = len(search.free), stretches_of(search)
    products = products_of(search, end, stretches)
    at_bound = search.at_bound(end.unknowns)
    covariance = covariance_of(search, end)
    misfit, equations = float(products.squares.sum()), equations_of(search)
    freedom = max(equations - int((~at_bound).sum()), 1)
    return Fit(
        document=document,
        free=search.free,
        theta=end.unknowns[:count],
        covariance=covariance[:count, :count],
        at_bound=at_bound[:count],
        misfit=misfit,
        rows=max(equations - search.constants, 1),
        equations=equations,
        run_misfit=products.squares,
        left_out=products.of(np.flatnonzero(~at_bound)).left_out(),
        goodness=float(fisher.sf(misfit / freedom, freedom, known_rows(noise))),
    )


def known_rows(noise: Mapping[str, RowNoise]) -> float:
    """Return how many independent real numbers the level of the noise is known from."""
    return sum(one.rows for one in noise.values())


def equations_of(search: OrderSearch) -> int:
    """Return the number of measured real numbers."""
    return sum(int(np.isfinite(measured).sum()) for measured in search.measured[0])


def stretches_of(search: OrderSearch) -> tuple[Stretch, ...]:
    """Return the stretches of rows into which runs are divided."""
    return independent_stretches([np.isfinite(measured).any(axis=1) for measured in search.measured[0]])


def covariance_of(search: OrderSearch, end: Evaluation) -> np.ndarray:
    """Return the covariance of all unknowns (q, q), zero at bounds, infinite where the data say nothing."""
    searched = ~search.at_bound(end.unknowns)
    information = end.information[np.ix_(searched, searched)]
    size = np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1.0))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    known = values > DETERMINED_BY_ROWS * max(float(values.max(initial=0.0)), 1.0)
    spread = vectors[:, known] / size[:, None]
    own = spread / values[known] @ spread.T
    open_ones = (np.abs(vectors[:, ~known]) > PART).any(axis=1)
    own[open_ones] = own[:, open_ones] = np.inf
    covariance = np.zeros_like(end.information)
    covariance[np.ix_(searched, searched)] = own
    return covariance
