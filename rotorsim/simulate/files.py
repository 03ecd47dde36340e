"""Results in files: CSV as FMPy writes it, HDF5, and NumPy's npz; units and provenance go with them."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagram.files import atomic_target, write_atomically
from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.simulate.result import Result

__all__ = ["load_result", "save"]

_SUFFIXES = (".csv", ".h5", ".npz")


def save(result: Result, path: str | Path) -> None:
    """Write a result; the suffix says the format: .csv, .h5 or .npz.

    CSV: first column ``time``, one column for every entry by its FMI structured name, numbers exactly;
    units, shapes, status and provenance are in ``<name>.meta.json`` beside it. Raises RotorsimError.
    """
    path = Path(path)
    _check_suffix(path)
    if path.suffix == ".csv":
        _save_csv(result, path)
        write_atomically(_meta_path(path), json.dumps(_meta(result), indent=1, default=str) + "\n")
    elif path.suffix == ".npz":
        with atomic_target(path) as temporary, temporary.open("wb") as stream:
            arrays: dict[str, Any] = {f"signals/{name}": array for name, array in result.signals.items()}
            np.savez(stream, time=result.time, meta=np.array(json.dumps(_meta(result), default=str)), **arrays)
    else:
        _save_h5(result, path)


def load_result(path: str | Path) -> Result:
    """Read a result that `save` wrote. Raises RotorsimError with the place and what was expected."""
    path = Path(path)
    _check_suffix(path)
    if not path.is_file():
        raise RotorsimError(
            Problem("file does not exist", place=Place(str(path)), hint="`rotorsim run ... --out FILE`")
        )
    try:
        if path.suffix == ".csv":
            return _load_csv(path)
        return _load_npz(path) if path.suffix == ".npz" else _load_h5(path)
    except RotorsimError:
        raise
    except Exception as error:
        said = (str(error).splitlines() or [""])[0][:120]
        what = f"not a result of rotorsim: {type(error).__name__}: {said}"
        hint = "`rotorsim run ... --out FILE` writes one"
        raise RotorsimError(Problem(what, place=Place(str(path)), hint=hint)) from None


def _check_suffix(path: Path) -> None:
    if path.suffix not in _SUFFIXES:
        what = f"unknown format '{path.suffix}'"
        raise RotorsimError(Problem(what, place=Place(str(path)), hint=f"one of {', '.join(_SUFFIXES)}"))


def _meta_path(path: Path) -> Path:
    return path.with_name(path.name + ".meta.json")


def _meta(result: Result) -> dict[str, Any]:
    return {
        "signals": {
            name: {"unit": result.units.get(name, ""), "shape": list(array.shape[1:])}
            for name, array in result.signals.items()
        },
        "status": result.status,
        "message": result.message,
        "counters": dict(result.counters),
        "provenance": dict(result.provenance),
    }


def _result(time: np.ndarray, signals: dict[str, np.ndarray], meta: dict[str, Any]) -> Result:
    units = {name: entry["unit"] for name, entry in meta["signals"].items()}
    return Result(time, signals, units, meta["status"], meta["message"], meta["counters"], meta["provenance"])


def _save_csv(result: Result, path: Path) -> None:
    columns = [("time", result.time), *result.columns()]
    table = np.column_stack([values for _, values in columns])
    with atomic_target(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(",".join(f'"{name}"' for name, _ in columns) + "\n")
        for start in range(0, len(table), 4096):
            block = table[start : start + 4096].tolist()
            stream.write("".join(",".join(map(repr, row)) + "\n" for row in block))


def _load_csv(path: Path) -> Result:
    with path.open(encoding="utf-8", newline="") as stream:
        header = next(csv.reader(stream))
        table = np.loadtxt(stream, delimiter=",", ndmin=2).reshape(-1, len(header))
    meta = json.loads(_meta_path(path).read_text(encoding="utf-8"))
    signals: dict[str, np.ndarray] = {}
    at = 1
    for name, entry in meta["signals"].items():
        size = int(np.prod(entry["shape"], dtype=int))
        signals[name] = table[:, at : at + size].reshape(len(table), *entry["shape"])
        at += size
    if at != len(header):
        raise ValueError(f"{len(header)} columns, {at} expected from {_meta_path(path).name}")
    return _result(np.ascontiguousarray(table[:, 0]), signals, meta)


def _load_npz(path: Path) -> Result:
    with np.load(path, allow_pickle=False) as archive:
        meta = json.loads(str(archive["meta"]))
        signals = {name: archive[f"signals/{name}"] for name in meta["signals"]}
        return _result(archive["time"], signals, meta)


def _save_h5(result: Result, path: Path) -> None:
    import h5py

    with atomic_target(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["meta"] = json.dumps(_meta(result), default=str)
        file.create_dataset("time", data=result.time).attrs["unit"] = "s"
        group = file.create_group("signals", track_order=True)
        for name, array in result.signals.items():
            group.create_dataset(name, data=array).attrs["unit"] = result.units.get(name, "")


def _load_h5(path: Path) -> Result:
    import h5py

    with h5py.File(path, "r") as file:
        meta = json.loads(str(file.attrs["meta"]))
        signals = {name: np.array(file["signals"][name]) for name in meta["signals"]}
        return _result(np.array(file["time"]), signals, meta)
