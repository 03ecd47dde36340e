"""Results in files: CSV as FMPy writes it, HDF5, and NumPy's npz; units and provenance go with them."""

from __future__ import annotations

import csv
import errno
import json
import os
import warnings
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.files import atomic_target, write_atomically
from rotorsim.simulation.result import Result, cut, flat_name

_SUFFIXES = (".csv", ".h5", ".npz")
_ROWS = 4096  # of a CSV, written at a time
_DIGITS = 20  # bytes of a number in a CSV, about


def save(result: Result, path: str | Path) -> None:
    """Write a result; the suffix says the format: .csv, .h5 or .npz.

    CSV: byte for byte as ``fmpy.util.write_csv`` writes it: first column ``time``, one column for every entry by
    its FMI structured name, numbers exactly; units, shapes, status and provenance are in
    ``<name>.meta.json`` beside it. (FMPy's ``read_csv`` splits the header at commas, also inside quotes: it
    cannot read a matrix entry such as "rotor.displacement[3,2]"; other readers can.)

    A write that is interrupted leaves what was there before. Raises RotorsimError.
    """
    path = Path(path)
    _check_suffix(path)
    if path.suffix.lower() == ".csv":
        _save_csv(result, path)
        write_atomically(_meta_path(path), _text(_meta(result), indent=1) + "\n")
    elif path.suffix.lower() == ".npz":
        with atomic_target(path, size=_bytes(result)) as temporary, temporary.open("wb") as stream:
            arrays: dict[str, Any] = {f"signals/{name}": array for name, array in result.signals.items()}
            np.savez(stream, time=result.time, meta=np.array(_text(_meta(result))), **arrays)
    else:
        _save_h5(result, path)


def load_result(path: str | Path) -> Result:
    """Read a result that `save` wrote, equal to the last bit.

    A CSV without its side file (of FMPy, of another program) is read too: shapes follow from the names, units
    are not known. Raises RotorsimError with the place and what was expected.
    """
    path = Path(path)
    _check_suffix(path)
    if not path.is_file():
        raise RotorsimError(
            Problem("file does not exist", place=Place(str(path)), hint="`rotorsim run ... --out FILE`")
        )
    try:
        load = {".csv": _load_csv, ".h5": _load_h5, ".npz": _load_npz}[path.suffix.lower()]
        return load(path)
    except Exception as error:
        said = (str(error).splitlines() or [""])[0][:120]
        what = f"not a result of rotorsim: {type(error).__name__}: {said}"
        hint = "`rotorsim run ... --out FILE` writes one"
        raise RotorsimError(Problem(what, place=Place(str(path)), hint=hint)) from None


def _bytes(result: Result) -> int:
    return int(result.time.nbytes + sum(array.nbytes for array in result.signals.values()))


def _check_suffix(path: Path) -> None:
    if path.suffix.lower() not in _SUFFIXES:
        what = f"unknown format '{path.suffix}'" if path.suffix else "the name has no suffix that says the format"
        raise RotorsimError(Problem(what, place=Place(str(path)), hint=f"one of {', '.join(_SUFFIXES)}"))


def _meta_path(path: Path) -> Path:
    return path.with_name(path.name + ".meta.json")


def _text(meta: dict[str, Any], indent: int | None = None) -> str:
    return json.dumps(meta, indent=indent, default=_plain)


