"""The equations of an FMU for Model Exchange: their values and derivatives, from instances at work.

x' = f(t, x, u; p),   y = g(t, x, u; p),   x(0) = s(u(0); p)

u: entries of the inputs, p: of the parameters, in SI units; x: the states as the FMU has them. Its fixed parameters can
be set before it is initialised alone: every p has an instance of its own, and derivatives by p are central differences
between them. Those by x and u come from its directional or adjoint derivatives, where it offers them for all, else from
central differences.

These are equations of one mode, that in which the FMU begins. Where an event would change it, because an indicator
changes its side or a time event is due, there are none, and that is an error, but for a run that carries events out
(`rotorsim.fmi.mode`).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from rotorsim.errors import Place, RotorsimError
from rotorsim.fmi.compiled import InC
from rotorsim.fmi.derivatives import offered_by, right_ones
from rotorsim.fmi.description.model import FLOATS, ModelDescription
from rotorsim.fmi.instances import Instances, Values
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.slave import TIMEOUT, Slave
from rotorsim.model.heard import GIVEN_UP, is_heard, listener, remark

MOST_PROCESSES = 24  # of one block, those used last
# Values of all parameters whose instances in this process are kept, each with differences by every one: a step of a
# search takes two (where it is, and its trial), and searches for two rivals and the diagram as given take turns.
KEPT_POINTS = 6
RELATIVE_STEP = 6e-6  # cube root of eps, of central differences
VANISHED = 1e-250  # of a value: as zero, whose relative step would be none (a decay that has ended in denormal numbers)
# In a fit: a search begins with a damping of 1e-4, and takes 10 times as much at every trial that fails; at the sixth
# its step is shorter by a factor of 11, and one that still gets no answer ends the fit, a minute of TIMEOUT later.
MOST_HANGS = 6


def size_of(value: float, nominal: float = 1.0) -> float:
    """Return the size over which a value changes: its own, or the nominal one where it has none."""
    return abs(value) if abs(value) > VANISHED else nominal


class FmuEquations:
    """What an FMU for Model Exchange says, with values of its options."""

    def __init__(
        self,
        name: str,
        path: Any,
        description: ModelDescription,
        in_process: bool,
        texts: Mapping[str, Any],
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        parameters: Sequence[Any],
        timeout: float = TIMEOUT,
    ) -> None:
        """Take the ports of inputs, outputs and parameters (`rotorsim.fmi.block.FmuPort`); texts: other values.

        name: of the block, by which failures are told. timeout: for one answer of a process of its own [s].
        """
        self.name, self.description = name, description
        self._u, self._p, y = Values(inputs), Values(parameters), Values(outputs)
        self.instances = Instances(name, path, description, in_process, texts, self._u, self._p, y.names, timeout)
        self.timeout = timeout
        self.n_x = len(description.states)
        self.u_names, self.y_names = self._u.names, y.names
        self.idle = np.nan_to_num(self._u.starts)  # inputs of what does not follow them: the FMU may divide by them
        self.u_scales, self.y_scales = self._u.scales, y.scales
        self.n_u, self.n_y, self.n_p = len(self._u), len(y), len(self._p)
        self._most = 2 * self.n_p + 2  # one, and two for the difference by each parameter, and one that comes
        self._most = KEPT_POINTS * self._most if in_process else min(self._most, MOST_PROCESSES)
        self._once = in_process and description.kinds["me"].once_per_process
        self._most = 1 if self._once else self._most
        self._slaves: OrderedDict[bytes, Slave] = OrderedDict()
        self._begun: dict[int, np.ndarray] = {}  # the states with which they began
        self._starter: Slave | None = None  # begins with other inputs
        self._modes: dict[int, tuple[np.ndarray, float]] = {}  # sides of event indicators, next time event
        self._guarded = True
        self.hangs = False  # whether it ever did
        self.seen = np.zeros(self.n_u + description.n_events)  # raw inputs, indicators, where x' was asked for last
        self.offered, self._checked = offered_by(description, self.u_names, self.y_names), False
        stated = [entry.variable.nominal for entry in description.resolve(description.states)]
        self.nominals = np.array([abs(value) if value else 1.0 for value in stated], float)
        entries = description.resolve(self.y_names)
        shown = [k for k, entry in enumerate(entries) if entry.variable.type == FLOATS[0]]
        self._smooth = shown  # the others, whole numbers, are constant in a mode
        own = self.u_names, [self.y_names[k] for k in shown]
        can = not InC.why_not(description, *own, in_process)
        self.native = InC(description, *own, shown, self.n_p) if can else None
        self.native_row = {k: k for k in range(self.n_x)} | {self.n_x + k: self.n_x + i for i, k in enumerate(shown)}
        structure = description.dependencies
        free = {name for name, v in description.variables.items() if v.causality == "independent"}
        told = [structure.get(name) for name in (*description.derivatives, *self.y_names)]
        self.timed = not free or any(known is None or free & {*known} for known in told)  # may follow the time itself

    # -- values --------------------------------------------------------------------------------------------------------

    def start(self, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the states (n_x,) with which the FMU begins."""
        if self._u.are_starts(u):
            with self._instance(p) as slave:
                return self._begun[id(slave)].copy()
        self._one_alone()
        starter, self._starter = self._starter, None
        self._starter = self.instances.new(u, p) if starter is None else self.instances.again(starter, u, p)
        return self._starter.states()

    def rates(self, t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return x' (n_x,)."""
        with self._instance(p) as slave:
            slope = slave.derivatives(t, x, self._u.of_fmu(u))
            self._look(slave, t, u)
            return slope

    def values(self, t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return y (n_y,), SI."""
        with self._instance(p) as slave:
            self._refuse_time_event(slave, t)
            y = slave.outputs(t, x, self._u.of_fmu(u))
        return np.asarray(self.y_scales[:, 0] * y + self.y_scales[:, 1])

    def both(self, t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return x' and y, (n_x + n_y,)."""
        with self._instance(p) as slave:
            slope, y = slave.evaluate(t, x, self._u.of_fmu(u))
            self._look(slave, t, u)
        return np.concatenate([slope, self.y_scales[:, 0] * y + self.y_scales[:, 1]])

    def jacobian(self, t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray, wanted: Sequence[bool]) -> np.ndarray:
        """Return the derivatives of x' and y by t, x, u and p, (n_x + n_y, 1 + n_x + n_u + n_p).

        wanted: whether those by t, x, u, p; others are zero.
        """
        n_x, n_u = self.n_x, self.n_u
        J = np.zeros((n_x + self.n_y, 1 + n_x + n_u + self.n_p))
        if wanted[1] or wanted[2]:
            J[:, 1 : 1 + n_x + n_u] = self._by_states_and_inputs(t, x, u, p)
        point = [np.array([t]), x, u, p]
        for group, first, one in ((0, 0, wanted[0] and self.timed), (3, 1 + n_x + n_u, wanted[3])):
            for k in range(len(point[group]) if one else 0):
                try:
                    J[:, first + k] = self._column(point, group, k)
                except RotorsimError:  # a whole number, or one that has to stay as it is: perhaps nobody asks for it
                    J[:, first + k] = np.nan
        return J

    def _by_states_and_inputs(self, t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        n_x, n_u = self.n_x, self.n_u
        if not n_x + n_u:
            return np.zeros((n_x + self.n_y, 0))
        if self.offered:
            return self._told(self.offered[0], t, x, u, p)
        point = [np.array([t]), x, u, p]
        columns = [self._column(point, 1, k) for k in range(n_x)] + [self._column(point, 2, k) for k in range(n_u)]
        return np.stack(columns, axis=1)

    def _told(self, kind: str, t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the directional, or adjoint, derivatives of x' and y by x and u."""
        n_x = self.n_x
        unknowns = [*self.description.derivatives, *(self.y_names[k] for k in self._smooth)]
        with self._instance(p) as slave:
            slave.evaluate(t, x, self._u.of_fmu(u))
            found = slave.jacobian(unknowns, [*self.description.states, *self.u_names], kind)
        J = np.zeros((n_x + self.n_y, n_x + self.n_u))
        J[[*range(n_x), *(n_x + k for k in self._smooth)]] = found
        J[n_x:] *= self.y_scales[:, :1]
        J[:, n_x:] /= self.u_scales[:, 0]
        return np.asarray(J)

    def _check_derivatives(self, x: np.ndarray, p: np.ndarray) -> None:
        """Once, where an FMU begins: do without derivatives that it offers and that are not those of its equations."""
        offered, checked, self._checked = self.offered, self._checked, True
        if checked or not offered:
            return
        told = {kind: np.full((self.n_x + self.n_y, self.n_x + self.n_u), np.nan) for kind in offered}
        for kind in offered:
            with suppress(RotorsimError):
                told[kind] = self._told(kind, 0.0, x, self.idle, p)
        self.offered = ()
        try:
            found = self._by_states_and_inputs(0.0, x, self.idle, p)
        except RotorsimError:  # no differences here, such as beside an event: nothing speaks against them
            self.offered = offered
            return
        rows = [*range(self.n_x), *(self.n_x + k for k in self._smooth)]
        self.offered = right_ones(self.name, {kind: J[rows] for kind, J in told.items()}, found[rows])

    def _column(self, point: Sequence[np.ndarray], group: int, k: int) -> np.ndarray:
        """Return the derivative of x' and y by an entry of t, x, u or p."""
        seeds = [np.zeros(len(part)) for part in point]
        seeds[group][k] = 1.0
        return self.difference(self.both, point, seeds)

    def difference(
        self, of: Callable[..., np.ndarray], point: Sequence[np.ndarray], seeds: Sequence[np.ndarray]
    ) -> np.ndarray:
        """Return the central difference of a function of t, x, u, p in a direction of them.

        Over a step that is small beside every entry that moves.
        """
        room = [
            self._scale(group, k, float(point[group][k])) / abs(float(by))
            for group, own in enumerate(seeds)
            for k, by in enumerate(own)
            if by
        ]
        step = RELATIVE_STEP * min(room)
        ends = []
        for sign in (1.0, -1.0):
            t, x, u, p = (one + sign * step * seed for one, seed in zip(point, seeds, strict=True))
            ends.append(of(float(t[0]), x, u, p))
        if not any(seed.any() for seed in seeds[:3]):
            self.know(point[3], seeds[3], step)
        return np.asarray((ends[0] - ends[1]) / (2 * step))

    def _scale(self, group: int, k: int, value: float) -> float:
        """Return the size over which an entry of t, x, u or p changes."""
        return size_of(value, float(self.nominals[k]) if group == 1 else 1.0)

    # -- called from C -------------------------------------------------------------------------------------------------

    def prefer(self, p: np.ndarray) -> None:
        """Let C ask the instance with parameters p, where it can."""
        slave = self._slaves.get(p.tobytes())
        if self.native is not None and slave is not None:
            self._bind(slave)
            self.native.choose(slave, p, *self._modes[id(slave)])

    def completed_callback(self, p: np.ndarray) -> tuple[int, int] | None:
        """Return the addresses of a function of C, and of its context, that tells the instance of a completed step."""
        slave = self._slaves.get(p.tobytes())
        if self.native is None or slave is None:
            return None
        self.prefer(p)
        return self.native.completed_callback(slave, p)

    def know(self, p: np.ndarray, seed: np.ndarray, step: float) -> None:
        """Let C take differences between the instances at p + step seed and p - step seed."""
        slaves = [self._slaves.get((p + sign * step * seed).tobytes()) for sign in (1.0, -1.0)]
        if self.native is not None and None not in slaves:
            ends = [(slave, *self._modes[id(slave)]) for slave in slaves if slave is not None]
            self._bind(ends[0][0])
            self.native.pair(p, seed, ends, step)

    def _bind(self, slave: Slave) -> None:
        if self.native is not None and not self.native.is_bound:
            scales, values = (self.u_scales, self.y_scales[self._smooth]), (self.nominals, self.idle)
            step, seen, kinds = RELATIVE_STEP, self.seen, self.offered
            self.native.bind(slave, scales, *values, step, seen, offered=kinds, timed=self.timed)

    # -- instances -----------------------------------------------------------------------------------------------------

    @contextmanager
    def _instance(self, p: np.ndarray) -> Iterator[Slave]:
        """Give the instance with parameters p (n_p,), initialised; one that fails is not used again."""
        begun = listener().begun
        if self.name not in begun:
            begun[self.name] = p.copy()
        self._refuse_hanging()
        try:
            with self._found(p) as slave:
                yield slave
        except FmuError as error:
            if is_heard():  # in a run they are those of the diagram
                error.add_values(self._p.words(p, begun[self.name]))
            raise

    def _refuse_hanging(self) -> None:
        """Raise FmuError where whoever listens has heard of enough hangs: every one of them costs the time limit."""
        heard = listener().of(self.name, "hang") if self.hangs else None
        if heard is not None and heard.count >= MOST_HANGS:
            first = heard.what.partition("\n")[0]
            what = f"is not asked any more in this fit, in which {MOST_HANGS} times it did not answer; first: {first}"
            hint = 'more time for an answer: "timeout" among the parameters of its block, in s'
            raise FmuError(what, kind=GIVEN_UP, name=self.name, place=Place(str(self.instances.path)), hint=hint)

    @contextmanager
    def _found(self, p: np.ndarray) -> Iterator[Slave]:
        key = p.tobytes()
        slave = self._slaves.get(key)
        if slave is None:
            slave = self._made(p)
            try:
                sides = slave.event_indicators(0.0, None) > 0 if self.description.n_events else np.zeros(0, bool)
                if self.native is not None:
                    self.native.serve(slave)
            except BaseException:
                slave.free()
                raise
            self._slaves[key], self._modes[id(slave)] = slave, (sides, slave.last_event().next_time)
            self._begun[id(slave)] = slave.states()
            self._check_derivatives(slave.states(), p)
        elif len(self._slaves) > 1:
            self._slaves.move_to_end(key)
        try:
            yield slave
        except BaseException as error:
            self.hangs = self.hangs or getattr(error, "kind", "") == "hang"
            if getattr(error, "kind", "") != "event":
                self._free(self._slaves.pop(key))
            raise

    def _made(self, p: np.ndarray) -> Slave:
        """Return another instance, in the place of the one that was used longest ago where there are enough."""
        self._one_alone()
        if len(self._slaves) < self._most:
            return self.instances.new(self._u.starts, p)
        spare = self._slaves.popitem(last=False)[1]
        self._forget(spare)
        return self.instances.again(spare, self._u.starts, p)

    def _one_alone(self) -> None:
        """Free the instance there is, where a process may hold one alone."""
        if self._once and (self._slaves or self._starter):
            self.close(files=False)
            what = "allows one instance in a process: it is instantiated anew for all values"
            remark(self.name, f'{what}; in a process of its own, without "in_process", it need not be')

    def _forget(self, slave: Slave) -> None:
        self._modes.pop(id(slave), None)
        self._begun.pop(id(slave), None)
        if self.native is not None:
            self.native.forget(slave)

    def _free(self, slave: Slave) -> None:
        self._forget(slave)
        slave.free()

    def _look(self, slave: Slave, t: float, u: np.ndarray) -> None:
        """Note inputs and event indicators of the present point; raise FmuError where the mode would change there."""
        self._refuse_time_event(slave, t)
        self.seen[: self.n_u] = self._u.of_fmu(u)
        sides = self._modes[id(slave)][0]
        if not sides.size:
            return
        self.seen[self.n_u :] = z = slave.event_indicators(t, None)
        left = np.flatnonzero((z > 0) != sides)
        if left.size and self._guarded:
            raise slave.event_refused(f"has an event: indicator {left[0] + 1} changes its side", t)

    def _refuse_time_event(self, slave: Slave, t: float) -> None:
        due = self._modes[id(slave)][1]
        if t >= due and self._guarded:
            raise slave.event_refused(f"has a time event at t = {due:.6g} s", t)

    # -- of a run that carries events out ------------------------------------------------------------------------------

    def guard(self, on: bool) -> None:
        """Say whether the equations end where the mode would change, or go on as if it did not."""
        self._guarded = on
        if self.native is not None:
            self.native.guard(on)

    def at_work(self, p: np.ndarray) -> Slave:
        """Return the instance with parameters p, made where there is none."""
        with self._instance(p) as slave:
            return slave

    def mode(self, p: np.ndarray) -> tuple[np.ndarray, float]:
        """Return which event indicators (n_z,) are above zero in the mode, and the time [s] of the next time event."""
        return self._modes[id(self.at_work(p))]

    def set_mode(self, p: np.ndarray, sides: np.ndarray, due: float) -> None:
        """Take another mode, after an event."""
        slave = self.at_work(p)
        self._modes[id(slave)] = sides, due
        if self.native is not None:
            self.native.forget(slave)
            self.prefer(p)

    def close(self, *, files: bool = True) -> None:
        """Free all instances, and the unpacked files; they are made anew when they are needed."""
        for slave in [*self._slaves.values(), *([self._starter] if self._starter else [])]:
            self._free(slave)
        self._slaves.clear()
        self._starter = None
        if files:
            self.instances.close()

    def discard(self, p: np.ndarray) -> None:
        """Free the instance with parameters p: the next one begins anew."""
        slave = self._slaves.pop(p.tobytes(), None)
        if slave is not None:
            self._free(slave)
