"""A few runs of an ensemble: side by side in lanes, or one by one where that cannot be."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from rotorsim.errors import RotorsimError
from rotorsim.model.emit.toolchain import CompilerError, find_compiler, lane_width
from rotorsim.model.instance import LARGEST_NUMBER
from rotorsim.model.lanes import LaneLibrary, Lanes
from rotorsim.simulation.ensemble.reductions import TOO_STEEP, reduce_rows
from rotorsim.simulation.ensemble.shared import Setup, recorded_columns
from rotorsim.simulation.ensemble.verdicts import Reached, joined_runs, verdicts
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import LARGEST_RECORD, simulate
from rotorsim.simulation.validity import stretches_of

REFUSED = "refused"  # a run whose values `simulate` refuses: at last the run is "stopped", or the ensemble is refused
CHUNK = 20_000  # steps between two looks at Ctrl-C
Progress = Callable[[float], None]


@dataclass(eq=False)
class Outcome:
    """How n runs ended: status, message, step_error (n,); values: kind -> signal -> (n, ...); how many ran alone."""

    status: list[str]
    message: list[str]
    step_error: np.ndarray
    values: dict[str, dict[str, np.ndarray]]
    alone: int = 0

    def in_order(self, order: np.ndarray) -> Outcome:
        """Return the runs in another order."""
        values = {kind: {name: array[order] for name, array in of.items()} for kind, of in self.values.items()}
        status, message = ([items[k] for k in order.tolist()] for items in (self.status, self.message))
        return Outcome(status, message, self.step_error[order], values, self.alone)


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
        if self.library is None:
            share = partial(_share, progress) if progress else None
            return joined([self._alone(r, share and partial(share, k, 1, len(runs))) for k, r in enumerate(runs)])
        order: list[int] = []
        parts = []
        for group in self._groups(self.library.width, runs, p):
            told = None if progress is None else partial(_share, progress, len(order), len(group), len(runs))
            parts.append(self._side_by_side(self.library, [runs[k] for k in group], p[group], told))
            order += group
        outcome = self._judged(joined_runs(parts), [runs[k] for k in order], p[order])
        return outcome.in_order(np.argsort(order))

    def _groups(self, width: int, runs: Sequence[Values], p: np.ndarray) -> Iterator[list[int]]:
        """Yield the runs that go side by side: of sampled diagrams those whose samplers hit together."""
        periods = [sampler.period for sampler in self.setup.model.trace.samplers]
        alike: dict[tuple[float, ...], list[int]] = {}
        for k, run in enumerate(runs):
            alike.setdefault((*p[k, periods], run.step) if periods else (), []).append(k)
        for members in alike.values():
            yield from (members[first : first + width] for first in range(0, len(members), width))

    # -- one by one ------------------------------------------------------------------------------------------------

    def _alone(self, run: Values, progress: Progress | None = None) -> Outcome:
        """Simulate one run and reduce its rows."""
        result = self._simulated(run, self.setup.every, progress)
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
            kept = reduce_rows(wanted, rows)
            values = wanted.values(kept)
        error = np.array([result.counters.get("step_error", np.nan)])
        message = result.message or (TOO_STEEP if wanted.too_steep(kept)[0] else "")
        return Outcome([result.status], [message], error, values, 1)

    def _simulated(self, run: Values, every: int, progress: Progress | None = None) -> Result:
        """Simulate one run; one that fails with an error has the status REFUSED, and no rows."""
        setup = self.setup
        angle = (setup.angle,) if setup.angle else ()
        try:
            result = simulate(
                setup.model,
                parameters=run.parameters,
                stop=setup.n_steps * run.step,
                step=run.step,
                method=setup.method,
                record=tuple(dict.fromkeys((*setup.wanted.columns.signals, *angle))),
                record_every=every,
                initial=run.initial,
                progress=progress or _silent,
                use_compiler=setup.use_compiler,
            )
        except RotorsimError as error:
            return Result(np.zeros(0), {}, {}, REFUSED, str(error).removeprefix("error: "))
        if result.status == "stopped" and result.cause != "part":
            raise KeyboardInterrupt
        return result

    # -- side by side ----------------------------------------------------------------------------------------------

    def _side_by_side(
        self, library: LaneLibrary, group: Sequence[Values], p: np.ndarray, progress: Progress | None
    ) -> Reached:
        """Run as many as there are lanes; lanes that are left repeat the last run."""
        setup, n = self.setup, len(group)
        lane = np.minimum(np.arange(library.width), n - 1)
        lanes = Lanes(library, p[lane], np.array([group[k].step for k in lane]), setup.wanted.reduction)
        starts = [setup.model.initial(one) for one in p]
        x = np.array([x0 if run.initial is None else run.initial for run, (x0, _) in zip(group, starts, strict=True)])
        lanes.start(x.reshape(n, -1)[lane], np.array([z0 for _, z0 in starts]).reshape(n, -1)[lane])
        ahead, saved, at = stretches_of(setup.n_steps), [], 0
        while at < setup.n_steps:
            saved += [(*stretch, lanes.save()) for stretch in ahead if stretch[0] == at]
            until = min(at + CHUNK, setup.n_steps, *(first for first, _ in ahead if first > at))
            if lanes.run(at, until, setup.every) < until:
                break
            at = until
            if progress is not None:
                progress(at / setup.n_steps)
        kept = lanes.end(setup.with_end and at == setup.n_steps)
        whole = at == setup.n_steps
        errors = np.full((len(ahead), *kept.last.shape), np.nan)
        if whole:
            with np.errstate(all="ignore"):
                errors[:] = [_rms_errors(lanes, *stretch) for stretch in saved]
        with np.errstate(over="ignore"):
            within = np.abs(lanes.x).sum(axis=0) <= LARGEST_NUMBER  # which the loop looks at in every eighth step
        return Reached(kept, (lanes.failed == 0) & within & whole, errors, lanes.x.copy()).first(n)

    def _judged(self, reached: Reached, runs: Sequence[Values], p: np.ndarray) -> Outcome:
        """Return how runs ended; those whose verdict is not plain run once more by themselves."""
        steps = np.array([run.step for run in runs])
        with np.errstate(all="ignore"):
            values = self.setup.wanted.values(reached.kept)
            status, message, error = verdicts(self.setup, reached, p, steps)
        doubtful = [k for k in range(len(runs)) if not status[k]]
        size = 8.0 * reached.errors.shape[1] * self.setup.wanted.rows.n
        every = self.setup.every * math.ceil(2 * size / LARGEST_RECORD)  # their histories are not kept
        for k in doubtful:
            result = self._simulated(runs[k], every)
            status[k], message[k] = result.status, result.message
            error[k] = result.counters.get("step_error", error[k])
            if result.counters.get("steps", 0) < self.setup.n_steps:  # it has not come to its end
                for array in (array for of in values.values() for array in of.values()):
                    array[k] = np.nan
        return Outcome(status, message, error, values, len(doubtful))


def _rms_errors(lanes: Lanes, first: int, last: int, before: np.ndarray) -> np.ndarray:
    """Return the rms of the error of every column (n_y, width) in a stretch, as `validity` estimates it."""
    change = lanes.repeat(before, first, last, 1) - lanes.repeat(before, first, last, 2)
    return np.asarray(np.sqrt(np.square(change).mean(axis=0)) * 16 / 15)


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