def _plain(value: Any) -> Any:
    """Return what JSON has no word for: NumPy numbers and arrays as numbers, the rest as text."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)


def _meta(result: Result) -> dict[str, Any]:
    return {
        "signals": {
            name: {"unit": result.units.get(name, ""), "shape": list(array.shape[1:])}
            for name, array in result.signals.items()
        },
        "status": result.status,
        "message": result.message,
        "cause": result.cause,
        "counters": dict(result.counters),
        "provenance": dict(result.provenance),
    }


def _result(time: np.ndarray, signals: dict[str, np.ndarray], meta: dict[str, Any]) -> Result:
    units = {name: entry["unit"] for name, entry in meta["signals"].items()}
    cause = meta.get("cause", "")  # files of earlier versions name none
    return Result(time, signals, units, meta["status"], meta["message"], meta["counters"], meta["provenance"], cause)


def _save_csv(result: Result, path: Path) -> None:
    columns = [("time", result.time), *result.columns()]
    size = len(result.time) * len(columns) * _DIGITS
    with atomic_target(path, size=size) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(",".join(f'"{name}"' for name, _ in columns) + "\n")
        for start in range(0, len(result.time), _ROWS):  # in pieces: text takes several times the memory of numbers
            rows = np.column_stack([values[start : start + _ROWS] for _, values in columns]).tolist()
            stream.write("".join(",".join(map(repr, row)) + "\n" for row in rows))
        stream.flush()  # on a full disk this fails, and what was there before is kept
        os.fsync(stream.fileno())
        _meta_path(path).unlink(missing_ok=True)  # never new numbers beside the side file of old ones


def _load_csv(path: Path) -> Result:
    with path.open(encoding="utf-8", newline="") as stream:
        header = next(csv.reader(stream))
        table = _numbers(stream, len(header))
    side = _meta_path(path)
    if not side.is_file():
        return _foreign(path, header, table)
    meta = json.loads(side.read_text(encoding="utf-8"))
    signals, _ = cut(table[:, 1:], {name: entry["shape"] for name, entry in meta["signals"].items()})
    result = _result(np.ascontiguousarray(table[:, 0]), signals, meta)
    if header != ["time", *result.flat_names()]:
        raise ValueError(f"its columns are not those that {side.name} names")
    return result


def _numbers(stream: TextIO, columns: int) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "loadtxt: input contained no data")  # a run that diverged at once
        return np.loadtxt(stream, delimiter=",", ndmin=2).reshape(-1, columns)


def _foreign(path: Path, header: list[str], table: np.ndarray) -> Result:
    """Return the result in a CSV without side file: columns name[1], name[2], ... make one signal."""
    if header[0] != "time":
        raise ValueError(f"the first column is '{header[0]}', not 'time'")
    entries: dict[str, dict[tuple[int, ...], np.ndarray]] = {}
    for k, name in enumerate(header[1:], start=1):
        base, _, inside = name.removesuffix("]").partition("[")
        index = tuple(int(part) - 1 for part in inside.split(",")) if inside else ()
        entries.setdefault(base, {})[index] = table[:, k]
    signals: dict[str, np.ndarray] = {}
    for base, parts in entries.items():
        places = list(parts)
        shape = tuple(int(n) + 1 for n in np.max(places, axis=0)) if places[0] else ()
        if places == list(np.ndindex(shape)):
            signals[base] = np.column_stack(list(parts.values())).reshape(-1, *shape)
        else:  # some entries only: each is a signal of its own
            signals |= {flat_name(base, at): values for at, values in parts.items()}
    note = f"read without {_meta_path(path).name}: units and what was run are not known"
    return Result(np.ascontiguousarray(table[:, 0]), signals, {}, message=note, provenance={"file": str(path)})


def _load_npz(path: Path) -> Result:
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:  # np.load leaves damaged files open
        meta = json.loads(str(archive["meta"]))
        signals = {name: archive[f"signals/{name}"] for name in meta["signals"]}
        return _result(archive["time"], signals, meta)


def _save_h5(result: Result, path: Path) -> None:
    import h5py

    with atomic_target(path, size=_bytes(result)) as temporary:
        ask_for_room(temporary, _bytes(result))
        with h5py.File(temporary, "w") as file:
            _fill_h5(file, result)


def ask_for_room(path: Path, size: int) -> None:
    """Raise OSError where a file does not fit: HDF5 itself fails on a full disk in ways that cannot be caught."""
    if size and hasattr(os, "posix_fallocate"):
        with path.open("r+b") as stream:
            try:
                os.posix_fallocate(stream.fileno(), 0, size)
            except OSError as error:
                if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):  # a file system that cannot tell
                    raise


def _fill_h5(file: Any, result: Result) -> None:
    file.attrs["meta"] = _text(_meta(result))
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
