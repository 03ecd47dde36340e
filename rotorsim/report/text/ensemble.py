"""What is said of an ensemble: what was run, how it ended, and what its reductions range over."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotorsim.report.amplitudes import from_peak, of_amplitude
from rotorsim.report.text.table import counted, display_unit, rpm, table
from rotorsim.simulation.ensemble.result import COLUMNS, Ensemble
from rotorsim.simulation.result import flat_name

MOST_ENTRIES = 24  # rows of a table for each kind
ORDER = ("unstable", "diverged", "stopped")


def ensemble_line(ensemble: Ensemble) -> str:
    """Return one line: diagram, runs, what varies, how they went, what the window is."""
    varied = ", ".join(_range(ensemble, name) for name in ensemble.parameters) or "nothing varied"
    begin, end = ensemble.window[:, 0], ensemble.window[:, 1]
    window = f"{begin.min():.4g} to {end.max():.4g} s"
    if np.ptp(ensemble.stop) > 1e-9 * ensemble.stop.max():
        window = f"the last {(1 - begin[0] / ensemble.stop[0]):.0%} of every run"
    path, alone = ensemble.provenance.get("path", ""), ensemble.counters.get("alone", 0)
    more = f", {alone} of them once more by themselves" if alone and not str(path).startswith("one by one") else ""
    name = ensemble.provenance.get("diagram", "")
    return f"{name}: {counted(len(ensemble), 'run')} ({varied}), {path}{more}; reduced over {window}"


def _shown(ensemble: Ensemble, name: str, values: Any) -> tuple[Any, str]:
    """Return values of a parameter as shown, and the unit; speeds in rpm."""
    unit = ensemble.units.get(name, "")
    if unit == "rad/s" and name.rpartition(".")[2].startswith("speed"):
        return rpm(values), "rpm"
    shown, factor = display_unit(unit)
    return values * factor, "" if shown == "1" else shown


def _range(ensemble: Ensemble, name: str) -> str:
    values, unit = _shown(ensemble, name, ensemble.parameters[name])
    low, high = (f"{value:.6g}" for value in (np.min(values), np.max(values)))
    return f"{name} {low}" + (f" to {high}" if low != high else "") + (f" {unit}" if unit else "")


def not_finished(ensemble: Ensemble) -> list[tuple[str, str, str]]:
    """Return subject, what and hint for every way in which runs did not finish, and what is said of those that did."""
    found = []
    name = str(ensemble.provenance.get("diagram", ""))
    for status in ORDER:
        there = np.flatnonzero(ensemble.status == status)
        if len(there):
            first = int(there[0])
            at = ", ".join(_at(ensemble, key, first) for key in ensemble.parameters)
            what = (
                f"{len(there)} of {counted(len(ensemble), 'run')} {status}; the first, {at}: {ensemble.message[first]}"
            )
            found.append((name, what, "the table says which: --out FILE.csv"))
    return found


def remarks(ensemble: Ensemble) -> list[tuple[str, str]]:
    """Return subject and what is said of runs that finished: the same words once, of how many."""
    name, said = str(ensemble.provenance.get("diagram", "")), []
    there = [k for k in np.flatnonzero(ensemble.finished).tolist() if ensemble.message[k]]
    if there:
        at = ", ".join(_at(ensemble, key, there[0]) for key in ensemble.parameters)
        what = f"{len(there)} of {counted(len(ensemble), 'run')} finished with a warning; the first, {at}: "
        said.append((name, what + ensemble.message[there[0]]))
    return said


def _at(ensemble: Ensemble, name: str, run: int) -> str:
    values, unit = _shown(ensemble, name, ensemble.parameters[name][run])
    text = f"{values:.6g}" if np.ndim(values) == 0 else str(np.asarray(values).tolist())
    return f"{name} = {text}" + (f" {unit}" if unit else "")


def ensemble_table(ensemble: Ensemble) -> str:
    """Return a table for every kind that is one number of an entry: least, median, largest over the runs, and where."""
    parts = []
    for kind in (kind for kind in COLUMNS if kind in ensemble.values):
        rows: list[tuple[str, ...]] = []
        for name, array in ensemble.values[kind].items():
            unit, factor = display_unit(ensemble.units.get(name, ""))
            values = from_peak(np.abs(array[..., 1])) if kind == "harmonics" else array
            for index in np.ndindex(values.shape[1:]):
                column = np.where(ensemble.finished, values[:, *index], np.nan) * factor
                if np.isfinite(column).any() and len(rows) < MOST_ENTRIES:
                    largest = int(np.nanargmax(column))
                    numbers = (np.nanmin(column), np.nanmedian(column), column[largest])
                    where = ", ".join(_at(ensemble, key, largest) for key in ensemble.parameters)
                    rows.append((flat_name(name, index), *(f"{v:.5g}" for v in numbers), unit, where))
        title = of_amplitude("1X") if kind == "harmonics" else kind.replace("_", " ")
        if rows:
            parts.append(table((title, "least", "median", "largest", "unit", "largest at"), rows))
    wide = [kind for kind in ensemble.values if kind not in COLUMNS]
    if wide:
        drawn = " or a figure (--plot)" if wide != ["envelope"] else ""
        parts.append(f"{', '.join(wide)}: in a file (--out FILE.h5){drawn}")
    return "\n\n".join(parts)


def ensemble_data(ensemble: Ensemble) -> dict[str, Any]:
    """Return an ensemble as plain data: everything that is one number of an entry, run by run, in SI."""
    return {
        "diagram": ensemble.provenance.get("diagram"),
        "status": ensemble.counts,
        "units": dict(ensemble.units),
        "runs": ensemble.to_table(),
        "window": [float(ensemble.window[:, 0].min()), float(ensemble.window[:, 1].max())],
        "counters": dict(ensemble.counters),
        "provenance": dict(ensemble.provenance),
    }
