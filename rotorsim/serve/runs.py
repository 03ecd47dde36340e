"""Runs and analyses of the page: models kept compiled, results kept for comparison and figures."""

from __future__ import annotations

import io
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Event, Lock
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.compiled import Model, model_for_runs
from rotorsim.report.text.table import rpm
from rotorsim.simulation.result import Result, flat_name
from rotorsim.simulation.run import simulate

MOST_SAMPLES_SENT = 200_000  # of a signal, that the page is sent; of more every second, third, ...
MOST_MODELS, MOST_RESULTS = 8, 60  # that are kept
CAMPBELL_SPEEDS = 41  # from standstill to twice the speed of the diagram
ANALYSES = ("modes", "campbell", "periodic")
Data = dict[str, Any]


class _StoppedError(Exception):
    """The page has asked to stop."""


@dataclass
class Runs:
    """What was run: results and analyses by number. Used from one worker thread, but for `stop` and `figure`."""

    kept: OrderedDict[int, tuple[str, Any]] = field(default_factory=OrderedDict)
    _models: OrderedDict[str, Model] = field(default_factory=OrderedDict)
    _count: int = 0
    _lock: Lock = field(default_factory=Lock)  # figures are drawn in other threads

    def run(
        self,
        key: str,
        source: Callable[[], Diagram],
        settings: Mapping[str, Any],
        stopped: Event,
        progress: Callable[[float], None],
    ) -> Data:
        """Simulate a diagram and return its recorded signals for the page, in the units that they are shown in.

        time (n,) [s]; values: a row (n,) of 32 bit for each entry, NaN for what cannot be drawn.
        key: what the diagram is known by (the hash of its file); source: loads it when it is not. settings: diagram
        parameters, texts with units. Raises RotorsimError as `simulate`, and when it is stopped.
        """
        begun = time.perf_counter()

        def watched(share: float) -> None:
            if stopped.is_set():
                raise _StoppedError
            progress(share)

        model = self._model(key, source)
        parameters = dict(settings)
        try:
            result = simulate(model, parameters=parameters, progress=watched)
        except _StoppedError:
            raise RotorsimError(Problem("stopped", model.diagram.name), exit_code=1) from None
        return self._keep("run", result) | _result_data(result) | {"seconds": time.perf_counter() - begun}

    def analyse(self, key: str, source: Callable[[], Diagram], what: str, settings: Mapping[str, Any]) -> Data:
        """Return the table of an analysis, which is kept for its figure. Raises RotorsimError as it does."""
        model = self._model(key, source)
        made = {"modes": _modes, "campbell": _campbell, "periodic": _periodic}
        if what not in made:
            raise RotorsimError(Problem(f"unknown analysis '{what}'", hint=f"one of {', '.join(ANALYSES)}"))
        found, data = made[what](model, dict(settings))
        return self._keep(what, found) | data

    def figure(self, number: int, kind: str) -> bytes:
        """Return a figure of a run or an analysis as SVG. Raises RotorsimError for what is not there."""
        with self._lock:
            kept = self.kept.get(number)
        fitting = {"run": ("overview", "spectrum")}
        if kept is None or kind not in fitting.get(kept[0], (kept[0],)):
            raise RotorsimError(Problem("there is no such figure", f"{number}/{kind}"))
        made = _spectrum(kept[1]) if kind == "spectrum" else kept[1].plot()
        from rotorsim.report.style import styled

        stream = io.BytesIO()
        with styled():
            made.savefig(stream, format="svg")
        return stream.getvalue()

    def _model(self, key: str, source: Callable[[], Diagram]) -> Model:
        if key not in self._models:
            self._models[key] = model_for_runs(source())
            while len(self._models) > MOST_MODELS:
                self._models.popitem(last=False)
        self._models.move_to_end(key)
        return self._models[key]

    def _keep(self, kind: str, found: Any) -> Data:
        with self._lock:
            self._count += 1
            self.kept[self._count] = kind, found
            while len(self.kept) > MOST_RESULTS:
                self.kept.popitem(last=False)
            return {"run": self._count}


def _spectrum(result: Result) -> Any:
    from rotorsim.report.figures.run import spectrum_figure
    from rotorsim.report.text.run import two_axis_signals

    names = two_axis_signals(result)
    if not names:
        raise RotorsimError(Problem("no two-axis signal was recorded", hint="record one, such as rotor.displacement"))
    return spectrum_figure(result, names[0])


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
    from rotorsim.linear.eigenmodes import modes

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


def _campbell(model: Model, settings: Data) -> tuple[Any, Data]:
    from rotorsim.linear.campbell import campbell

    rest = {name: value for name, value in settings.items() if name != "speed"}
    found = campbell(model, speeds=_speeds(model, CAMPBELL_SPEEDS, 0.0), parameters=rest)
    rows = [
        [f"{c.order}X", f"{rpm(c.speed):.6g}", f"{c.frequency_hz:.5g}", f"{c.damping_ratio:.5f}", c.whirl]
        for c in found.crossings
    ]
    columns = ["order", "critical speed [rpm]", "frequency [Hz]", "damping ratio", "whirl"]
    return found, {"title": f"Critical speeds of {model.diagram.name}", "columns": columns, "rows": rows}


def _periodic(model: Model, settings: Data) -> tuple[Any, Data]:
    from rotorsim.report.amplitudes import of_amplitude
    from rotorsim.report.style import display
    from rotorsim.settled.periodic import periodic

    rest = {name: value for name, value in settings.items() if name != "speed"}
    found = periodic(model, speeds=_speeds(model, CAMPBELL_SPEEDS, 0.1), parameters=rest)
    name = next(iter(found.two_axis or found.harmonics))
    sizes, unit = display(np.abs(found.harmonic(name, 1)), found.units.get(name, ""))
    rows = [
        [f"{rpm(speed):.6g}", f"{size:.5g}", status]
        for speed, size, status in zip(found.speeds, sizes, found.status, strict=True)
    ]
    columns = ["speed [rpm]", f"1X of {name} [{of_amplitude(unit)}]", "motion"]
    return found, {"title": f"Settled motion of {model.diagram.name}", "columns": columns, "rows": rows}
