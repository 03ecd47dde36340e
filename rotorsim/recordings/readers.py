"""Columns of measurement files: .csv, .npz, .mat, .h5, and by optional packages .tdms, .uff and .mf4."""

from __future__ import annotations

import math
import re
import warnings as python_warnings
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.recordings.csv_reader import CsvTable

__all__ = ["MAX_BYTES", "SUFFIXES", "read_columns"]

MAX_BYTES = 2_000_000_000
MAX_DEPTH, MAX_NAMES = 20, 1000  # of groups within groups, and of names that are listed for near misses
BLOCK = 1 << 20  # bytes, unpacked at a time where they are only counted
OWN_TIME = "time"  # names the clock that .tdms, .uff and .mf4 files have besides their channels
_PART = re.compile(r"(.+)\[([1-9][0-9]{0,8})\]")

Table = Mapping[str, Callable[[], Any]]  # column -> what reads it


def read_columns(
    path: Path,
    columns: Sequence[str],
    time_column: str | None = None,
    *,
    shown: str = "",
    warnings: list[Problem] | None = None,
) -> dict[str, np.ndarray]:
    """Return columns of a data file: name -> (n,), as the numbers stand in the file.

    A name may be a path in the file (``group/x``), and ``name[2]`` is the second column of a two-dimensional array.
    shown: the file's name in messages. warnings: takes one for values that are not finite.
    Raises RotorsimError with every mistake: missing columns, text in cells, lengths that differ.
    """
    file = shown or str(path)
    read = _READERS.get(path.suffix.lower())
    if read is None:
        what = f"unknown format '{path.suffix}'" if path.suffix else "the name has no suffix that says the format"
        raise RotorsimError(Problem(what, place=Place(file), hint=f"one of {', '.join(SUFFIXES)}"))
    try:
        size = path.stat().st_size
    except OSError as error:
        raise RotorsimError(Problem(f"file cannot be read: {error.strerror}", place=Place(file))) from None
    if size == 0:
        raise RotorsimError(Problem("file is empty", place=Place(file)))
    if size > MAX_BYTES:
        hint = "split it into several runs"
        raise RotorsimError(Problem(f"file is larger than {MAX_BYTES // 10**9} GB", place=Place(file), hint=hint))
    wanted = list(dict.fromkeys([*columns, *([] if time_column is None else [time_column])]))
    try:
        with python_warnings.catch_warnings():
            python_warnings.simplefilter("ignore")  # of foreign readers; what matters is checked here
            found, places = read(path, wanted, file)
    except RotorsimError:
        raise
    except Exception as error:  # foreign readers raise anything on a damaged file
        said = (str(error).splitlines() or [""])[0][:120]
        what = f"not a {path.suffix.lower()} file that can be read: {type(error).__name__}: {said}"
        raise RotorsimError(Problem(what, place=Place(file))) from None
    _check_lengths(found, file)
    _check_finite(found, file, places, warnings)
    return found


def _check_lengths(found: Mapping[str, np.ndarray], file: str) -> None:
    lengths = {name: len(array) for name, array in found.items()}
    if len(set(lengths.values())) > 1:
        text = ", ".join(f"{name} {length}" for name, length in lengths.items())
        hint = "columns of one run must be sampled together; put others into a run of their own"
        raise RotorsimError(Problem(f"columns differ in length: {text}", place=Place(file), hint=hint))


def _check_finite(
    found: Mapping[str, np.ndarray], file: str, places: CsvTable | None, warnings: list[Problem] | None
) -> None:
    for name, array in found.items():
        bad = np.flatnonzero(~np.isfinite(array))
        if len(bad) and warnings is not None:
            place = places.place(int(bad[0]), name) if places is not None else Place(file)
            what = f"{len(bad)} of {len(array)} values are not finite, the first is sample {bad[0] + 1}"
            warnings.append(Problem(what, f"column {name}", place, severity="warning"))


# --- one function a format: (path, wanted names, name to show) -> columns, and where their cells are --------------

_Found = tuple[dict[str, np.ndarray], CsvTable | None]


def _csv(path: Path, wanted: Sequence[str], file: str) -> _Found:
    table = CsvTable(path, file)
    _check_names(wanted, table.names, file)
    return table.read(wanted), table


