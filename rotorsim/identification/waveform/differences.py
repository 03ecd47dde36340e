"""Jacobians of output errors by central differences, where exact sensitivities of steps are not to be believed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.search import OutputErrorSearch

DIFFERENCE = 1e-3  # of an unknown: what it changes is far above what a level at zero jitters, and its square far below
AS_TOLD = 0.01  # of the change that a Jacobian tells: it falls as the square of DIFFERENCE where laws are smooth
LEAST_CHANGE = (
    1e-4  # of the change by the strongest column, which one must reach to be judged with it: far above rounding
)


def by_differences(search: OutputErrorSearch, here: Evaluation) -> Evaluation:
    """Return an evaluation whose Jacobians are central differences where the exact ones are not to be believed.

    Over `DIFFERENCE` of each unknown, or less where that changes more than the residual. A level that stays at zero
    crosses it in every step, each time with the derivative of the root there: exact sensitivities of the steps grow
    beyond all bounds, and say that the parameters are known to the last digit. Exact are those that are right together,
    of unknowns that show; the others are replaced one by one.
    """
    size = DIFFERENCE * np.abs(here.unknowns)
    change = np.sqrt(np.maximum(np.diag(here.information), 0.0)) * size
    size = size / np.maximum(change / np.sqrt(max(here.cost, 1e-300)), 1.0)
    change = np.minimum(change, np.sqrt(here.cost))
    shown = change >= LEAST_CHANGE * change.max(initial=0.0)
    equal = np.where(shown, size * change[shown].min(initial=np.inf) / np.where(shown, change, 1.0), 0.0)
    right = shown & (here.unknowns != 0) if _is_slope(search, here, equal) else np.zeros(len(size), bool)
    wrong = np.flatnonzero((here.unknowns != 0) & ~right)
    if not len(wrong):
        return here
    jacobians = [[part.copy() for part in own] for own in here.jacobians]
    for j in wrong.tolist():
        move = np.zeros(len(here.unknowns))
        move[j] = DIFFERENCE * abs(here.unknowns[j])
        if up := _moved_by(search, here, move):
            parts = (search.root(k, r) * np.nan_to_num(up[k][r] - here.residuals[k][r]) for k, r in search.pairs)
            move /= max(np.sqrt(sum(float((part**2).sum()) for part in parts) / max(here.cost, 1e-300)), 1.0)
        up, down = _moved_by(search, here, move), _moved_by(search, here, -move)
        for k, r in search.pairs if up and down else ():
            own = np.flatnonzero(search.columns(k, r) == j)
            jacobians[k][r][:, :, own] = ((up[k][r] - down[k][r]) / (2 * move[j]))[:, :, None]
    return search.summed(here.unknowns, here.sub, here.residuals, jacobians)


def _is_slope(search: OutputErrorSearch, here: Evaluation, size: np.ndarray) -> bool:
    """Return whether the residual changes as its exact Jacobian says where unknowns move together.

    Each by a size that makes as much of a change as the others do, up and down in turn, to AS_TOLD of the change.
    """
    move = size * np.where(np.arange(len(size)) % 2, -1.0, 1.0)
    up, down = _moved_by(search, here, move), _moved_by(search, here, -move)
    if not (up and down):
        return False
    off = told = 0.0
    for k, r in search.pairs:
        root, slope = search.root(k, r), here.jacobians[k][r] @ move[search.columns(k, r)]
        off += float(((root * np.nan_to_num((up[k][r] - down[k][r]) / 2 - slope)) ** 2).sum())
        told += float(((root * np.nan_to_num(slope)) ** 2).sum())
    return off <= AS_TOLD**2 * told


def _moved_by(search: OutputErrorSearch, here: Evaluation, move: np.ndarray) -> Sequence[Sequence[np.ndarray]]:
    """Return the residuals after a move, where laws go on beyond where they are defined; () where it diverges."""
    return search.unlimited.evaluate(here.unknowns + move, here.sub, False).residuals
