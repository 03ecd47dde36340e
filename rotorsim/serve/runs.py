"""Runs and analyses of the page: models kept compiled, results kept for comparison and figures."""

from __future__ import annotations

import io
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.compiled import Model, model_for_runs
from rotorsim.recordings.recording import Recording
from rotorsim.report.text.table import percent, rpm
from rotorsim.serve.beside import Beside, beside_settled, driven_as_recorded, measured_result
from rotorsim.serve.view import values_of
from rotorsim.simulation.result import Result, flat_name
from rotorsim.simulation.run import simulate

MOST_SAMPLES_SENT = 200_000  # of a signal, that the page is sent; of more every second, third, ...
MOST_MODELS, MOST_RESULTS = 8, 60  # that are kept
MOST_COUPLED_STEPS = 20_000_000  # of a co-simulation
MOST_ERRORS = 4  # signals whose error is said
CAMPBELL_SPEEDS = 41  # from standstill to twice the speed of the diagram
ANALYSES = ("modes", "campbell", "periodic")
Data = dict[str, Any]


@dataclass(frozen=True)
class Source:
    """A diagram to run: what it is known by (the hash of its file), and how it is loaded with parameters set."""

    key: str
    load: Callable[[Mapping[str, Any]], Diagram]


@dataclass
class Runs:
    """What was run: results and analyses by number. Used from one worker thread, but for `figure`."""

    kept: OrderedDict[int, tuple[str, Any]] = field(default_factory=OrderedDict)
    _models: OrderedDict[str, Model] = field(default_factory=OrderedDict)
    _count: int = 0
    _lock: Lock = field(default_factory=Lock)  # figures are drawn in other threads

    def run(self, source: Source, settings: Mapping[str, Any], progress: Callable[[float], None]) -> Data:
        """Simulate a diagram and return its recorded signals for the page, in the units that they are shown in.

        time (n,) [s]; values: a row (n,) of 32 bit for each entry, NaN for what cannot be drawn.
        settings: diagram parameters, texts with units. Raises RotorsimError as `simulate`.
        """
        begun = time.perf_counter()
        model = self._model(source)
        result = simulate(model, parameters=dict(settings), progress=progress)
        data = _result_data(result) | {"compared": values_of(model.diagram)}
        return self._keep("run", result) | data | {"seconds": time.perf_counter() - begun}

    def cosimulated(
        self,
        source: Source,
        settings: Mapping[str, Any],
        coupling: Mapping[str, Any],
        progress: Callable[[float], None],
    ) -> Data:
        """Co-simulate a diagram, as `rotorsim cosim`; return it as `run` does, with what the coupling does to damping.

        coupling: step (text with unit), master, order, parts (lists of blocks). Raises RotorsimError as
        `cosimulate_diagram`.
        """
        from rotorsim.cosim.cosimulation import cosimulate_diagram, recorded
        from rotorsim.report.text.coupling import said_by_fmus, stability_lines

        begun = time.perf_counter()
        step, parts = _step(coupling.get("step")), coupling.get("parts") or []
        if not isinstance(parts, list) or not all(
            isinstance(part, list) and all(isinstance(one, str) for one in part) for part in parts
        ):
            raise RotorsimError(Problem("parts are lists of blocks", "cosim"))
        diagram, master = source.load(settings), str(coupling.get("master") or "gauss_seidel")
        if diagram.solver.stop / step > MOST_COUPLED_STEPS:
            raise RotorsimError(Problem(f"more than {MOST_COUPLED_STEPS} steps", "step", hint="a longer one"))
        result = cosimulate_diagram(diagram, parts, step=step, master=master, check=True, progress=progress)
        made = result.provenance
        said = [*stability_lines(made), *(f"{one.subject}: {one.what}" for one in said_by_fmus(made, ""))]
        shown = recorded(diagram, result)
        data = _result_data(shown) | {
            "title": f"{_title(shown)}, {master}, step {coupling['step']}",
            "note": "; ".join(said),
            "compared": values_of(diagram),
        }
        return self._keep("run", shown) | data | {"seconds": time.perf_counter() - begun}

    def driven(self, source: Source, settings: Mapping[str, Any], recording: Recording, run: str | None) -> Data:
        """Simulate a diagram driven as a run was recorded; return it as `run` does, with what it leaves of signals."""
        begun = time.perf_counter()
        diagram = source.load(settings) if settings else self._model(source).diagram
        found = driven_as_recorded(diagram, recording, run)
        named = found.simulated.provenance
        said = ", ".join(f"{percent(error)} of {name}" for name, error in [*found.errors.items()][:MOST_ERRORS])
        data = _result_data(found.simulated) | {
            "title": f"{diagram.name} driven as {named['run']} of {named['recording']}",
            "note": f"NRMSE: it leaves {said}" if said else "",
            "compared": values_of(diagram),
        }
        return self._keep("driven", found) | data | {"seconds": time.perf_counter() - begun}

    def measured(self, source: Source, recording: Recording, run: str | None) -> Data:
        """Return what a run has measured, as `run` does."""
        chosen = recording.run(run or None)
        result = measured_result(self._model(source).diagram, recording, chosen)
        title = f"measured, {chosen.id} of {recording.name}"
        return self._keep("measured", result) | _result_data(result) | {"title": title, "measured": True}

    def analyse(
        self,
        source: Source,
        what: str,
        settings: Mapping[str, Any],
        recording: Recording | None,
        progress: Callable[[float], None],
    ) -> Data:
        """Return the table of an analysis, which is kept for its figure. Raises RotorsimError as it does.

        recording: its harmonics stand beside those of the settled motion.
        """
        model = self._model(source)
        if what not in ANALYSES:
            raise RotorsimError(Problem(f"unknown analysis '{what}'", hint=f"one of {', '.join(ANALYSES)}"))
        if what == "periodic":
            found, data = _periodic(model, dict(settings), recording, progress)
        elif what == "campbell":
            found, data = _campbell(model, dict(settings), progress)
        else:
            found, data = _modes(model, dict(settings))
        return self._keep(what, found) | data

    def figure(self, number: int, kind: str) -> bytes:
        """Return a figure of a run or an analysis as SVG. Raises RotorsimError for what is not there."""
        with self._lock:
            kept = self.kept.get(number)
        fitting = dict.fromkeys(("run", "driven", "measured"), ("overview", "spectrum"))
        if kept is None or kind not in fitting.get(kept[0], (kept[0],)):
            raise RotorsimError(Problem("there is no such figure", f"{number}/{kind}"))
        made = _spectrum(kept[1]) if kind == "spectrum" else kept[1].plot()
        from rotorsim.report.style import styled

        stream = io.BytesIO()
        with styled():
            made.savefig(stream, format="svg")
        return stream.getvalue()

    def _model(self, source: Source) -> Model:
        if source.key not in self._models:
            self._models[source.key] = model_for_runs(source.load({}))
            while len(self._models) > MOST_MODELS:
                self._models.popitem(last=False)
        self._models.move_to_end(source.key)
        return self._models[source.key]

    def _keep(self, kind: str, found: Any) -> Data:
        with self._lock:
            self._count += 1
            self.kept[self._count] = kind, found
            while len(self.kept) > MOST_RESULTS:
                self.kept.popitem(last=False)
            return {"run": self._count}


