"""Figures of an ensemble: reductions over a parameter or two, bands, bifurcation diagrams, cascades of full spectra."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.report.amplitudes import from_peak, of_amplitude
from rotorsim.report.style import BLUE, GREY, INK, RED, display, figure, legend_below, styled
from rotorsim.report.text.table import counted, rpm
from rotorsim.simulation.ensemble.result import Ensemble
from rotorsim.simulation.result import flat_name

BAND = (5.0, 95.0)  # %
SCALARS = ("peak", "radius", "peak_to_peak", "rms", "mean", "last", "harmonics")
WORDS = {
    "peak": "peak, 0-peak",
    "radius": "largest distance from [0, 0]",
    "peak_to_peak": "peak to peak",
    "rms": "rms",
    "mean": "mean",
    "last": "value at the end",
    "harmonics": "amplitude of 1X",
}
LOOK_OF = {"unstable": ("x", RED), "diverged": ("+", RED), "stopped": (".", GREY)}
MOST_SPECTRA = 60  # curves of a cascade; of more runs, as many that are evenly spaced
SHOWN_ORDERS = 5.0  # of the fastest run in a cascade
DYNAMIC_RANGE = 1e-3  # of the largest line in a cascade: what is smaller lies on the base line


@styled()
def ensemble_figure(ensemble: Ensemble, kind: str = "", signal: str = "", of: str = "", over: str = "") -> Figure:
    """Return a figure of an ensemble.

    kind: "curve" (over one parameter), "map" (over two), "band" (median and 5 to 95 % over what else varies),
    "bifurcation" (Poincare points over a parameter) or "cascade" (full spectra over a parameter); default: what fits.
    signal: a signal or one entry of it (default: the first recorded). of: the reduction that is shown (default: peak).
    over: the parameter along the axis (default: the first that varies).
    Raises RotorsimError for what was not kept, or does not fit.
    """
    chosen = kind or _fitting(ensemble)
    if chosen not in DRAWING:
        raise RotorsimError(Problem(f"no figure '{chosen}'", "kind", hint=near_miss(chosen, DRAWING)))
    return DRAWING[chosen](ensemble, signal, of, over)


def _fitting(ensemble: Ensemble) -> str:
    """Return the figure that fits what was varied and kept."""
    if "poincare" in ensemble.values:
        return "bifurcation"
    if "history" in ensemble.values:
        return "cascade"
    axes = _axes(ensemble)
    if len(axes) == 2 and np.prod([len(np.unique(ensemble.parameters[name])) for name in axes]) == len(ensemble):
        return "map"
    return "curve" if len(axes) == 1 else "band"


def _axes(ensemble: Ensemble) -> list[str]:
    """Return the scalar parameters that take more than one value."""
    return [name for name, a in ensemble.parameters.items() if a.ndim == 1 and len(np.unique(a)) > 1]


def _repeats(ensemble: Ensemble, name: str) -> bool:
    """Return whether every value of a parameter is that of several runs: it lies on a grid, with something else."""
    return bool(np.unique(ensemble.parameters[name], return_counts=True)[1].min() > 1)


def _axis(ensemble: Ensemble, name: str) -> tuple[np.ndarray, str]:
    """Return a parameter of all runs as shown, and its label; speeds in rpm."""
    unit = ensemble.units.get(name, "")
    if unit == "rad/s" and name.rpartition(".")[2].startswith("speed"):
        return np.asarray(rpm(ensemble.parameters[name])), f"{name} [rpm]"
    values, shown = display(ensemble.parameters[name], unit)
    return values, name if shown in ("", "1") else f"{name} [{shown}]"


def _along(ensemble: Ensemble, what: str, over: str, number: int = 1) -> list[str]:
    """Return the parameters along the axes of a figure, first the one that is asked for."""
    names = _axes(ensemble)
    if over and over not in names:
        hint = near_miss(over, names) if names else ""
        raise RotorsimError(Problem(f"no parameter '{over}' varies", "over", hint=hint.replace("known:", "varied:")))
    if len(names) < number:
        needs = "a parameter that varies" if number == 1 else f"{number} parameters that vary"
        raise RotorsimError(Problem(f"a {what} needs {needs}", "kind", hint="vary more" if names else "vary one"))
    return [*([over] if over else []), *(name for name in names if name != over)][:number]


def _column(ensemble: Ensemble, of: str, signal: str) -> tuple[dict[str, np.ndarray], str, str]:
    """Return the values of a reduction by flat name, each (n,), the unit, and what they are."""
    of = of or next((kind for kind in SCALARS if kind in ensemble.values), "")
    if of not in SCALARS or of not in ensemble.values:
        known = [kind for kind in SCALARS if kind in ensemble.values]
        hint = f"one of {', '.join(known)}" if known else f"keep one of {', '.join(SCALARS)}"
        what = f"'{of}' of one number was not kept" if of else "nothing that is one number of an entry was kept"
        raise RotorsimError(Problem(what, "of", hint=hint))
    name, index = _entry(ensemble, of, signal)
    harmonics = of == "harmonics"
    array = from_peak(np.abs(ensemble[of, name][..., 1])) if harmonics else ensemble[of, name]
    array = _part(array, 1, index)
    values, unit = display(array, ensemble.units.get(name, ""))
    start = flat_name(name, index)
    words = of_amplitude(WORDS[of]) if harmonics else WORDS[of]
    return {flat_name(start, place): _part(values, 1, place) for place in np.ndindex(values.shape[1:])}, unit, words


def _entry(ensemble: Ensemble, kind: str, signal: str) -> tuple[str, tuple[int, ...]]:
    """Return the signal that a name such as ``rotor.displacement[3,1]`` is part of, and where."""
    kept = ensemble.values.get(kind, {})
    if not signal:
        moving = [name for name in kept if not name.endswith((".theta", ".speed"))]
        signal = next(iter(moving or kept), "")
    base, bracket, inside = signal.partition("[")
    if signal in kept or base not in kept:
        ensemble[kind, signal]
        return signal, ()
    shape = ensemble.shapes[base]
    parts = inside.removesuffix("]").split(",") if bracket and inside.endswith("]") else []
    index = tuple(int(part) - 1 if part.strip().isdecimal() else -1 for part in parts)
    if not 0 < len(index) <= len(shape) or not all(0 <= i < n for i, n in zip(index, shape, strict=False)):
        text = " x ".join(map(str, shape)) or "scalar"
        raise RotorsimError(Problem(f"no such entry; '{base}' has shape {text}, counted from 1", signal))
    if kind == "radius" and len(index) == len(shape):
        raise RotorsimError(Problem("a radius is that of both axes", signal, hint=base))
    return base, index


def _part(values: np.ndarray, lead: int, index: tuple[int, ...]) -> np.ndarray:
    """Return one entry of values (..., *shape), behind ``lead`` dimensions."""
    place: Any = (*[slice(None)] * lead, *index)
    return np.asarray(values[place])


def _title(ensemble: Ensemble, what: str) -> str:
    ended = ", ".join(f"{n} {status}" for status, n in ensemble.counts.items() if status != "finished")
    return f"{ensemble.provenance.get('diagram', '')}: {what}, {counted(len(ensemble), 'run')}" + (
        f" ({ended})" if ended else ""
    )


def _mark_others(axes: Axes, ensemble: Ensemble, x: np.ndarray, y: np.ndarray | None = None) -> None:
    """Mark the runs that did not finish: on the axis of the parameter, or at their place in a map."""
    for status, (marker, colour) in LOOK_OF.items():
        there = ensemble.status == status
        if there.any():
            at = np.zeros(there.sum()) if y is None else y[there]
            form: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "clip_on": False} if y is None else {}
            axes.plot(x[there], at, marker, color=colour, ms=5, label=status, zorder=6, **form)


def curve_figure(ensemble: Ensemble, signal: str = "", of: str = "", over: str = "") -> Figure:
    """Return a reduction over one parameter, a line for every entry of the signal."""
    columns, unit, words = _column(ensemble, of, signal)
    [name] = _along(ensemble, "curve", over)
    x, label = _axis(ensemble, name)
    made = figure(8.0, 4.6, _title(ensemble, f"{words} over {name}"))
    axes = made.add_subplot()
    order = np.argsort(x, kind="stable")
    sound = ensemble.finished[order]
    for column, values in columns.items():
        axes.plot(x[order], np.where(sound, values[order], np.nan), ".-", ms=3, label=column)
    _mark_others(axes, ensemble, x)
    axes.set(xlabel=label, ylabel=f"{words} [{unit}]", xmargin=0)
    legend_below(made, axes)
    return made


def map_figure(ensemble: Ensemble, signal: str = "", of: str = "", over: str = "") -> Figure:
    """Return a reduction over two parameters as colours; runs that did not finish are marked."""
    columns, unit, words = _column(ensemble, of, signal)
    names = _along(ensemble, "map", over, 2)
    (x, x_label), (y, y_label) = (_axis(ensemble, name) for name in names)
    places = [np.unique(values, return_inverse=True) for values in (x, y)]
    if len(places[0][0]) * len(places[1][0]) != len(ensemble):
        hint = "band draws medians over what else varies"
        raise RotorsimError(Problem("the runs are no grid of two parameters", "kind", hint=hint))
    shown = list(columns.items())[:4]
    made = figure(1.2 + 4.6 * len(shown), 4.8, _title(ensemble, f"{words} over {names[0]} and {names[1]}"))
    for k, (column, values) in enumerate(shown):
        axes = made.add_subplot(1, len(shown), k + 1)
        grid = np.full((len(places[1][0]), len(places[0][0])), np.nan)
        grid[places[1][1], places[0][1]] = np.where(ensemble.finished, values, np.nan)
        drawn = axes.pcolormesh(places[0][0], places[1][0], grid, shading="nearest", cmap="viridis", rasterized=True)
        axes.grid(False)
        axes.set_facecolor("#eeeeee")
        made.colorbar(drawn, ax=axes, label=f"{words} [{unit}]")
        axes.set_title(column, loc="left")
        axes.set(xlabel=x_label, ylabel=y_label if k == 0 else "")
        _mark_others(axes, ensemble, x, y)
    if not ensemble.finished.all():
        legend_below(made, made.axes[0])
    return made


def band_figure(ensemble: Ensemble, signal: str = "", of: str = "", over: str = "") -> Figure:
    """Return median and 5 to 95 % of a reduction over a parameter on a grid, or its distribution without one."""
    columns, unit, words = _column(ensemble, of, signal)
    on_grid = [name for name in _axes(ensemble) if _repeats(ensemble, name)]
    grid = _along(ensemble, "band", over) if over else on_grid[:1]
    sound = ensemble.finished
    over = f" over {grid[0]}" if grid else ""
    made = figure(8.0, 1.4 + 2.6 * len(columns), _title(ensemble, f"{words}{over}, median and {_band()}"))
    for k, (column, values) in enumerate(columns.items()):
        axes = made.add_subplot(len(columns), 1, k + 1)
        axes.set_title(column, loc="left")
        if not grid:
            _draw_distribution(axes, values[sound], f"{words} [{unit}]")
            continue
        x, label = _axis(ensemble, grid[0])
        at = np.unique(x)
        groups = [values[(x == place) & sound] for place in at]
        percentiles = np.array([np.percentile(g, [BAND[0], 50, BAND[1]]) if len(g) else [np.nan] * 3 for g in groups])
        axes.fill_between(at, percentiles[:, 0], percentiles[:, 2], color=BLUE, alpha=0.25, lw=0, label=_band())
        axes.plot(at, percentiles[:, 1], color=BLUE, label="median")
        if not sound.all():
            _mark_others(axes, ensemble, x)
        axes.set(xlabel=label if k == len(columns) - 1 else "", ylabel=f"[{unit}]", xmargin=0)
    legend_below(made, made.axes[0])
    return made


def _band() -> str:
    return f"{BAND[0]:g} to {BAND[1]:g} %"


def _draw_distribution(axes: Axes, values: np.ndarray, label: str) -> None:
    """Draw how many runs have which value, with median and band. Raises RotorsimError where there is none."""
    if not len(values):
        raise RotorsimError(Problem("no run finished", "band"))
    axes.hist(values, bins=min(max(len(values) // 10, 8), 60), color=BLUE, alpha=0.6)
    for share, style in ((BAND[0], ":"), (50.0, "-"), (BAND[1], ":")):
        name = "median" if share == 50.0 else _band()
        axes.axvline(float(np.percentile(values, share)), color=INK, ls=style, label=name)
    axes.set(xlabel=label, ylabel="runs")


def bifurcation_figure(ensemble: Ensemble, signal: str = "", of: str = "", over: str = "") -> Figure:
    """Return the Poincare points, one a turn, over a parameter: the bifurcation diagram."""
    [name] = _along(ensemble, "bifurcation diagram", over)
    base, index = _entry(ensemble, "poincare", signal)
    x, label = _axis(ensemble, name)
    points, unit = display(_part(ensemble["poincare", base], 2, index), ensemble.units.get(base, ""))
    places = list(np.ndindex(points.shape[2:]))
    made = figure(7.0, 1.2 + 2.6 * len(places), _title(ensemble, f"one point a turn over {name}"))
    for k, place in enumerate(places):
        axes = made.add_subplot(len(places), 1, k + 1)
        values = np.where(ensemble.finished[:, None], _part(points, 2, place), np.nan)
        axes.plot(np.repeat(x, values.shape[1]), values.ravel(), ",", color=BLUE, rasterized=True)
        axes.set_title(flat_name(flat_name(base, index), place), loc="left")
        axes.set(ylabel=f"[{unit}]", xlabel=label if k == len(places) - 1 else "", xmargin=0)
        _mark_others(axes, ensemble, x)
    if not ensemble.finished.all():
        legend_below(made, made.axes[0])
    return made


def cascade_figure(ensemble: Ensemble, signal: str = "", of: str = "", over: str = "") -> Figure:
    """Return full spectra of the window, one above the other over a parameter (waterfall): backward, forward whirl."""
    [name] = _along(ensemble, "cascade", over)
    base, index = _entry(ensemble, "history", signal)
    rows = _part(ensemble["history", base], 2, index)
    if rows.shape[2:] != (2,):
        hint = f"a signal [x, y]: --show '{base}[NODE]'" if rows.ndim > 3 else "one whose last dimension is [x, y]"
        raise RotorsimError(Problem("a cascade needs a two-axis signal", flat_name(base, index), hint=hint))
    x, label = _axis(ensemble, name)
    order = np.argsort(x, kind="stable")
    order = order[ensemble.finished[order]]
    if not len(order):
        raise RotorsimError(Problem("no run finished", "cascade"))
    order = order[np.unique(np.round(np.linspace(0, len(order) - 1, min(len(order), MOST_SPECTRA))).astype(int))]
    spectra = [_full_spectrum(ensemble, rows[k], int(k)) for k in order]
    largest = max(float(size.max()) for _, size in spectra) or 1.0
    gap = float(np.ptp(x[order])) / max(len(order) - 1, 1) or 1.0
    made = figure(7.0, 5.6, _title(ensemble, f"full spectra of {flat_name(base, index)} over {name}"))
    axes = made.add_subplot()
    for k, (frequency, size) in zip(order[::-1], spectra[::-1], strict=True):
        lifted = x[k] + 6 * gap * size / largest
        axes.fill_between(frequency, x[k], lifted, color="white", lw=0, zorder=2)
        axes.plot(frequency, lifted, color=BLUE, lw=0.7, zorder=2)
    turning = _running(ensemble, order)
    limit = SHOWN_ORDERS * float(np.nanmax(turning)) if np.isfinite(turning).any() else float(spectra[0][0].max())
    for sign in (-1, 1) if np.isfinite(turning).any() else ():
        axes.plot(sign * turning, x[order], color=RED, lw=0.7, ls="--", label="1X" if sign > 0 else None, zorder=3)
    value, unit = display(from_peak(largest), ensemble.units.get(base, ""))
    height = f"{6 * gap:.4g} {label.rpartition('[')[2].rstrip(']')}" if "[" in label else f"{6 * gap:.4g}"
    axes.plot(
        [],
        [],
        color=BLUE,
        lw=0.7,
        label=f"{of_amplitude('amplitude')}: {float(value):.3g} {unit} are as high as {height}",
    )
    axes.set(xlim=(-limit, limit), xlabel="frequency [Hz], backward < 0 < forward", ylabel=label)
    legend_below(made, axes)
    return made


def _full_spectrum(ensemble: Ensemble, rows: np.ndarray, run: int) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies [Hz] and amplitudes (0-peak) of x + i y, of a Hann window, so that lines do not smear."""
    n = len(rows)
    window = np.hanning(n)
    size = np.abs(np.fft.fftshift(np.fft.fft((rows[:, 0] + 1j * rows[:, 1]) * window))) / window.sum()
    step = (ensemble.window[run, 1] - ensemble.window[run, 0]) / (n - 1)
    size = np.where(size < DYNAMIC_RANGE * size.max(), 0.0, size)
    return np.fft.fftshift(np.fft.fftfreq(n, step)), size


def _running(ensemble: Ensemble, order: np.ndarray) -> np.ndarray:
    """Return the shaft frequency [Hz] of runs, from the angle that was kept; NaN where none was."""
    angle = next((name for name in ensemble.values["history"] if name.endswith(".theta")), "")
    if not angle:
        return np.full(len(order), np.nan)
    theta = ensemble["history", angle][order]
    span = ensemble.window[order, 1] - ensemble.window[order, 0]
    return np.asarray((theta[:, -1] - theta[:, 0]) / span / (2 * np.pi))


DRAWING: Mapping[str, Callable[[Ensemble, str, str, str], Figure]] = {
    "curve": curve_figure,
    "map": map_figure,
    "band": band_figure,
    "bifurcation": bifurcation_figure,
    "cascade": cascade_figure,
}
