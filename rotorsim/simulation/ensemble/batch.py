"""A few runs of an ensemble: side by side in lanes, or one by one where that cannot be; how each ended.

What is decided for all together is that a run is fine, or that a linear machine is unstable. Whatever looks otherwise
is simulated once more by itself, and what `simulate` says of it holds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.linear.linearisation import jacobians
from rotorsim.linear.stability import growing, step_factor
from rotorsim.model.compiled import Model
from rotorsim.model.emit.toolchain import CompilerError, find_compiler, lane_width
from rotorsim.model.input_limits import input_limits
from rotorsim.model.lanes import LaneLibrary, Lanes, Reduced
from rotorsim.simulation.ensemble.reductions import LARGEST, LEAST, SQUARES, Columns, Moments, Wanted, reduce_rows
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import LARGEST_RESIDUAL, simulate
from rotorsim.simulation.validity import (
    LARGEST_ERROR,
    WHOLE_NUMBER,
    growth_of,
    mean_jacobian,
    relative_to,
    stretches_of,
)

SURELY_FINE = 0.9  # of LARGEST_ERROR, as the rms is that of all rows here, not of every few
CHUNK = 20_000  # steps between two looks at Ctrl-C
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Setup:
    """What all runs of an ensemble share. angle: name of the shaft angle, empty where there is none.

    names: signals that are kept; watched: those, and the ones that have limits.
    """

    model: Model
    names: tuple[str, ...]
    angle: str
    n_steps: int
    every: int
    method: str
    wanted: Wanted
    use_compiler: bool = True

    @property
    def with_end(self) -> bool:
        """Whether the end of a run is a recorded row."""
        return self.n_steps % self.every == 0


@dataclass(eq=False)
class Outcome:
    """How n runs ended: status, message, step_error (n,); values: kind -> signal -> (n, ...); how many ran alone."""

    status: list[str]
    message: list[str]
    step_error: np.ndarray
    values: dict[str, dict[str, np.ndarray]]
    alone: int = 0


def recorded_columns(model: Model, names: tuple[str, ...], angle: str, radii: bool) -> tuple[list[ca.SX], Columns]:
    """Return the expressions of a row, and where things lie in it; the residuals of loops come behind."""
    expressions: list[ca.SX] = []
    size = 0

    def add(expression: ca.SX) -> slice:
        nonlocal size
        expressions.append(expression)
        size += expression.numel()
        return slice(size - expression.numel(), size)

    signals = {name: (add(model.expression(name)), model.shape_of(name)) for name in names}
    distances = {}
    for name, (_, shape) in signals.items():
        if radii and shape[-1:] == (2,):
            x, y = (model.expression(name)[k::2] for k in (0, 1))
            distances[name] = add(ca.sqrt(x**2 + y**2)), shape[:-1]
    at = (0, 0, 0)
    if angle:
        theta = model.expression(angle)
        at = (add(ca.cos(theta)).start, add(ca.sin(theta)).start, add(theta).start)
    loops = model.trace.loop_residuals.numel()
    return expressions, Columns(signals, distances, at, slice(size, size + loops), size + loops)


@dataclass(frozen=True, eq=False)
class Values:
    """What tells one run from the others: parameters by name, length of the step [s], initial states or None."""

    parameters: Mapping[str, Any]
    step: float
    initial: np.ndarray | None = None


class Runner:
    """Runs of one ensemble in this process; what is compiled for them is kept."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup

    @cached_property
    def library(self) -> LaneLibrary | None:
        """The compiled lanes, None where runs go one by one; `why_alone` says why."""
        return None if self.why_alone else self._compiled

    @cached_property
    def why_alone(self) -> str:
        """Why all runs go one by one, empty where they go side by side."""
        setup = self.setup
        if any(node.block.opaque for node in setup.model.diagram.nodes.values()):
            return "a part of the diagram is an FMU"
        if setup.method != "rk4":
            return f"{setup.method} chooses the steps of every run by itself"
        if not setup.use_compiler or find_compiler() is None:
            return "there is no C compiler" if setup.use_compiler else "no compiler is wanted"
        return "" if self._compiled is not None else "the C compiler failed"

    @cached_property
    def _compiled(self) -> LaneLibrary | None:
        setup, compiler = self.setup, find_compiler()
        expressions, columns = recorded_columns(
            setup.model, tuple(setup.wanted.columns.signals), setup.angle, bool(setup.wanted.columns.radii)
        )
        assert compiler is not None
        assert columns == setup.wanted.columns
        try:
            return LaneLibrary(setup.model, expressions, compiler, lane_width(compiler))
        except CompilerError as failure:
            failure.warn("the runs go one by one on CasADi's virtual machine: the same numbers, many times slower")
            return None

    @property
    def path(self) -> str:
        """How the runs go, in words."""
        if self.library is None:
            return f"one by one: {self.why_alone}"
        lanes = f"{self.library.width} side by side" if self.library.width > 1 else "one by one"
        return f"{lanes}, C ({self.library.compiler})"

    def run(self, runs: Sequence[Values], progress: Progress | None = None) -> Outcome:
        """Perform runs; progress: called with the fraction done. Raises RotorsimError for values that do not fit."""
        model = self.setup.model
        p = np.array([model.parameter_vector(run.parameters) for run in runs]).reshape(len(runs), model.n_p)
        width = self.library.width if self.library else 1
        parts = []
        for first in range(0, len(runs), width):
            group = runs[first : first + width]
            told = None if progress is None else partial(_share, progress, first, len(group), len(runs))
            if self.library is not None and self._in_step(group, p[first : first + width]):
                parts.append(self._side_by_side(self.library, group, p[first : first + width], told))
            else:
                parts += [self._alone(run, told if len(group) == 1 else None) for run in group]
        return joined(parts)

    def _in_step(self, group: Sequence[Values], p: np.ndarray) -> bool:
        """Return whether all samplers of a group hit together."""
        periods = [sampler.period for sampler in self.setup.model.trace.samplers]
        return not periods or bool(
            (p[:, periods] == p[0, periods]).all() and all(run.step == group[0].step for run in group)
        )

    # -- one by one ------------------------------------------------------------------------------------------------

    def _alone(self, run: Values, progress: Progress | None = None) -> Outcome:
        """Simulate one run and reduce its rows."""
        result = self._simulated(run, progress)
        wanted, columns = self.setup.wanted, self.setup.wanted.columns
        rows = np.full((wanted.rows.n, columns.n), np.nan)
        if len(result.time) == wanted.rows.n:
            for name, (part, _) in columns.signals.items():
                rows[:, part] = result[name].reshape(len(rows), -1)
            for name, (part, _) in columns.radii.items():
                rows[:, part] = np.abs(result.complex(name)).reshape(len(rows), -1)
            if self.setup.angle:
                theta = result[self.setup.angle]
                rows[:, list(columns.angle)] = np.array([np.cos(theta), np.sin(theta), theta]).T
            rows[:, columns.residuals] = 0.0
        with np.errstate(invalid="ignore"):
            values = wanted.values(reduce_rows(wanted, rows))
        error = np.array([result.counters.get("step_error", np.nan)])
        return Outcome([result.status], [result.message], error, values, 1)

    def _simulated(self, run: Values, progress: Progress | None = None) -> Result:
        setup = self.setup
        angle = (setup.angle,) if setup.angle else ()
        return simulate(
            setup.model,
            parameters=run.parameters,
            stop=setup.n_steps * run.step,
            step=run.step,
            method=setup.method,
            record=tuple(dict.fromkeys((*setup.wanted.columns.signals, *angle))),
            record_every=setup.every,
            initial=run.initial,
            progress=progress or _silent,
            use_compiler=setup.use_compiler,
        )

    # -- side by side ----------------------------------------------------------------------------------------------

    def _side_by_side(
        self, library: LaneLibrary, group: Sequence[Values], p: np.ndarray, progress: Progress | None
    ) -> Outcome:
        """Run as many as there are lanes; lanes that are left repeat the last run."""
        setup, model = self.setup, self.setup.model
        n = len(group)
        lane = np.minimum(np.arange(library.width), n - 1)
        lanes = Lanes(library, p[lane], np.array([group[k].step for k in lane]), setup.wanted.reduction)
        starts = [model.initial(one) for one in p]
        x = np.array([z[0] if run.initial is None else run.initial for run, z in zip(group, starts, strict=True)])
        z = np.array([start[1] for start in starts])
        lanes.start(x.reshape(n, -1)[lane], z.reshape(n, -1)[lane])
        ahead, saved, at = stretches_of(setup.n_steps), [], 0
        while at < setup.n_steps:
            for stretch in ahead:
                if stretch[0] == at:
                    saved.append((*stretch, lanes.save()))
            until = min(at + CHUNK, setup.n_steps, *(first for first, _ in ahead if first > at))
            reached = lanes.run(at, until, setup.every)
            if reached < until:
                break
            at = until
            if progress is not None:
                progress(at / setup.n_steps)
        kept = lanes.end(setup.with_end and at == setup.n_steps)
        with np.errstate(all="ignore"):
            values = setup.wanted.values(kept)
            status, message, error = self._judged(lanes, kept, saved, group, p, at)
        values = {kind: {name: array[:n] for name, array in of.items()} for kind, of in values.items()}
        alone = 0
        for k in (k for k in range(n) if not status[k]):
            result = self._simulated(group[k])
            status[k], message[k], alone = result.status, result.message, alone + 1
            error[k] = result.counters.get("step_error", error[k])
            if len(result.time) < setup.wanted.rows.n:
                for array in (array for of in values.values() for array in of.values()):
                    array[k] = np.nan
        return Outcome(status, message, error, values, alone)

    def _judged(
        self,
        lanes: Lanes,
        kept: Reduced,
        saved: Sequence[tuple[int, int, np.ndarray]],
        group: Sequence[Values],
        p: np.ndarray,
        reached: int,
    ) -> tuple[list[str], list[str], np.ndarray]:
        """Return status, message and error of the step of every run of a group; status "" where one must run alone."""
        setup, model, n = self.setup, self.setup.model, len(group)
        end, h = setup.n_steps * np.array([run.step for run in group]), [run.step for run in group]
        moments = Moments(kept.moments, setup.wanted.reduction.ends)
        doubtful = (lanes.failed[:n] > 0) | (reached < setup.n_steps)
        whole = moments.between(0, setup.wanted.rows.n)[..., :n]
        largest = np.maximum(np.abs(whole[LEAST]), np.abs(whole[LARGEST]))
        doubtful |= ~np.isfinite(whole[SQUARES]).all(axis=0)
        doubtful |= (largest[setup.wanted.columns.residuals] > LARGEST_RESIDUAL).any(axis=0)
        doubtful |= self._beyond_limits(largest, p)
        if doubtful.all():
            return [""] * n, [""] * n, np.full(n, np.nan)
        error = self._step_errors(lanes, saved, whole[SQUARES][: self._entries])
        doubtful |= ~(error <= SURELY_FINE * LARGEST_ERROR)
        rates = self._growth(moments, end)[:n]
        poles = self._poles(p, end, lanes.x.T[:n])
        status, message = ["finished"] * n, [""] * n
        for k in range(n):
            grows = growing(poles[k]) if poles is not None and np.isfinite(poles[k]).all() else None
            if doubtful[k]:
                status[k] = ""
            elif model.linear and grows:
                status[k], message[k] = "unstable", f"the machine is unstable: {grows.describe(model)}"
            elif grows or rates[k] > 0:
                status[k] = ""
            elif model.linear and poles is not None:
                values = np.linalg.eigvals(poles[k])
                if (step_factor(h[k] * values[values.real < 0]) > 1 + WHOLE_NUMBER).any():
                    status[k] = ""
        return status, message, error

    def _beyond_limits(self, largest: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return which runs have an input beyond what its block holds for, by the largest magnitudes (n_y, n)."""
        model, columns = self.setup.model, self.setup.wanted.columns
        beyond = np.zeros(len(p), bool)
        for k, values in enumerate(p):
            for item in input_limits(model.diagram, {name: values[part] for name, part in model.parameters.items()}):
                beyond[k] |= bool((largest[columns.signals[str(item.source)][0], k] >= item.limit).any())
        return beyond

    def _step_errors(
        self, lanes: Lanes, saved: Sequence[tuple[int, int, np.ndarray]], squares: np.ndarray
    ) -> np.ndarray:
        """Return the largest relative error of a signal by the step, (width,), as `validity` estimates it."""
        signals = self.setup.wanted.columns.signals
        worst = np.zeros(squares.shape[1])
        if not signals:
            return worst
        first_entries = [part.start for part, _ in signals.values()]
        rms = np.sqrt(np.add.reduceat(squares, first_entries)[: len(signals)] / self.setup.wanted.rows.n)
        for first, last, before in saved:
            change = lanes.repeat(before, first, last, 1) - lanes.repeat(before, first, last, 2)
            wrong = np.square(change).sum(axis=0)[: self._entries, : len(worst)] * (16 / 15) ** 2
            errors = np.sqrt(np.add.reduceat(wrong, first_entries) / len(change))
            for k in range(len(worst)):
                found = relative_to(self.setup.model, tuple(signals), errors[:, k], rms[:, k]).max()
                worst[k] = max(worst[k], found) if np.isfinite(errors[:, k]).all() else np.inf
        return worst

    @property
    def _entries(self) -> int:
        """How many columns are signals."""
        return max((part.stop for part, _ in self.setup.wanted.columns.signals.values()), default=0)

    def _growth(self, moments: Moments, end: np.ndarray) -> np.ndarray:
        """Return how fast the motion of each run still grows at its end [1/s]."""
        ends = self.setup.wanted.rows.growth_ends
        if ends[1] - ends[0] < 4:
            return np.zeros(len(end))
        parts = np.array([moments.between(*both) for both in pairwise(ends)])
        sizes = parts[:, LARGEST] - parts[:, LEAST]  # (eighths, n_y, width)
        seconds = (ends[1] - ends[0]) * self.setup.every / self.setup.n_steps * end
        return np.array([growth_of(sizes[..., k], seconds[k]) for k in range(len(end))])

    def _poles(self, p: np.ndarray, end: np.ndarray, x: np.ndarray) -> np.ndarray | None:
        """Return d(dx/dt)/dx (n, n_x, n_x) by which runs are judged, None for sampled diagrams."""
        model = self.setup.model
        if model.n_z:
            return None
        if model.linear:
            nothing = np.zeros((model.n_x, len(p)))
            return np.asarray(jacobians(model)["A"](np.zeros((1, len(p))), nothing, np.zeros((0, len(p))), p.T))
        with np.errstate(all="ignore"):
            return np.array([mean_jacobian(model, *values) for values in zip(p, end, x, strict=True)])


def joined(parts: Sequence[Outcome]) -> Outcome:
    """Return the outcomes of several groups as one."""
    values = {
        kind: {name: np.concatenate([part.values[kind][name] for part in parts]) for name in of}
        for kind, of in parts[0].values.items()
    }
    return Outcome(
        [status for part in parts for status in part.status],
        [message for part in parts for message in part.message],
        np.concatenate([part.step_error for part in parts]),
        values,
        sum(part.alone for part in parts),
    )


def _share(progress: Progress, first: int, count: int, total: int, fraction: float) -> None:
    progress((first + count * fraction) / total)


def _silent(fraction: float) -> None:
    """Take the place of a progress bar: with a function to call, Ctrl-C is heard between two parts of a run."""
