"""What the coupling does to stability: the linearised loop with the master in it, one period of it as a matrix.

Coupling by held or extrapolated inputs adds delay. A magnetic bearing lives by the damping of its controller, so that a
run can be stable and still be wrong: the damping that the coupling costs is computed, and the largest stable step.

With several rates or sampled controllers the period is the shortest after which all communication points and sample
hits fall together again (lifting: Meyer & Burrus, IEEE Trans. Circuits Syst. 22 (1975) 162-168).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import lcm

import numpy as np
from scipy.linalg import block_diag

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.inputs import Held
from rotorsim.cosim.linear import LinearCoupling, LinearParticipant
from rotorsim.cosim.masters.choice import make_stepping_master
from rotorsim.cosim.masters.master import Settings
from rotorsim.cosim.masters.stepping import STEP_HIT_TOLERANCE, SteppingMaster
from rotorsim.cosim.participant import Participant
from rotorsim.errors import RotorsimError
from rotorsim.jobs.threads import one_thread
from rotorsim.linear.linear_model import LinearModel

LEAST_OSCILLATION = 0.05  # modes with a smaller part of oscillation are not judged by their damping ratio
STEPS_PER_DECADE = 12  # steps tried in a decade
MOST_STEPS_PER_PERIOD = 240  # in one period
WHOLE_STEPS = 1e-6  # how far a number of steps may be from a whole one


@dataclass(frozen=True)
class CouplingStability:
    """The loop with the master in it, against the loop as a whole.

    radius: largest size of an eigenvalue of one communication step (stable below 1). whole, coupled: the eigenvalue
    [1/s] of the whole loop that loses most damping, and what the coupling makes of it; kept: share of its damping
    ratio that is left (nan where no mode oscillates slowly enough to be told). largest_step: the step above which it
    is unstable [s]; with sampled parts, the largest stable one among multiples and fractions of their sample time.
    exact: every part is linear with constant coefficients, so that this is the loop itself.
    """

    radius: float
    whole: complex
    coupled: complex
    kept: float
    largest_step: float
    exact: bool = False

    @property
    def stable(self) -> bool:
        """Whether the coupled loop is stable."""
        return self.radius < 1 + 1e-9


class _NoPeriodError(Exception):
    """Steps, rates and sample times have no short common period."""


def linear_coupling(coupling: Coupling[Participant]) -> LinearCoupling | str:
    """Return a coupling of linearised participants, or why there is none: those that cannot be linearised."""
    used = (coupling.L != 0).any(axis=0)
    models = [(p, p.linear(used[part])) for p, part in zip(coupling.participants, coupling.y_parts, strict=True)]
    if wrong := [f"{participant.name} {model}" for participant, model in models if isinstance(model, str)]:
        return "; ".join(wrong)
    made = [LinearParticipant(p.name, p.inputs, p.outputs, m) for p, m in models if not isinstance(m, str)]
    return LinearCoupling(tuple(made), coupling.L, np.zeros_like(coupling.u0), coupling.held)


def why_not_linear(coupling: Coupling[Participant], step: float, rates: Sequence[int] | None = None) -> str:
    """Return why the stability of a coupling is not told: the participants that cannot be linearised, or the times."""
    linear = linear_coupling(coupling)
    if isinstance(linear, str):
        return linear
    try:
        _count(step, _periods(linear), rates)
    except _NoPeriodError:
        times = [f"{step:g} s", *(f"{T:g} s" for T in sorted(_periods(linear)))]
        shown = f"steps and sample times ({', '.join(times)})"
        shown += f" and rates ({', '.join(map(str, rates))})" if rates and max(rates) > 1 else ""
        return f"{shown} have no common period of {MOST_STEPS_PER_PERIOD} steps or fewer"
    return "the linearised loop is singular"


def coupling_stability(
    coupling: Coupling[Participant],
    step: float,
    *,
    master: str,
    order: int | None = None,
    limit: bool = True,
    rates: Sequence[int] | None = None,
) -> CouplingStability | None:
    """Return how stable the coupled loop is with this communication step, or None when it cannot be told."""
    linear = linear_coupling(coupling)
    if isinstance(linear, str):
        return None
    with one_thread():  # many small matrices: threads cost more than they save
        try:
            period = one_period(linear, step, master, order, rates)
        except (_NoPeriodError, np.linalg.LinAlgError):
            return None
        except RotorsimError:  # the iteration does not converge
            period = Period(np.full((1, 1), np.inf), 1, step, ())
        whole = _whole(linear)
        radius = period.radius ** (1 / period.count)
        reference, changed, kept = _most_hurt(
            whole, period.eigenvalues(), max(step, min(_periods(linear), default=0.0))
        )
        largest = largest_stable_step(linear, master=master, order=order, rates=rates) if limit else np.nan
    exact = all(part.model.exact for part in linear.participants)
    return CouplingStability(radius, reference, changed, kept, largest, exact)


def _periods(coupling: LinearCoupling) -> set[float]:
    return {T for p in coupling.participants for T in p.model.periods}


def _count(step: float, periods: set[float], rates: Sequence[int] | None) -> int:
    """Return after how many steps everything begins anew. Raises _NoPeriodError."""
    first = lcm(*(rates or [1]))
    for count in range(first, MOST_STEPS_PER_PERIOD + 1, first):
        if all(
            abs(count * step / T - round(count * step / T)) < WHOLE_STEPS * count and count * step > 0.5 * T
            for T in periods
        ):
            return count
    raise _NoPeriodError


def _whole(coupling: LinearCoupling) -> np.ndarray:
    """Return the eigenvalues [1/s] of the loop without coupling error; with sampled parts, of one period of it."""
    models = [p.model for p in coupling.participants]
    A, B, C, D = (block_diag(*matrices) for matrices in zip(*((m.A, m.B, m.C, m.D) for m in models), strict=True))
    closed = np.linalg.solve(np.eye(len(coupling.u0)) - coupling.L @ D, coupling.L @ C)
    periods = _periods(coupling)
    if not periods:
        return np.asarray(np.linalg.eigvals(A + B @ closed))
    shortest = min(periods)
    end = _count(shortest, periods, None) * shortest
    flow = LinearParticipant("whole", (), (), LinearModel(A + B @ closed, B[:, :0], C[:0], D[:0, :0]))
    t, nothing = 0.0, Held(np.zeros((0, 1)))
    flow.x = np.asarray(np.eye(len(A)))
    passed = [flow.x]
    for hit in _apart([hit for m in models for hit in m.hits(0.0, end)], WHOLE_STEPS * shortest):
        flow.step(t, hit - t, nothing)
        J, K = (block_diag(*matrices) for matrices in zip(*(m.at_hit(hit) for m in models), strict=True))
        flow.x, t = J @ flow.x + K @ (closed @ flow.x), hit
        passed.append(flow.x)
    return Period(flow.x, len(passed) - 1, end, passed).eigenvalues()


def _apart(times: Iterable[float], least: float) -> list[float]:
    """Return times in order, without those that others are closer to than ``least``."""
    ordered = sorted(times)
    return [t for k, t in enumerate(ordered) if k == 0 or t - ordered[k - 1] > least]


@dataclass(frozen=True, eq=False)
class Period:
    """What one period makes of every unit vector: matrix (n, n), in ``count`` steps and a time [s].

    passed: the states (m, n), m <= n, at the start and after every step.
    """

    matrix: np.ndarray
    count: int
    time: float
    passed: Sequence[np.ndarray]

    @property
    def radius(self) -> float:
        """Largest size of an eigenvalue of the period."""
        if not np.isfinite(self.matrix).all():
            return np.inf
        return float(np.abs(np.linalg.eigvals(self.matrix)).max(initial=0.0))

    def eigenvalues(self) -> np.ndarray:
        """Return log(z) / time of the eigenvalues z that are not zero [1/s].

        A mode may turn more than once in a period; how often is seen on its way from step to step.
        """
        if not np.isfinite(self.matrix).all():
            return np.zeros(0)
        values, modes = np.linalg.eig(self.matrix)
        way = np.array([states @ modes for states in self.passed])
        turned = np.angle((way[:-1].conj() * way[1:]).sum(axis=1)).sum(axis=0)
        angle = np.angle(values)
        angle += 2 * np.pi * np.round((turned - angle) / (2 * np.pi))
        kept = np.abs(values) >= 1e-12
        return np.asarray((np.log(np.abs(values[kept])) + 1j * angle[kept]) / self.time)


def one_period(
    coupling: LinearCoupling, step: float, master: str, order: int | None = None, rates: Sequence[int] | None = None
) -> Period:
    """Return one period of the coupled loop.

    It acts on the states and on the signals at the points before that the master looks back to, and is found by
    letting the master itself go from every unit vector, from all at once where it does not iterate.
    Raises _NoPeriodError.
    """
    count = _count(step, _periods(coupling), rates)
    for part in coupling.participants:
        part.forget()
    fed = (coupling.moving_wires != 0).any(axis=0)
    feeding = [np.flatnonzero(fed[part]) for part in coupling.y_parts]
    settings = Settings(order, 1e-12, rates or ())
    worker = make_stepping_master(master, coupling, settings)
    if worker.linear_in_many:
        coupling = replace(coupling, u0=np.zeros((len(coupling.u0), 1)))
        worker = make_stepping_master(master, coupling, settings)
    earlier = _earlier(worker, coupling, step, count)
    n = sum(len(p.x) for p in coupling.participants)
    size = n + sum(len(times) * len(part) for times, part in zip(earlier, feeding, strict=True))
    if not size:
        return Period(np.zeros((0, 0)), count, count * step, ())
    runs = [np.eye(size)] if worker.linear_in_many else list(np.eye(size))
    made = [_go(worker, coupling, start, feeding, earlier, step, count) for start in runs]
    passed = [np.column_stack([run[1][k] for run in made]) for k in range(count + 1)]
    return Period(np.column_stack([run[0] for run in made]), count, count * step, passed)


def _earlier(worker: SteppingMaster, coupling: LinearCoupling, step: float, count: int) -> list[list[float]]:
    """Return of every participant the times before 0 of the points that the master may look back to, newest first."""
    memory = worker.memory
    if max(worker.rates) > 1 or not worker.sampling:
        return [[-(j + 1) * rate * step for j in range(memory)] for rate in worker.rates]
    end = count * step
    hits = [hit for k in worker.sampling for hit in coupling.participants[k].model.hits(0.0, end)]
    points = _apart([*hits, *(step * (k + 1) for k in range(count))], STEP_HIT_TOLERANCE * step)
    before = [t - (turn + 1) * end for turn in range(2 * memory + 1) for t in reversed(points)]
    return [before[1 : 2 * memory + 1]] * len(worker.rates)  # points that are close to each other are left out


def _go(
    worker: SteppingMaster,
    coupling: LinearCoupling,
    start: np.ndarray,
    feeding: Sequence[np.ndarray],
    earlier: Sequence[Sequence[float]],
    step: float,
    count: int,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return states and past signals, (size,) or (size, runs), after one period, and the states after every step."""
    parts, at = coupling.participants, 0
    for part in parts:
        part.x = start[at : at + len(part.x)].copy()
        at += len(part.x)
    u, y = coupling.consistent(0.0, coupling.u0)
    known = [[(0.0, y[columns])] for columns in coupling.y_parts]
    for points, times, fed in zip(known, earlier, feeding, strict=True):
        for time in times:
            before = np.zeros_like(points[-1][1])
            before[fed] = start[at : at + len(fed)]
            at += len(fed)
            points.insert(0, (time, before))
    worker.begin(0.0, u, known)
    passed = [np.concatenate([p.x for p in parts])]
    for k in range(count):
        worker.advance(k * step, (k + 1) * step)
        passed.append(np.concatenate([p.x for p in parts]))
    now = [worker.known[a][-2 - j][1][fed] for a, fed in enumerate(feeding) for j in range(len(earlier[a]))]
    return np.concatenate([passed[-1], *now]), passed


