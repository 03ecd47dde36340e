"""A step of RK4 that holds, for a diagram to which something fast has been added."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.linear.stability import growing, largest_stable_step
from rotorsim.model.compiled import model_for_runs

MOST_PARTS = 100  # of a step: about there radau takes as long (python -m benchmarks.engine.stiff)


def with_stable_step(document: Mapping[str, Any], diagram: Diagram) -> dict[str, Any]:
    """Return the document of a diagram with a step that RK4 is stable with, or radau, where its own is too long."""
    try:
        steps = stable_steps(diagram)
    except RotorsimError:  # a part whose equations are elsewhere fails
        steps = {}
    if not steps:
        return dict(document)
    told = {"step": f"{steps['step']!r} s"} if "step" in steps else {}
    return {**document, "solver": {**document.get("solver", {}), **steps, **told}}


def stable_steps(diagram: Diagram) -> dict[str, Any]:
    """Return the solver's ``step`` [s] and ``record_every`` with which RK4 is stable about the start of a run.

    Where that takes more than MOST_PARTS times as many steps, the ``method`` radau, which is stable with any.

    h / n with the least whole n for which |R(lambda h / n)| <= 1 for all poles lambda, and n times as many steps from
    record to record. Empty where the diagram's own step h is stable, where no smaller one is (a pole grows), and where
    a part hides its equations or samples.
    """
    solver = diagram.solver
    model = model_for_runs(diagram)
    if solver.method != "rk4" or model.hidden or model.n_z or not model.n_x:
        return {}
    p = model.parameter_vector()
    A = np.array(model.jacobian(0.0, model.x0(p), np.zeros(0), p))
    if not np.isfinite(A).all() or growing(A):
        return {}
    n = math.ceil(solver.step / largest_stable_step(np.linalg.eigvals(A)))
    if n > MOST_PARTS:
        return {"method": "radau"}
    return {} if n <= 1 else {"step": solver.step / n, "record_every": solver.record_every * n}
