"""Ensembles in files: a table as CSV, everything as HDF5 or NumPy's npz."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.files import atomic_target, write_atomically
from rotorsim.simulation.ensemble.result import COLUMNS, Ensemble
from rotorsim.simulation.files import ask_for_room

_SUFFIXES = (".csv", ".h5", ".npz")


def save_ensemble(ensemble: Ensemble, path: str | Path) -> None:
    """Write an ensemble; the suffix says the format.

    CSV: one row for every run, in SI: varied parameters, status, and the reductions that are one number of an entry.
    HDF5 and npz: everything; ``parameters/NAME`` (n, ...), ``values/KIND/SIGNAL`` (n, ...), ``status``, ``message``,
    ``step_error``, ``window``, ``stop``, ``step``, and ``meta``: JSON with units, counters and provenance.

    A write that is interrupted leaves what was there before. Raises RotorsimError.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        what = f"unknown format '{path.suffix}'" if path.suffix else "the name has no suffix that says the format"
        raise RotorsimError(Problem(what, place=Place(str(path)), hint=f"one of {', '.join(_SUFFIXES)}"))
    if suffix == ".csv":
        refuse_table(ensemble.values, str(path))
        write_atomically(path, _table(ensemble))
        return
    arrays = _arrays(ensemble)
    meta = json.dumps(
        {"units": dict(ensemble.units), "counters": dict(ensemble.counters), "provenance": dict(ensemble.provenance)},
        default=str,
    )
    size = sum(array.nbytes for array in arrays.values())
    with atomic_target(path, size=size) as temporary:
        if suffix == ".npz":
            with temporary.open("wb") as stream:
                np.savez(stream, **{"meta": np.array(meta), **arrays})  # type: ignore[arg-type]
            return
        import h5py

        ask_for_room(temporary, size)
        with h5py.File(temporary, "w") as file:
            file.attrs["meta"] = meta
            for name, array in arrays.items():
                text = array.dtype.kind == "U"
                kept = file.create_dataset(name, data=array.astype(object) if text else array, **_kind(text))
                unit = ensemble.units.get(re.sub(r"^(parameters|values/[a-z_]+)/", "", name))
                if unit:
                    kept.attrs["unit"] = unit


def refuse_table(kinds: Any, file: str) -> None:
    """Raise RotorsimError for reductions that have no place in a table."""
    wide = [kind for kind in kinds if kind not in COLUMNS]
    if wide:
        what = f"{', '.join(wide)}: many numbers for each entry and run have no place in a table"
        raise RotorsimError(Problem(what, place=Place(file), hint="write .h5 or .npz"))


def _kind(text: bool) -> dict[str, Any]:
    import h5py

    return {"dtype": h5py.string_dtype()} if text else {}


def _arrays(ensemble: Ensemble) -> dict[str, np.ndarray]:
    arrays = {f"parameters/{name}": np.asarray(array) for name, array in ensemble.parameters.items()}
    arrays |= {f"values/{kind}/{name}": a for kind, of in ensemble.values.items() for name, a in of.items()}
    arrays |= {name: getattr(ensemble, name) for name in ("status", "step_error", "window", "stop", "step")}
    arrays["message"] = np.array(ensemble.message)
    return arrays


def _table(ensemble: Ensemble) -> str:
    """Return the table as CSV, with units in its header."""
    rows, text = ensemble.to_table(), io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_header(ensemble, name) for name in rows[0]])
    writer.writerows([repr(value) if isinstance(value, float) else value for value in row.values()] for row in rows)
    return text.getvalue()


def _header(ensemble: Ensemble, column: str) -> str:
    """Return the name of a column with its unit: ``peak rotor.displacement[1] [m]``."""
    if " phase " in column:
        return f"{column} [deg]"
    base = column.rpartition(" ")[2]
    known = [name for name in ensemble.units if base == name or base.startswith(f"{name}[")]
    unit = ensemble.units[max(known, key=len)] if known else ""
    return f"{column} [{unit}]" if unit and unit != "1" else column