def _most_hurt(whole: np.ndarray, coupled: np.ndarray, step: float) -> tuple[complex, complex, float]:
    """Return the mode that loses most damping: its eigenvalue, what it becomes, the share of damping ratio kept.

    Modes with less than about two steps (or samples) in a turn are left out.
    """
    turning = [
        value
        for value in whole
        if value.imag >= LEAST_OSCILLATION * abs(value) and abs(value.imag) * step <= 0.9 * np.pi and value.real < 0
    ]
    near = [coupled[np.argmin(np.abs(coupled - value))] if coupled.size else 0j for value in turning]
    if not turning or not coupled.size:
        return 0j, 0j, np.nan
    kept = [float((-b.real / abs(b)) / (-a.real / abs(a))) for a, b in zip(turning, near, strict=True)]
    k = int(np.argmin(kept))
    return complex(turning[k]), complex(near[k]), kept[k]


def largest_stable_step(
    coupling: LinearCoupling, *, master: str, order: int | None = None, rates: Sequence[int] | None = None
) -> float:
    """Return the communication step [s] above which the coupled loop is unstable (infinite if none is found).

    The whole loop's fastest mode and slowest swing set where to look; sampled parts, their sample time. A loop that is
    unstable as a whole has none: 0.
    """
    whole = _whole(coupling)
    slowest_rise = 1e-9 * np.abs(whole).max(initial=1.0)
    if (whole.real > slowest_rise).any():
        return 0.0
    fastest = float(np.abs(whole).max(initial=0.0))
    if fastest == 0.0:
        return np.inf

    def stable(step: float) -> bool:
        try:
            period = one_period(coupling, step, master, order, rates)
        except (_NoPeriodError, RotorsimError, np.linalg.LinAlgError):  # the iteration itself may not converge there
            return False
        return period.radius < 1 + 1e-7

    if periods := _periods(coupling):
        return _largest_multiple(min(periods), stable)
    swings = np.abs(whole[np.abs(whole.imag) > LEAST_OSCILLATION * np.abs(whole)])
    longest = 1e2 / float(swings.min(initial=fastest))
    steps = np.geomspace(1e-3 / fastest, longest, round(STEPS_PER_DECADE * np.log10(longest * fastest * 1e3)))
    unstable = next((k for k, step in enumerate(steps) if not stable(float(step))), None)
    if unstable is None:
        return np.inf
    below, above = float(steps[max(unstable - 1, 0)]), float(steps[unstable])
    for _ in range(20):
        middle = (below + above) / 2
        below, above = (middle, above) if stable(middle) else (below, middle)
    return below


def _largest_multiple(period: float, stable: Callable[[float], bool]) -> float:
    """Return the largest stable step among multiples of a period, or else among its fractions; 0 where none is."""
    if stable(period):
        return next(((k - 1) * period for k in range(2, 21) if not stable(k * period)), np.inf)
    return next((period / k for k in range(2, 51) if stable(period / k)), 0.0)