def _npz(path: Path, wanted: Sequence[str], file: str) -> _Found:
    with zipfile.ZipFile(path) as archive:
        sizes = {info.filename.removesuffix(".npy"): _unpacked(archive, info) for info in archive.infolist()}
    with open(path, "rb") as opened, np.load(opened, allow_pickle=False) as arrays:
        known: dict[str, Callable[[], Any]] = {name: lambda name=name: arrays[name] for name in arrays.files}  # type: ignore[misc]
        return _pick(known, wanted, file, lambda name: sizes.get(name, 0)), None


def _unpacked(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> int:
    """Return the bytes that an array of an archive takes as double precision, by its header."""
    try:
        with archive.open(info) as stream:
            major, _ = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
            shape = read(stream)[0]
        return max(math.prod(shape) * 8, info.file_size)
    except Exception:  # said when the array is read
        return info.file_size


def _mat(path: Path, wanted: Sequence[str], file: str) -> _Found:
    from scipy.io import loadmat, whosmat

    try:
        sizes = {name: int(np.prod(shape, dtype=float)) * 8 for name, shape, _ in whosmat(str(path))}
    except NotImplementedError:  # version 7.3 is HDF5
        return _h5(path, wanted, file, transposed=True)
    _check_unpacked(path, file)
    tops = {re.split(r"[./\[]", name)[0] for name in wanted}
    _check_sizes({name: size for name, size in sizes.items() if name in tops}, file)
    tree = loadmat(str(path), variable_names=sorted(tops), simplify_cells=True)
    leaves = dict(_leaves({name: value for name, value in tree.items() if not name.startswith("__")}))
    known: dict[str, Callable[[], Any]] = {name: (lambda value=value: value) for name, value in leaves.items()}  # type: ignore[misc]
    rest = {name: tuple for name in sizes if name not in tops}  # not loaded: only as near misses
    return _pick({**known, **rest}, wanted, file), None


def _check_unpacked(path: Path, file: str) -> None:
    """Refuse a .mat (version 5) whose packed elements are larger than what is read, however they are nested."""
    total = 0
    with path.open("rb") as stream:
        head = stream.read(128)
        order: Literal["little", "big"] = "big" if head[126:128] == b"MI" else "little"
        while len(tag := stream.read(8)) == 8 and head[126:128] in (b"MI", b"IM"):
            kind, size = (int.from_bytes(part, order) for part in (tag[:4], tag[4:]))
            if kind != 15:  # not packed
                stream.seek(size, 1)
                continue
            unpack, left = zlib.decompressobj(), size
            while left > 0 and (data := stream.read(min(left, BLOCK))):
                left -= len(data)
                while data:
                    total += len(unpack.decompress(data, BLOCK))
                    data = unpack.unconsumed_tail
                    if total > MAX_BYTES:
                        raise RotorsimError(_too_large("it unpacks to", file))


def _leaves(tree: Mapping[str, Any], above: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, dict) and depth < 20:
            yield from _leaves(value, f"{above}{name}/", depth + 1)
        else:
            yield above + name, value


def _h5(path: Path, wanted: Sequence[str], file: str, transposed: bool = False) -> _Found:
    import h5py

    with h5py.File(path, "r") as tree:
        sets: dict[str, Any] = {}
        for name in wanted:
            for path_in_file in _spellings(name):
                item = _inside(tree, path_in_file)
                if item is not None:
                    sets[path_in_file] = item
        if not all(any(spelling in sets for spelling in _spellings(name)) for name in wanted):
            sets |= {name: item for name, item in _listed(tree).items() if name not in sets}  # for near misses

        def reader(item: Any) -> Callable[[], Any]:
            return lambda: item[()].T if transposed else item[()]

        known = {name: reader(item) for name, item in sets.items()}
        return _pick(known, wanted, file, lambda name: int(sets[name].size or 0) * 8), None


def _spellings(name: str) -> list[str]:
    """Return the paths that a wanted name may stand for: itself, with '/' for '.', without an index."""
    part = _PART.fullmatch(name)
    names = [name, *([part[1]] if part is not None else [])]
    return [spelling for one in names for spelling in dict.fromkeys((one, one.replace(".", "/")))]


def _inside(tree: Any, name: str) -> Any:
    """Return the data set of a path, or None; links out of the file are not followed."""
    import h5py

    item = tree
    steps = name.split("/")
    for step in steps if len(steps) <= MAX_DEPTH and "" not in steps and "." not in steps else ("",):
        if not step or not isinstance(item, h5py.Group) or not isinstance(item.get(step, getlink=True), h5py.HardLink):
            return None
        item = item[step]
    return item if isinstance(item, h5py.Dataset) and not item.external and not item.is_virtual else None


def _listed(tree: Any) -> dict[str, Any]:
    """Return the first data sets of a file by path: some MAX_NAMES of them, in no more than MAX_DEPTH groups."""
    import h5py

    found: dict[str, Any] = {}
    groups = [("", tree, 1)]
    seen = 0
    while groups and seen < MAX_NAMES:
        above, group, depth = groups.pop(0)
        for step in islice(group, MAX_NAMES - seen):
            seen += 1
            item = _inside(group, step) if "/" not in step else None
            if item is not None:
                found[above + step] = item
            elif depth < MAX_DEPTH and isinstance(group.get(step, getlink=True), h5py.HardLink):
                inner = group[step]
                groups += [(f"{above}{step}/", inner, depth + 1)] if isinstance(inner, h5py.Group) else []
    return found


def _tdms(path: Path, wanted: Sequence[str], file: str) -> _Found:
    package = _optional("nptdms", "npTDMS", file)
    with path.open("rb") as stream, package.TdmsFile.open(stream) as tree:
        channels = [(group.name, channel) for group in tree.groups() for channel in group.channels()]
        known: dict[str, Callable[[], Any]] = {}
        sizes: dict[str, int] = {}
        for name, channel in _unique((channel.name, f"{group}/{channel.name}", channel) for group, channel in channels):
            known[name], sizes[name] = (lambda channel=channel: channel[:]), len(channel) * 8  # type: ignore[misc]
        if channels and OWN_TIME not in known:
            known[OWN_TIME] = channels[0][1].time_track
        return _pick(known, wanted, file, lambda name: sizes.get(name, 0)), None


def _uff(path: Path, wanted: Sequence[str], file: str) -> _Found:
    package = _optional("pyuff", "pyuff", file)
    reader = package.UFF(str(path))
    sets = [reader.read_sets(k) for k, kind in enumerate(reader.get_set_types()) if int(kind) == 58]
    named = []
    for data in sets:
        degree = f"{data.get('rsp_node', 0)}/{data.get('rsp_dir', 0)}"  # response node and direction, as in 3/1
        title = str(data.get("id1", "")).strip()
        named.append((title if title not in ("", "NONE") else degree, degree, data))
    known: dict[str, Callable[[], Any]] = {}
    for name, data in _unique(named):
        known[name] = lambda data=data: np.ravel(data["data"])  # type: ignore[misc]
    if sets and OWN_TIME not in known:
        known[OWN_TIME] = lambda: np.ravel(sets[0]["x"])
    return _pick(known, wanted, file), None


def _mf4(path: Path, wanted: Sequence[str], file: str) -> _Found:
    package = _optional("asammdf", "asammdf", file)
    with package.MDF(str(path)) as tree:
        known: dict[str, Callable[[], Any]] = {}
        for name, places in tree.channels_db.items():
            if len(places) == 1:
                known[name] = lambda name=name: tree.get(name).samples  # type: ignore[misc]
        signal = next((name for name in wanted if name in known and name != OWN_TIME), None)
        if signal is not None:
            known[OWN_TIME] = lambda: tree.get(signal).timestamps
        return _pick(known, wanted, file), None


_READERS: dict[str, Callable[[Path, Sequence[str], str], _Found]] = {
    ".csv": _csv,
    ".npz": _npz,
    ".mat": _mat,
    ".h5": _h5,
    ".hdf5": _h5,
    ".tdms": _tdms,
    ".uff": _uff,
    ".unv": _uff,
    ".mf4": _mf4,
}
SUFFIXES = tuple(_READERS)


# --- what the formats share ---------------------------------------------------------------------------------------


def _optional(module: str, package: str, file: str) -> Any:
    try:
        return import_module(module)
    except ImportError:
        what = f"reading this format needs the package {package}"
        raise RotorsimError(Problem(what, place=Place(file), hint=f"pip install {package}")) from None


def _unique(named: Iterable[tuple[str, str, Any]]) -> Iterator[tuple[str, Any]]:
    """Yield each item under its long name, and under its short one where no other has it."""
    items = list(named)
    shorts = [short for short, _, _ in items]
    for short, long, item in items:
        yield long, item
        if shorts.count(short) == 1:
            yield short, item


def _check_names(wanted: Sequence[str], known: Sequence[str], file: str) -> None:
    problems = [
        Problem(f"no column '{name}'", place=Place(file), hint=near_miss(name, known) or "the file names no columns")
        for name in wanted
        if name not in known
    ]
    if problems:
        raise RotorsimError(*problems)


def _check_sizes(sizes: Mapping[str, int], file: str) -> None:
    problems = [
        Problem(f"column '{name}' is larger than {MAX_BYTES // 10**9} GB", place=Place(file))
        for name, size in sizes.items()
        if size > MAX_BYTES
    ]
    total = sum(sizes.values())
    if not problems and total > MAX_BYTES:
        problems = [_too_large(f"{len(sizes)} columns take {total / 1e9:.3g} GB", file)]
    if problems:
        raise RotorsimError(*problems)


def _too_large(what: str, file: str) -> Problem:
    limit = f"{MAX_BYTES // 10**9} GB"
    text = f"{what}, more than {limit}" if what[-1:] == "B" else f"{what} more than {limit}"
    return Problem(text, place=Place(file), hint="split it into several runs")


def _pick(
    known: Table, wanted: Sequence[str], file: str, size: Callable[[str], int] = lambda name: 0
) -> dict[str, np.ndarray]:
    """Return the wanted columns of a table that may hold two-dimensional arrays and paths."""
    homes: dict[str, tuple[str, int | None]] = {}
    for name in wanted:
        whole, part = name, _PART.fullmatch(name)
        if name not in known and name.replace(".", "/") in known:
            whole = name.replace(".", "/")
        if whole not in known and part is not None:
            base = part[1] if part[1] in known else part[1].replace(".", "/")
            homes[name] = (base, int(part[2]) - 1)
        else:
            homes[name] = (whole, None)
    missing = [name for name, (home, _) in homes.items() if home not in known]
    if missing:
        _check_names(missing, list(known), file)
    _check_sizes({home: size(home) for home, _ in homes.values()}, file)
    problems: list[Problem] = []
    found: dict[str, np.ndarray] = {}
    for name, (home, index) in homes.items():
        with _noted(name, file, problems):
            found[name] = _vector(np.asarray(known[home]()), index, name)
    if problems:
        raise RotorsimError(*problems)
    return found


@contextmanager
def _noted(name: str, file: str, problems: list[Problem]) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # foreign readers raise anything on a damaged file
        said = (str(error).splitlines() or [type(error).__name__])[0][:120]
        hint = "save plain numbers: pickled objects are never read" if "allow_pickle" in said else ""
        said = "it holds Python objects" if hint else said
        problems.append(Problem(f"column '{name}' cannot be read: {said}", place=Place(file), hint=hint))


def _vector(array: np.ndarray, index: int | None, name: str) -> np.ndarray:
    """Return real numbers (n,) of an array (n,), (n, 1), (1, n), or of one column of (n, k)."""
    if index is not None:
        if array.ndim != 2 or index >= array.shape[1]:
            raise ValueError(f"its array has shape {array.shape}: no column {index + 1}")
        array = array[:, index]
    if array.ndim > 1 and max(array.shape) == array.size:
        array = array.ravel()
    if array.ndim > 1:
        raise ValueError(f"its array has shape {array.shape}; name one column, as in '{name}[1]'")
    if array.dtype.kind not in "biuf":
        raise ValueError(f"it holds {array.dtype}, not real numbers")
    return np.ascontiguousarray(np.atleast_1d(array), dtype=float)
