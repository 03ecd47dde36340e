"""The store of a list of jobs: a file of JSON lines that keeps every result, so that an interrupted run resumes."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import IO, Any

from rotorsim.errors import Place, Problem, RotorsimError

Outcome = dict[str, Any]  # {"result": ...} or {"failure": {"type": ..., "text": ...}}


@contextmanager
def open_store(
    store: str | Path | None, function: Callable[[Any], Any], key: str, arguments: Sequence[Any]
) -> Iterator[tuple[dict[int, Outcome], Callable[[int, Outcome], None]]]:
    """Give the outcomes found in a store and a function that appends one; nobody else writes it meanwhile."""
    if store is None:
        yield {}, lambda index, outcome: None
        return
    place = Place(str(store))
    name = getattr(getattr(function, "func", function), "__qualname__", "")
    key = _hash([name, key])
    hashes = [_hash_of(index, argument) for index, argument in enumerate(arguments)]
    try:
        stream = Path(store).open("a+b")  # noqa: SIM115
    except OSError as error:
        raise RotorsimError(
            Problem(f"file cannot be written: {error.strerror or error}", place=place, hint="choose another file")
        ) from None

    def append(index: int, outcome: Outcome) -> None:
        line = {"index": index, "argument": hashes[index], "key": key, **outcome}
        try:
            stream.write(json.dumps(line).encode() + b"\n")
            stream.flush()
        except OSError as error:
            raise RotorsimError(
                Problem(
                    f"result cannot be written: {error.strerror or error}",
                    place=place,
                    hint="run again with the same store: the results so far are kept",
                ),
                exit_code=1,
            ) from None

    try:
        if not _lock(stream):
            raise RotorsimError(
                Problem(
                    "another process is writing this store",
                    place=place,
                    hint="wait until it is done, or give another file",
                )
            )
        yield _read(stream, place, key, hashes), append
    finally:
        with suppress(OSError):
            stream.close()


def _lock(stream: IO[bytes]) -> bool:
    """Lock a store until it is closed or this process ends, however it ends; False where another process has it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            stream.seek(2**31)  # such a lock forbids reading too
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        pass  # a file system without locks
    return True


def _read(stream: IO[bytes], place: Place, key: str, hashes: Sequence[str]) -> dict[int, Outcome]:
    """Return the results in a store, without failures; cut off a last line that was not written to its end."""
    outcomes: dict[int, Outcome] = {}
    start = b'{"index": '
    end = stream.seek(0)
    for number, line in enumerate(stream, start=1):
        if not line.endswith(b"\n") and (line.startswith(start) or start.startswith(line)):
            stream.truncate(end)
            break
        end += len(line)
        what, hint = "not the line of a store", "give another file"
        with suppress(ValueError, KeyError, TypeError, RecursionError):
            entry = json.loads(line)
            index, argument = entry["index"], entry["argument"]
            if entry["key"] != key:
                what = "this store belongs to another function or other settings"
            elif not 0 <= index < len(hashes):
                what = f"this store belongs to other jobs: it has a job {index}, the last one now is {len(hashes) - 1}"
            elif argument != hashes[index]:
                what = f"this store belongs to other jobs: job {index} had another argument"
            elif "result" in entry or "failure" in entry:
                outcomes.pop(index, None)
                if "result" in entry:
                    outcomes[index] = {"result": entry["result"]}
                continue
            hint = "give another file, or delete this one"
        raise RotorsimError(Problem(what, place=Place(place.file, number, 1), hint=hint))
    return outcomes


def _hash(data: Any) -> str:
    text = json.dumps(data, sort_keys=True, default=_described)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _hash_of(index: int, argument: Any) -> str:
    try:
        return _hash(argument)
    except (TypeError, ValueError, RecursionError) as error:
        raise RotorsimError(
            Problem(
                f"the argument is no plain data: {error}",
                f"job {index}",
                hint="with a store, arguments are dicts, lists, numbers, text, NumPy arrays or dataclasses",
            )
        ) from None


def _described(value: Any) -> Any:
    """Return what JSON has no word for as something that is the same whenever the value is the same."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__qualname__, {field.name: getattr(value, field.name) for field in fields(value)}]
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, complex):
        return ["complex", value.real, value.imag]
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__}")


def plain(value: Any) -> Any:
    """Return a result as JSON gives it back. Raises TypeError for what JSON cannot hold."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        for name in value:
            if not isinstance(name, str):
                raise TypeError(f"a job returned a mapping with the key {name!r}, which is no text")
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"a job returned a {type(value).__name__}, which JSON cannot hold")
