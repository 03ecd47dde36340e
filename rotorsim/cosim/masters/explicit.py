"""Explicit masters, Jacobi and Gauss-Seidel: every step is taken once; one rate or several."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.inputs import Held, InputHistory, Polynomial, through
from rotorsim.cosim.loop import FastLoop
from rotorsim.cosim.masters.master import Schedule, Settings, Trajectory
from rotorsim.cosim.masters.stepping import SteppingMaster
from rotorsim.cosim.participant import Participant
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.runtime.failure import FmuError


@dataclass(frozen=True)
class _Source:
    """What participant a gives to another: wires of its moving and of its held outputs; stride between points."""

    a: int
    moving: np.ndarray | None
    held: np.ndarray | None
    stride: int


class ExplicitMaster(SteppingMaster):
    """Steps every participant once, with extrapolated inputs (order 0: held, 1: linear, 2: quadratic).

    rates: how many base steps each participant takes at once; in between, its outputs are extrapolated (held ones
    held). Signals are read at points that are as far apart as the slower of the two participants steps.
    """

    @property
    @abstractmethod
    def sequence(self) -> Sequence[int] | None:
        """The participants, one after the other; None: all at once."""

    def __init__(self, coupling: Coupling[Participant], settings: Settings) -> None:
        rates = tuple(settings.rates or [1] * len(coupling.participants))
        self._sources = [_sources(coupling, k, rates) for k in range(len(rates))]
        widest = max((s.stride for sources in self._sources for s in sources), default=1)
        super().__init__(coupling, settings, settings.order or 0, widest)
        if not 0 <= self.degree <= 2:
            hint = "0 holds the inputs, 1 linear, 2 quadratic; 3 for the iterative master"
            raise RotorsimError(Problem(f"extrapolation order {settings.order}", self.name, hint=hint))
        self.plain = False  # steps are plain: all at one rate, with held inputs
        self._rows = [(coupling.L[rows], coupling.u0[rows]) for rows in coupling.u_parts]

    # -- the run -------------------------------------------------------------------------------------------------------

    def run(self, schedule: Schedule, first: np.ndarray) -> Trajectory:
        """Take plain steps where these do the same, and in C where that does the same as those, or is asked for."""
        self.plain = schedule.adaptive is None and self.is_plain()
        if schedule.fast and self.degree == 0:
            return self._run_in_c(schedule, first, 0)
        if self.plain and self.may_be_in_c(schedule):
            return self._run_in_c(schedule, first, len(self.coupling.u0) + 2 if self.coupling.passes else 0)
        made = super().run(schedule, first)
        return replace(made, mismatch=_held_mismatch(self.coupling, made.rows)) if self.plain else made

    def is_plain(self) -> bool:
        """Return whether all step at one rate with inputs that are held, and none is looked back at."""
        return self.degree == 0 and max(self.rates) == 1 and not self.sampling

    def may_be_in_c(self, schedule: Schedule) -> bool:
        """Return whether the loop in C does just what plain steps do.

        Not with algebraic loops, where a part samples (it is stopped there), where steps must be equal to the last
        bit, or where messages are wanted as they come.
        """
        step, end, coupling = schedule.step, schedule.end, self.coupling
        whole = abs(round(end / step) * step - end) <= 1e-9 * step
        alike = all(p.loop_is_exact and not p.has_log for p in coupling.participants)
        members = [member for p in coupling.participants if (member := p.in_loop())]
        return whole and alike and not (coupling.passes and coupling.has_loop) and FastLoop.possible(members)

    def _run_in_c(self, schedule: Schedule, first: np.ndarray, sweeps: int) -> Trajectory:
        coupling, step, end = self.coupling, schedule.step, schedule.end
        count = round(end / step)
        if abs(count * step - end) > 1e-6 * step:
            hint = f"such as --step '{end / count:.15g} s'"
            what = f"takes whole steps: {step:g} s does not divide {end:g} s"
            raise RotorsimError(Problem(what, "the fast loop", hint=hint))
        members = [member for p in coupling.participants if (member := p.in_loop())]
        (fu, ou), (fy, oy) = coupling.scales
        L, u0 = coupling.L * fy / fu[:, None], (coupling.L @ oy + coupling.u0 - ou) / fu  # in the units of the FMUs
        loop, failure = FastLoop(members, L, u0, self.sequence, sweeps), None
        loop.begin((first - oy) / fy)
        try:
            made = loop.run(0.0, step, count, end=end, progress=schedule.progress)
        except FmuError as error:
            failure, made = error, loop.rows
        rows = np.vstack([first, made * fy + oy])
        times = np.minimum(np.arange(len(rows)) * step, end)
        self.counters |= {"steps": len(made), "participant_steps": len(made) * len(members)}
        for participant in coupling.participants:
            participant.do_steps, participant.most_parts = len(made), 1
        self.known = [[(times[-1], rows[-1][part])] for part in coupling.y_parts]
        found = self.with_last(Trajectory(times, rows, np.zeros(len(rows)), failure))
        return replace(found, mismatch=_held_mismatch(coupling, found.rows))

    # -- steps ---------------------------------------------------------------------------------------------------------

    def step(self, t: float, h: float, *, last: bool = False) -> tuple[np.ndarray, np.ndarray]:
        if self.plain:
            return self._plain_step(t + h)
        coupling = self.coupling
        if self.tick == 0 and self.degree > 1 and coupling.has_rates:
            self._look_back(t, h)
        self.tick += 1
        due = [k for k, rate in enumerate(self.rates) if last or self.tick % rate == 0]
        foreseen = self.foreseen(t + h)  # outputs of those that are behind are what the others see of them
        u, y = self._accept(t + h, self._advance(due, t + h, foreseen.copy()), due)
        self._compare(u, coupling.inputs_of(foreseen))
        return u, y

    def _plain_step(self, end: float) -> tuple[np.ndarray, np.ndarray]:
        """Advance all from their last point to the end with held inputs; return inputs and outputs there."""
        coupling, known = self.coupling, self.known
        y = np.concatenate([points[-1][1] for points in known])
        seen = y if self.sequence is not None else y.copy()
        for k in range(len(known)) if self.sequence is None else self.sequence:
            start, (L, u0) = self.since[k], self._rows[k]
            y[coupling.y_parts[k]] = coupling.participants[k].step(start, end - start, Held(L @ seen + u0))
        u = coupling.inputs_of(y)
        if coupling.passes:
            u, y = coupling.consistent(end, u, y, range(len(known)))
        for points, part in zip(known, coupling.y_parts, strict=True):
            points[:] = [(end, y[part])]
        self.since = [end] * len(known)
        self.counters["steps"] += 1
        self.counters["participant_steps"] += len(known)
        return u, y

    def _look_back(self, t: float, h: float) -> None:
        """Put points before the start by the rates of the signals there: the first step is then not a held one."""
        coupling = self.coupling
        if any(len(points) > 1 for points in self.known):
            return
        u = coupling.inputs_of(np.concatenate([points[0][1] for points in self.known]))
        rate = coupling.consistent_rates(t, u, np.zeros_like(u))
        for k, part in enumerate(coupling.u_parts):
            moving = coupling.participants[k].output_rate(t, u[part], rate[part])
            (_, y), apart = self.known[k][0], h * self.rates[k]
            self.known[k] = [(t - j * apart, y - j * apart * moving) for j in range(self.widest, 0, -1)] + self.known[k]

    @abstractmethod
    def _advance(self, due: Sequence[int], end: float, y: np.ndarray) -> np.ndarray:
        """Advance participants to the end; return y with their outputs in it."""

    def _step_one(self, k: int, end: float, until: float | None) -> np.ndarray:
        """Advance one participant with what is known until a time (None: all that is)."""
        start = self.since[k]
        self.counters["participant_steps"] += 1
        return self.coupling.participants[k].step(start, end - start, self._inputs(k, start, end - start, until))

    def _inputs(self, k: int, start: float, h: float, until: float | None) -> InputHistory:
        """Return the inputs of participant k from start to start + h."""
        total = [self.coupling.u0[self.coupling.u_parts[k]]]
        for source in self._sources[k]:
            if source.held is not None:
                known = self.known[source.a]
                newest = next((y for time, y in reversed(known) if time <= start), known[0][1])
                total[0] = total[0] + source.held @ newest
            if source.moving is not None:
                terms = [source.moving @ c for c in through(self._points_of(source.a, source.stride, until), start, h)]
                total += [np.zeros_like(terms[0])] * (len(terms) - len(total))
                for power, term in enumerate(terms):
                    total[power] = total[power] + term
        return Polynomial(total, h) if len(total) > 1 else Held(total[0])


class Jacobi(ExplicitMaster):
    """All participants step at once with what is known at the start of their steps."""

    name = "jacobi"
    sequence = None

    def _advance(self, due: Sequence[int], end: float, y: np.ndarray) -> np.ndarray:
        for k in due:
            y[self.coupling.y_parts[k]] = self._step_one(k, end, self.since[k])
        return y


class GaussSeidel(ExplicitMaster):
    """Participants step one after the other; those that come later see the new outputs of the earlier ones."""

    name = "gauss_seidel"

    @property
    def sequence(self) -> Sequence[int]:
        return self.coupling.order

    def _advance(self, due: Sequence[int], end: float, y: np.ndarray) -> np.ndarray:
        for k in self.coupling.order:
            if k in due:
                part = self.coupling.y_parts[k]
                y[part] = self._step_one(k, end, None)
                self._note(k, end, y[part].copy())
        return y


def _sources(coupling: Coupling[Participant], k: int, rates: Sequence[int]) -> list[_Source]:
    """Return what gives something to participant k."""
    rows, found = coupling.u_parts[k], []
    for a, columns in enumerate(coupling.y_parts):
        wires = [L[rows, columns] for L in (coupling.moving_wires, coupling.held_wires)]
        moving, held = (L if L.any() else None for L in wires)
        if moving is not None or held is not None:
            found.append(_Source(a, moving, held, -(-rates[k] // rates[a])))
    return found


def _held_mismatch(coupling: Coupling[Participant], rows: np.ndarray) -> np.ndarray:
    """Return of rows of outputs (n, n_y) the mismatch of each step, inputs held: |u_k - u_(k-1)| / max |u|."""
    with np.errstate(over="ignore", invalid="ignore"):  # where a run diverges
        u = rows @ coupling.L.T + coupling.u0
        largest = np.maximum.accumulate(np.abs(u[1:]), axis=0)
        relative = np.abs(np.diff(u, axis=0)) / np.where(largest > 0, largest, 1.0)
    return np.concatenate([[0.0], relative.max(axis=1, initial=0.0)])
