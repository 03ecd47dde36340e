"""What a format of measurement files declares, and what readers of arrays share.

A new format is one class with ``suffixes``, ``counted`` and ``read`` (see `Reader`) in a module of its own beside this
one, and an entry in the table of `rotorsim.recordings.readers.columns`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError, near_miss

MAX_RECORDING_BYTES = 2_000_000_000
MAX_SHOWN = 20  # columns of a file that has not the wanted one
OWN_TIME = "time"  # names the clock [s] that .tdms, .uff and .mf4 files have besides their channels
DAMAGED = "the suffix says another format than the file has, or the file was cut off: copy it again"
_PART = re.compile(r"(.+)\[([1-9][0-9]{0,8})\]")


@dataclass(frozen=True)
class Columns:
    """Columns of a measurement file: name -> (n,), as the numbers stand in it.

    place: line and column of a sample (from 0) of a column, where the format has them; without the name of the file.
    warnings: what is odd about the file but no mistake, placed likewise.
    """

    values: dict[str, np.ndarray]
    place: Callable[[int, str], Place] = lambda sample, column: Place()
    warnings: tuple[Problem, ...] = ()


class Reader(Protocol):
    """A format of measurement files."""

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Endings of its files, in lower case."""

    @property
    def counted(self) -> bool:
        """Whether a file says how many samples it has: one that was cut off is then refused, never read as shorter."""

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted.

        Raises RotorsimError with every mistake, without the name of the file, and anything on a damaged file.
        """


@dataclass(frozen=True)
class Array:
    """An array of a file: what reads it, and its size [bytes] in double precision (0: not known before).

    clock: what reads the times [s] of its samples, where the file says them.
    """

    read: Callable[[], Any]
    size: int = 0
    clock: Callable[[], Any] | None = None


def columns_of(arrays: Mapping[str, Array], wanted: Sequence[str]) -> Columns:
    """Return columns of arrays by name, which may be two-dimensional or have paths (``group/x``) for names.

    ``name[2]`` is the second column of a two-dimensional array. `OWN_TIME` is the array of that name, else the clock
    of what is wanted. Raises RotorsimError with every mistake.
    """
    homes = {name: next((home for home in spellings(name) if home[0] in arrays), (name, None)) for name in wanted}
    clocks = {name: clock for name, (home, _) in homes.items() if home in arrays and (clock := arrays[home].clock)}
    if clocks:
        arrays = {OWN_TIME: Array(lambda: _common(clocks)), **arrays}
    check_names([name for name, (home, _) in homes.items() if home not in arrays], list(arrays))
    sizes = {home: arrays[home].size for home, _ in homes.values()}
    limit, total = f"{MAX_RECORDING_BYTES // 10**9} GB", sum(sizes.values())
    problems = [
        Problem(f"column '{n}' is larger than {limit}") for n, size in sizes.items() if size > MAX_RECORDING_BYTES
    ]
    if problems:
        raise RotorsimError(*problems)
    refuse_large(total, f"{len(sizes)} columns take {total / 1e9:.3g} GB, more than")
    values: dict[str, np.ndarray] = {}
    for name, (home, index) in homes.items():
        try:
            values[name] = _vector(np.asarray(arrays[home].read()), index, name)
        except Exception as error:  # foreign readers raise anything on a damaged file
            said = (str(error).splitlines() or [type(error).__name__])[0][:120]
            hint = "save plain numbers: pickled objects are never read" if "allow_pickle" in said else ""
            said = "it holds Python objects" if hint else said
            problems.append(Problem(f"column '{name}' cannot be read: {said}", hint=hint))
    if problems:
        raise RotorsimError(*problems)
    return Columns(values)


def spellings(name: str) -> list[tuple[str, int | None]]:
    """Return what a wanted name may stand for, as path and column: itself, with '/' for '.', without an index."""
    part = _PART.fullmatch(name)
    named = [(name, None), *([(part[1], int(part[2]) - 1)] if part else [])]
    return [(path, index) for base, index in named for path in dict.fromkeys((base, base.replace(".", "/")))]


def refuse_large(size: float, what: str) -> None:
    """Raise RotorsimError for more bytes than are read."""
    if size > MAX_RECORDING_BYTES:
        raise RotorsimError(Problem(f"{what} {MAX_RECORDING_BYTES // 10**9} GB", hint="split it into several runs"))


def check_names(wanted: Iterable[str], known: Sequence[str], place: Place | None = None) -> None:
    """Raise RotorsimError for every name that is not known, with its near misses and the columns that are there.

    place: of the line that names the columns.
    """
    there = ", ".join(known[:MAX_SHOWN]) + (", ..." if len(known) > MAX_SHOWN else "")
    there = f"the file has {there}" if known else "the file names no columns"
    problems = [
        Problem(
            f"no column '{name}'", "", place or Place(), f"{near_miss(name, known, list_all=False)} {there}".strip()
        )
        for name in wanted
        if name not in known
    ]
    if problems:
        raise RotorsimError(*problems)


def cut_off(where: str) -> RotorsimError:
    """Return the error of a file that ends before its samples do."""
    hint = "copy it again, or save what is left by the program that recorded it"
    return RotorsimError(Problem(f"the file was cut off: {where}", hint=hint))


def optional_package(module: str, package: str) -> Any:
    """Return the module of an optional package. Raises RotorsimError where it is missing."""
    try:
        return import_module(module)
    except ImportError:
        what = f"reading this format needs the package {package}"
        raise RotorsimError(Problem(what, hint=f"pip install {package}")) from None


def by_unique_name(named: Iterable[tuple[str, str, Array]]) -> Iterator[tuple[str, Array]]:
    """Yield each array (short name, long name, array) by its long name, and by the short one where no other has it."""
    items = list(named)
    shorts = [short for short, _, _ in items]
    for short, long, array in items:
        yield long, array
        if shorts.count(short) == 1:
            yield short, array


def _common(clocks: Mapping[str, Callable[[], Any]]) -> np.ndarray:
    """Return the times that columns have in common. Raises ValueError where they differ by a part of a sample."""
    times = {name: np.asarray(clock(), dtype=float) for name, clock in clocks.items()}
    first, time = next(iter(times.items()))
    limit = 1e-3 * np.ptp(time) / len(time) if len(time) else 0.0
    for name, other in times.items():
        if other.shape != time.shape or np.abs(other - time).max(initial=0) > limit:
            raise ValueError(f"columns '{first}' and '{name}' were sampled at different times")
    return time


def _vector(array: np.ndarray, index: int | None, name: str) -> np.ndarray:
    """Return real numbers (n,) of an array (n,), (n, 1), (1, n), or of one column of (n, k)."""
    if index is not None:
        if array.ndim != 2 or index >= array.shape[1]:
            raise ValueError(f"its array has shape {array.shape}: no column {index + 1}")
        array = array[:, index]
    if array.ndim > 1 and max(array.shape) < array.size:
        raise ValueError(f"its array has shape {array.shape}; name one column, as in '{name}[1]'")
    if array.dtype.kind not in "biuf":
        raise ValueError(f"it holds {array.dtype}, not real numbers")
    return np.ascontiguousarray(array.ravel(), dtype=float)
