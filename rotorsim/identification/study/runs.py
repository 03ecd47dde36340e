"""One seed of a sensitivity study: undisturbed runs, made once; noise; wrong known parameters; the estimate.

The undisturbed runs come from the product's own simulation. That is right for a study of what noise and wrong
parameters do; it says nothing about whether the equations are those of a machine.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.criteria import Z90
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.identification.harmonic.estimate import Estimate, Residuals, Search, estimate
from rotorsim.identification.harmonic.experiment import open_experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.identification.harmonic.profile import profile_intervals
from rotorsim.identification.harmonic.regression import Regression, open_regression
from rotorsim.identification.study.plan import Study
from rotorsim.identification.verdict import judge
from rotorsim.jobs.threads import one_thread
from rotorsim.linear.linearisation import can_move, flat_names, refuse_sampled
from rotorsim.measure.record import measure, steps_of, with_noise
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.recordings.recording import ANGLE, AXES, Channel, Recording, Run
from rotorsim.settled.equations import slots_of
from rotorsim.settled.periodic import periodic
from rotorsim.signals.covariance import complex_values
from rotorsim.signals.harmonic_basis import Basis, harmonic_basis
from rotorsim.signals.harmonic_fit import HarmonicFit, Samples, fit_harmonics
from rotorsim.signals.harmonics import RunHarmonics
from rotorsim.signals.shaft_angle import ShaftAngle
from rotorsim.simulation.ensemble.many import simulate_many

THESIS_RATE = 1e4  # Hz, of the recordings; the thesis' step of 0.1 ms
PROBE, LINEAR = 0.1, 1e-6  # size of a step; departure from linearity, of the change, that counts as none


@dataclass(frozen=True, eq=False)
class Clean:
    """One undisturbed run: samples (n, C) of the channels [SI], shaft angle, harmonics and the columns of their fit."""

    run: Run
    values: np.ndarray
    angle: ShaftAngle
    basis: Basis
    fit: HarmonicFit

    @cached_property
    def rms(self) -> np.ndarray:
        """Root mean square of every channel about its mean, (C,)."""
        return np.asarray(self.values.std(axis=0))

    @cached_property
    def projector(self) -> np.ndarray:
        """What makes harmonics of samples: (2K+1, n)."""
        return np.ascontiguousarray(self.basis.inverse[: 2 * self.basis.orders + 1] @ self.basis.columns.T)


def clean_runs(
    diagram: Diagram,
    speeds: Sequence[float],
    gains: Sequence[Mapping[str, float]] = ({},),
    window: tuple[float, float] = (4.0, 5.0),
    settled: bool = False,
) -> tuple[Recording, list[Clean]]:
    """Return the recording (without samples) and the undisturbed runs of a diagram at speeds [rad/s] and gains.

    Each run starts at rest and is recorded over the window [s] at 10 kHz; ``settled``: the settled motion instead.
    Recorded are the signals that the diagram records and that move. Raises RotorsimError for a run that diverges.
    """
    model = compile_diagram(diagram)
    channels = _channels(model, diagram)
    ports = list(dict.fromkeys(channel.signal for channel in channels))
    runs: list[Clean] = []
    problems: list[Problem] = []
    for number, setting in enumerate(gains):
        settings = [{"speed": speed, **setting} for speed in speeds]
        windows = (_settled if settled else _from_rest)(model, ports, settings, window)
        for speed, found in zip(speeds, windows, strict=True):
            name = f"{speed * 30 / np.pi:.6g} rpm" + (f", gains {number + 1}" if len(gains) > 1 else "")
            if isinstance(found, RotorsimError):
                problems += [replace(problem, subject=f"run at {name}") for problem in found.problems]
                continue
            time, theta = found.time, found.theta
            values = np.column_stack([_entry(found.signals[c.signal], c) for c in channels])
            run = Run(name, "", time, {}, speed, None, setting, "identify", Place(diagram.file))
            angle = ShaftAngle(theta, (theta[-1] - theta[0]) / (time[-1] - time[0]), 0.0, 0.0, "channel", True)
            basis = harmonic_basis(name, time, theta)
            signals = {c.name: column for c, column in zip(channels, values.T, strict=True)}
            samples = Samples(name, time, theta, signals, {c.name: c.unit for c in channels})
            fit = fit_harmonics(samples, basis=basis)
            runs.append(Clean(run, values, angle, basis, fit))
    if problems:
        raise RotorsimError(*problems)
    recording = Recording(diagram.name, "simulation", Path(), {c.name: c for c in channels}, tuple(r.run for r in runs))
    return recording, runs


def _channels(model: Model, diagram: Diagram) -> list[Channel]:
    """Return a channel for every recorded entry that a recording can hold and that moves."""
    channels = []
    for end in dict.fromkeys(f"{end.block}.{end.port}" for end in diagram.record):
        signal = model.signals[end]
        if end == ANGLE or signal.unit in (None, "", "1") or signal.shape[-1:] != (2,) or len(signal.shape) > 2:
            continue
        nodes: Sequence[int | None] = range(1, signal.shape[0] + 1) if len(signal.shape) == 2 else [None]
        for node in nodes:
            for axis in AXES:
                channel = Channel("", end, axis, node, None, signal.unit or "1")
                if can_move(model, channel.name):
                    channels.append(replace(channel, column=channel.name))
    if not channels:
        hint = 'let the diagram record two-axis signals: "record": ["rotor.displacement", "controller.current"]'
        raise RotorsimError(Problem("nothing is recorded", diagram.name, Place(diagram.file), hint))
    return channels


def _entry(values: np.ndarray, channel: Channel) -> np.ndarray:
    """Return the samples (n,) of one channel from those of its signal (n, 2) or (n, nodes, 2)."""
    own = values if channel.node is None else values[:, channel.node - 1]
    return np.asarray(own[:, AXES.index(channel.axis or "x")])


@dataclass(frozen=True, eq=False)
class _Window:
    """Times (n,) and shaft angles (n,) of the window of a run, and the signals (n, ...) over it."""

    time: np.ndarray
    theta: np.ndarray
    signals: Mapping[str, np.ndarray]


def _from_rest(
    model: Model, signals: Sequence[str], settings: Sequence[Mapping[str, float]], window: tuple[float, float]
) -> Iterator[_Window | RotorsimError]:
    """Yield the window of a run at every speed, or why it has none; they begin at rest, and go side by side."""
    step, every = steps_of(model, THESIS_RATE)
    varied = {name: np.array([setting[name] for setting in settings]) for name in settings[0]}
    record = tuple(dict.fromkeys([*signals, ANGLE]))
    runs = simulate_many(
        model,
        varied,
        stop=window[1],
        step=step,
        reduce=["history"],
        window=window,
        record=record,
        record_every=every,
        scheduler="synchronous",  # workers of a study are for what takes longer, and run this themselves
    )
    for k, status in enumerate(runs.status):
        if status != "finished":
            yield RotorsimError(Problem(runs.message[k]), exit_code=1)
            continue
        history = {name: runs["history", name][k] for name in record}
        rows = len(history[ANGLE])
        first = round(runs.window[k, 0] / (step * every))
        time = np.arange(first, first + rows) * (step * every)
        part = slice(rows - int(time[-1] > window[1] - step / 2))  # a sample at the end belongs to what follows
        yield _Window(time[part], history[ANGLE].reshape(rows)[part], {name: history[name][part] for name in signals})


def _settled(
    model: Model, signals: Sequence[str], settings: Sequence[Mapping[str, float]], window: tuple[float, float]
) -> Iterator[_Window | RotorsimError]:
    """Yield the settled motion at every speed over the window, or why there is none."""
    names = [flat for name in signals for flat in flat_names(model, name)]
    for setting in settings:
        speed = setting["speed"]
        others = {name: value for name, value in setting.items() if name != "speed"}
        try:
            angle = measure(model, [], ANGLE, window=window, rate=THESIS_RATE, parameters=setting, closed=False)
            motion = periodic(model, speeds=[speed], parameters=others, signals=names, stability=False)
        except RotorsimError as error:
            yield error
            continue
        if not motion.settled[0]:
            yield RotorsimError(Problem(motion.status[0]), exit_code=1)
            continue
        wave = np.exp(1j * speed * np.outer(angle.time, motion.orders))
        flat = {name: (wave @ np.nan_to_num(motion.harmonics[name][0])).real for name in names}
        found = {}
        for name in signals:
            columns = np.column_stack([flat[entry] for entry in flat_names(model, name)])
            found[name] = columns.reshape(len(angle.time), *model.signals[name].shape)
        yield _Window(angle.time, angle[ANGLE].reshape(len(angle.time)), found)


@lru_cache(maxsize=2)
def bench_of(text: str) -> Bench:
    """Return the undisturbed runs of the study with this `Study.text`, kept for the next call."""
    return Bench(Study(**json.loads(text)))


class Bench:
    """The undisturbed runs of a study with everything that does not change from seed to seed."""

    def __init__(self, study: Study) -> None:
        diagram = self.diagram = study.load()
        self.method, self.profile = study.method, study.profile
        self.free = _free(diagram, study.free)
        self.recording, self.clean = clean_runs(diagram, study.speeds, study.gains, study.window, study.settled)
        self.names = tuple(self.recording.channels)
        self.units = {name: channel.unit for name, channel in self.recording.channels.items()}
        opening: dict[str, Any] = {
            "runs": [item.run for item in self.clean],
            "free": self.free,
            "harmonics": [RunHarmonics(item.run, item.angle, item.fit) for item in self.clean],
        }
        self.opened: Residuals
        self.regression: Regression | None = None
        if study.method == "likelihood":
            experiment = open_experiment(diagram, self.recording, given=study.given, **opening)
            if not study.given:
                refuse_sampled(experiment.model, "identification with the loop closed")
            self.opened = Likelihood(experiment)
        else:
            self.opened = self.regression = open_regression(
                diagram, self.recording, reduction=study.reduction, **opening
            )
        self.search = Search(self.opened)
        self.groups = {name: self._entries(parameters) for name, parameters in study.groups.items()}

    @property
    def true(self) -> np.ndarray:
        """The parameters that the data were made with, (m,) SI."""
        return self.opened.experiment.theta0

    def harmonics(self, kind: str, level: float, random: np.random.Generator) -> list[RunHarmonics]:
        """Return the harmonics of the runs with noise (see `with_noise`)."""
        found = []
        for item in self.clean:
            values = item.values
            if level:
                values = with_noise(values, kind, level, random, item.rms)
            if self.method == "regression" and not item.fit.lines:  # it needs no covariance: a tenth of the work
                fit = replace(item.fit, values=complex_values((item.projector @ values).ravel(), len(self.names)))
                found.append(RunHarmonics(item.run, item.angle, fit))
                continue
            signals = dict(zip(self.names, values.T, strict=True))
            samples = Samples(item.run.id, item.run.time, item.angle.theta, signals, self.units)
            fit = fit_harmonics(samples, basis=item.basis)
            found.append(RunHarmonics(item.run, item.angle, fit))
        return found

    def solve(self, kind: str, level: float, bias: float, seed: int) -> dict[str, Any]:
        """Return the estimate with one draw of noise and wrong parameters, as plain data.

        values (m,), SI; with the likelihood also intervals (m, 2), 90 %, and whether each is called identified. The
        same seed draws the same numbers at every level.
        """
        with one_thread():
            wrong, noise = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
            experiment = self.opened.experiment
            p = self._biased(experiment.p, bias, wrong) if bias else None
            experiment = experiment.again(self.harmonics(kind, level, noise), p)
            if self.regression is not None:
                return {"values": self._regressed(self.search.again(self.regression.again(experiment))).tolist()}
            search = self.search.again(Likelihood(experiment))
            result = estimate(search, self.true)
            intervals, verdicts = self._judged(search, result)
        return {"values": result.theta.tolist(), "intervals": intervals.tolist(), "identified": verdicts}

    def _regressed(self, search: Search) -> np.ndarray:
        """Return the parameters (m,) of least squares: in one step where the equations are linear in them."""
        if not self._linear:
            return estimate(search, self.true).theta
        q = search.coordinates.inside(self.true)
        jacobian = search.jacobian(q)
        size = np.linalg.norm(jacobian, axis=0)
        size[size == 0] = 1.0
        step = np.linalg.lstsq(jacobian / size, -search.residual(q), rcond=None)[0] / size
        return search.coordinates.outside(q + step, self.true)

    @cached_property
    def _linear(self) -> bool:
        """Whether the equations of the regression are linear in the free parameters, at ten per cent from them."""
        q = self.search.coordinates.inside(self.true)
        step = PROBE * np.where(q == 0, 1.0, q)
        promised = self.search.jacobian(q) * step
        change = self.search.residual(q + step) - self.search.residual(q)
        return bool(np.linalg.norm(change - promised.sum(axis=1)) <= LINEAR * np.linalg.norm(promised))

    def expected_std(self, kind: str, level: float) -> np.ndarray:
        """Return the standard deviations (m,) that the likelihood promises at the true parameters."""
        with one_thread():
            harmonics = self.harmonics(kind, level, np.random.default_rng([0, 1]))
            jacobian = Likelihood(self.opened.experiment.again(harmonics)).expected(self.true)
            size = np.linalg.norm(jacobian, axis=0)
            scaled = jacobian / np.where(size > 0, size, 1.0)
            inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True, rcond=1e-13)
        return np.asarray(np.sqrt(np.diag(inverse)) / np.where(size > 0, size, np.nan))

    def _judged(self, search: Search, result: Estimate) -> tuple[np.ndarray, list[bool]]:
        """Return intervals (m, 2) and verdicts as `identify` gives them."""
        widen = result.widening
        if self.profile:
            intervals = profile_intervals(search, result, widen)
        else:
            half = Z90 * widen * result.std
            intervals = np.column_stack([result.theta - half, result.theta + half])
        return intervals, [verdict.identifiable for verdict in judge(result, intervals, widen=widen)]

    def _biased(self, p: np.ndarray, bias: float, random: np.random.Generator) -> np.ndarray:
        """Return known parameters p (R, n_p) with a relative error in every group, the same in all runs."""
        p = p.copy()
        for entries in self.groups.values():
            p[:, entries] *= 1 + bias * random.standard_normal()
        return p

    def _entries(self, parameters: Sequence[str]) -> np.ndarray:
        """Return where parameters lie in p. Raises RotorsimError for names that are unknown or to be estimated."""
        model = self.opened.experiment.model
        entries: list[int] = []
        problems = []
        for name in parameters:
            if name in model.references:
                entries += [k for part in model.references[name] for k in range(part.start, part.stop)]
            elif name in model.parameters:
                entries += range(model.parameters[name].start, model.parameters[name].stop)
            else:
                hint = near_miss(name, [*model.references, *model.parameters])
                problems.append(Problem(f"no parameter '{name}' that could be wrong", self.diagram.name, hint=hint))
        slots = {slot: item.name for item in self.free for slot in slots_of(model, item)}
        wrong = [slots[entry] for entry in entries if entry in slots]
        problems += [Problem("is estimated: it cannot be known wrongly as well", name) for name in wrong]
        if problems:
            raise RotorsimError(*dict.fromkeys(problems))
        return np.array(entries, int)


def _free(diagram: Diagram, names: Sequence[str]) -> tuple[Free, ...]:
    """Return the free parameters of these names, in this order. Raises RotorsimError for others."""
    known = {item.name: item for item in diagram.free}
    problems = [
        Problem(
            f"'{name}' is not among the parameters to identify",
            diagram.name,
            Place(diagram.file),
            near_miss(name, known) or f"they are {', '.join(known)}",
        )
        for name in names
        if name not in known
    ]
    if problems:
        raise RotorsimError(*problems)
    return tuple(known[name] for name in names) if names else diagram.free