def _step(given: Any) -> float:
    """Return a communication step [s]. Raises RotorsimError for what is none."""
    try:
        step = numeric(given, "s")
    except ValueProblem as error:
        raise RotorsimError(Problem(error.what, "step", hint=error.hint or "such as 0.1 ms")) from None
    if not step > 0:
        raise RotorsimError(Problem("must be positive", "step", hint="such as 0.1 ms"))
    return float(step)


def _spectrum(found: Result | Beside) -> Any:
    from rotorsim.report.figures.run import spectrum_figure
    from rotorsim.report.text.run import two_axis_signals

    result, measured = (found.simulated, found.measured) if isinstance(found, Beside) else (found, None)
    names = two_axis_signals(result)
    if not names:
        raise RotorsimError(Problem("no two-axis signal was recorded", hint="record one, such as rotor.displacement"))
    return spectrum_figure(result, names[0], beside=measured)


def _result_data(result: Result) -> Data:
    from rotorsim.report.style import display

    angle = [name for name in result.signals if name.endswith((".theta", ".speed"))]
    names = [name for name in result.signals if name not in angle] or list(result.signals)
    step = max(-(-len(result.time) // MOST_SAMPLES_SENT), 1)
    rows: list[np.ndarray] = []
    signals = []
    for name in names:
        values, unit = display(result[name][::step], result.unit(name))
        for part in np.ndindex(values.shape[1:-1]) if values.shape[-1:] == (2,) else [()]:
            own = values[(slice(None), *part)]
            if np.isnan(own).all():  # a node where nothing was measured
                continue
            two_axis = own.shape[1:] == (2,)
            labels = ["x", "y"] if two_axis else [flat_name(name, place) for place in np.ndindex(own.shape[1:])]
            signals.append({"name": flat_name(name, part), "unit": unit, "entries": labels, "two_axis": two_axis})
            rows += [_drawn(column) for column in own.reshape(len(own), -1).T]
    return {
        "title": _title(result),
        "status": result.status,
        "message": result.message,
        "signals": signals,
        "time": np.asarray(result.time[::step], "<f8"),
        "values": rows,
        "thinned": step > 1,
        "speed_rpm": _speed(result),
    }


def _drawn(values: np.ndarray) -> np.ndarray:
    """Return values of 32 bit, seven digits, as many as a screen shows; NaN for what is none."""
    with np.errstate(over="ignore"):  # a run that diverges: beyond 3e38 nothing can be drawn
        single = np.asarray(values, "<f4")
    return np.where(np.isfinite(single), single, np.float32(np.nan))


def _speed(result: Result) -> float | None:
    """Return the speed of the shaft [rpm], None where it was not recorded, or changes."""
    angle = next((name for name in result.signals if name.endswith(".theta")), None)
    if angle is None or len(result.time) < 3:
        return None
    rates = np.diff(result[angle]) / np.diff(result.time)
    return float(rpm(np.mean(rates))) if np.ptp(rates) <= 1e-3 * np.abs(rates).max() else None


def _title(result: Result) -> str:
    speed = _speed(result)
    name = str(result.provenance.get("diagram", "run"))
    return name if speed is None else f"{name}, {speed:.6g} rpm"


def _modes(model: Model, settings: Data) -> tuple[Any, Data]:
    from rotorsim.linear.modes.eigenmodes import modes

    found = modes(model, parameters=settings)
    rows = [
        [k, f"{mode.frequency_hz:.5g}", f"{mode.damping_ratio:.5f}", mode.whirl]
        for k, mode in enumerate(found.modes, 1)
    ]
    title = f"Modes of {model.diagram.name}" + ("" if found.stable else ": unstable")
    return found, {"title": title, "columns": ["mode", "frequency [Hz]", "damping ratio", "whirl"], "rows": rows}


def _speeds(model: Model, count: int, lowest: float) -> np.ndarray:
    """Return speeds [rad/s] from a share of the diagram's speed to twice that. Raises RotorsimError without one."""
    from rotorsim.linear.linearisation import speed_of

    own = speed_of(model, model.p0)
    if not own:
        hint = 'declare "parameters": {"speed": "1500 rpm"} and use "$speed" in the clock'
        raise RotorsimError(Problem("the diagram has no parameter 'speed' that turns a shaft", hint=hint))
    return np.linspace(lowest * own, 2.0 * own, count)


def _campbell(model: Model, settings: Data, progress: Callable[[float], None]) -> tuple[Any, Data]:
    from rotorsim.linear.modes.campbell import campbell

    rest = {name: value for name, value in settings.items() if name != "speed"}
    found = campbell(model, speeds=_speeds(model, CAMPBELL_SPEEDS, 0.0), parameters=rest, progress=progress)
    rows = [
        [
            f"{c.order}X",
            f"{rpm(c.speed):.6g}",
            f"{c.frequency_hz:.5g}{c.modulo_text.removesuffix(' Hz')}",
            f"{c.damping_ratio:.5f}",
            c.whirl,
        ]
        for c in found.crossings
    ]
    columns = ["order", "critical speed [rpm]", "frequency [Hz]", "damping ratio", "whirl"]
    return found, {"title": f"Critical speeds of {model.diagram.name}", "columns": columns, "rows": rows}


def _periodic(
    model: Model, settings: Data, recording: Recording | None, progress: Callable[[float], None]
) -> tuple[Any, Data]:
    from rotorsim.report.amplitudes import of_amplitude
    from rotorsim.report.style import display
    from rotorsim.settled.periodic import periodic

    rest = {name: value for name, value in settings.items() if name != "speed"}
    speeds = _speeds(model, CAMPBELL_SPEEDS, 0.1)
    beside = None if recording is None else beside_settled(model, speeds, rest, recording, progress)
    found = periodic(model, speeds=speeds, parameters=rest, progress=progress) if beside is None else beside.settled
    measured = {} if beside is None else beside.measured
    name = next(one for one in (*measured, *found.two_axis, *found.harmonics) if one in found.harmonics)
    sizes, unit = display(np.abs(found.harmonic(name, 1)), found.units.get(name, ""))
    columns = ["speed [rpm]", f"1X of {name} [{of_amplitude(unit)}]", "motion"]
    rows = [
        [f"{rpm(speed):.6g}", f"{size:.5g}", status]
        for speed, size, status in zip(found.speeds, sizes, found.status, strict=True)
    ]
    if name in measured:
        was, _ = display(np.abs(measured[name].order(1)), found.units.get(name, ""))
        by_speed = dict(zip(measured[name].speeds, was, strict=True))
        columns.insert(2, f"measured [{of_amplitude(unit)}]")
        for row, speed in zip(rows, found.speeds, strict=True):
            row.insert(2, f"{by_speed[speed]:.5g}" if speed in by_speed else "")
    title = f"Settled motion of {model.diagram.name}"
    if beside is not None and beside.left_out:
        title += f"; not drawn: {', '.join(beside.left_out)}"
    return beside or found, {"title": title, "columns": columns, "rows": rows}
