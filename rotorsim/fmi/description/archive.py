"""FMU and SSP archives: read and unpacked within limits of names, counts and sizes; nothing outside the folder.

An archive is foreign data. Refused: names that leave the folder (``..``, absolute, drive, backslash), links and
devices, encryption, methods other than stored and deflated, names that are file and folder at once, too many files,
too many bytes, and bombs (more bytes than `RATIO` times those of the archive). Sizes are counted while unpacking:
what the archive says about itself is not trusted.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import stat
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from types import TracebackType

from rotorsim.errors import Place, Problem, RotorsimError

_CHUNK = 1 << 18
_DIRECTORY = 1 << 22  # bytes of the list of files at the end of an archive
_SHOWN = 5  # problems of one kind
_DRIVE = re.compile(r"[A-Za-z]:")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
_FOLDS_CASE = sys.platform in ("win32", "darwin")


@dataclass(frozen=True)
class Limits:
    """What an archive may hold: files, bytes unpacked, and bytes unpacked over bytes packed beyond `free` bytes."""

    files: int = 10_000
    bytes: int = 2 << 30
    ratio: float = 200.0
    free: int = 16 << 20


class Archive(contextlib.AbstractContextManager["Archive"]):
    """An archive opened for reading; a context manager.

    names: files, as the archive spells them; warnings: files that are there twice, where the last counts.
    Raises RotorsimError with every mistake found.
    """

    def __init__(self, path: str | Path, limits: Limits | None = None) -> None:
        self.path, self.limits = Path(path), limits or Limits()
        self.place = Place(str(path))
        self.warnings: list[Problem] = []
        self._stream = _open(self.path, self.place)
        try:
            with self._translated():
                self._zip = zipfile.ZipFile(self._stream)
                self.members = self._zip.infolist()
            problems = list(self._problems())
            if problems:
                raise RotorsimError(*problems)
        except BaseException:
            self._stream.close()
            raise
        self._files = {member.filename: member for member in self.members if not member.is_dir()}
        self.names = tuple(self._files)

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._zip.close()
        self._stream.close()

    def __contains__(self, name: object) -> bool:
        return name in self._files

    def read(self, name: str, most: int) -> bytes:
        """Return the bytes of a file of at most ``most`` bytes."""
        if name not in self._files:
            shown = ", ".join([*map(_shown, self.names[:_SHOWN]), *(["..."] if len(self.names) > _SHOWN else [])])
            hint = f"it holds {shown}" if shown else "it is empty"
            raise RotorsimError(Problem(f"there is no {name} in the archive", place=self.place, hint=hint))
        with self._translated(), self._zip.open(self._files[name]) as stream:
            data = stream.read(most + 1)
        if len(data) > most:
            raise RotorsimError(Problem(f"{name} has more than {most} bytes", place=self.place))
        return data

    def peek(self, name: str, count: int) -> bytes:
        """Return the first bytes of a file."""
        with self._translated(), self._zip.open(self._files[name]) as stream:
            return stream.read(count)

    def unpack(self, folder: Path, wanted: Callable[[str], bool] = lambda name: True) -> list[str]:
        """Write the wanted files into an existing empty folder that is ours alone; return their names."""
        self._left = self._allowed()
        written = [name for name in self._files if wanted(name)]
        for name in written:
            target = folder.joinpath(*name.split("/"))
            target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._write(self._files[name], target)
        return written

    def _write(self, member: zipfile.ZipInfo, target: Path) -> None:
        descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o600)
        with open(descriptor, "wb", buffering=0) as output, self._translated(), self._zip.open(member) as stream:
            while data := stream.read(_CHUNK):
                self._left -= len(data)
                if self._left < 0:
                    raise RotorsimError(self._too_large())
                left = memoryview(data)
                try:
                    while left:
                        left = left[output.write(left) :]
                except OSError as error:
                    hint = "is the disk full? FMUs at work are unpacked where the variable TMPDIR says"
                    what = f"cannot be unpacked into {target.parent}: {(error.strerror or str(error)).lower()}"
                    raise RotorsimError(Problem(what, place=self.place, hint=hint), exit_code=1) from None

    def _allowed(self) -> int:
        """Return how many bytes may be unpacked in all."""
        packed = os.fstat(self._stream.fileno()).st_size
        return int(min(self.limits.bytes, max(self.limits.free, self.limits.ratio * packed)))

    def _too_large(self) -> Problem:
        what = f"unpacks to more than {self._allowed() / 1e6:.0f} MB: taken for a bomb"
        hint = "if it is none: pack it anew without compression (zip -0), or allow more in Python: Limits(ratio=...)"
        return Problem(what, place=self.place, hint=hint)

    def _problems(self) -> Iterator[Problem]:
        """Yield what is wrong with the list of files."""
        if len(self.members) > self.limits.files:
            yield Problem(f"holds {len(self.members)} files; {self.limits.files} are allowed", place=self.place)
            return
        if sum(member.file_size for member in self.members) > self._allowed():
            yield self._too_large()
        wrong = [f"{_shown(m.orig_filename)}: {why}" for m in self.members if (why := _wrong(m))]
        hint = "this archive is hostile or damaged"
        yield from (Problem(what, place=self.place, hint=hint) for what in wrong[:_SHOWN])
        if len(wrong) > _SHOWN:
            yield Problem(f"... and {len(wrong) - _SHOWN} more such files", place=self.place)
        if not wrong:
            yield from self._doubles()

    def _doubles(self) -> Iterator[Problem]:
        """Yield what is file and folder at once; files that are there twice by the same name are warnings."""
        is_folder: dict[str, bool] = {}
        files: dict[str, zipfile.ZipInfo] = {}
        for member in self.members:
            name = member.filename.rstrip("/")
            *above, whole = accumulate((name.casefold() if _FOLDS_CASE else name).split("/"), "{}/{}".format)
            again = whole in is_folder and not (is_folder[whole] and member.is_dir())
            first = files.get(member.filename)
            if again and first and not member.is_dir():
                same = (first.CRC, first.file_size) == (member.CRC, member.file_size)
                what = "both are alike" if same else "they differ, and the last is used; other tools may use the first"
                text = f"{_shown(member.filename)}: is in the archive twice: {what}"
                self.warnings.append(Problem(text, place=self.place, severity="warning"))
            elif again or not all(is_folder.get(folder, True) for folder in above):
                yield Problem(f"{_shown(name)}: is in the archive twice", place=self.place)
                return
            files[member.filename] = member
            is_folder |= {**dict.fromkeys(above, True), whole: member.is_dir()}
        del self.warnings[_SHOWN:]

    @contextlib.contextmanager
    def _translated(self) -> Iterator[None]:
        """Turn whatever the zip reader raises on damaged data into words."""
        try:
            yield
        except (
            zipfile.BadZipFile,
            zlib.error,
            struct.error,
            EOFError,
            NotImplementedError,
            RuntimeError,
            ValueError,
            OverflowError,
            IndexError,
            KeyError,
            OSError,
        ) as error:
            if isinstance(error, OSError) and error.filename is not None:
                raise
            why = " ".join(str(error).split())[:200] or type(error).__name__
            hint = "is the download complete? FMUs and systems (SSP) are zip archives"
            raise RotorsimError(Problem(f"not a readable archive: {why}", place=self.place, hint=hint)) from None


def check_name(name: str) -> str:
    """Return why a name inside an archive is refused, or "" if it is fine."""
    parts = name.rstrip("/").split("/")
    longest = max(len(part.encode("utf-8", "surrogatepass")) for part in parts)
    on_windows = [_RESERVED.fullmatch(part) or part[-1:] in (".", " ") or set(part) & set('<>:"|?*') for part in parts]
    reasons = {
        "the name is empty or has control characters": not name or _CONTROL.search(name),
        "the name has a backslash": "\\" in name,
        "the name is absolute": name.startswith("/") or _DRIVE.match(name),
        "the name leaves its folder": any(part in ("", ".", "..") for part in parts),
        "the name is too long": len(name) > 500 or longest > 200 or len(parts) > 32,
        "the name is not text": any("\ud800" <= character <= "\udfff" for character in name),
        "the name cannot be used on Windows": sys.platform == "win32" and any(on_windows),
    }
    return next((why for why, is_so in reasons.items() if is_so), "")


def _wrong(member: zipfile.ZipInfo) -> str:
    """Return why one entry is refused, or ""."""
    kind = stat.S_IFMT(member.external_attr >> 16)
    reasons = {
        check_name(member.orig_filename) or check_name(member.filename): True,
        "is a link": kind == stat.S_IFLNK,
        "is not a plain file": kind not in (0, stat.S_IFREG, stat.S_IFDIR),
        "is encrypted": member.flag_bits & 0x1,
        "is packed by a method other than deflate": member.compress_type
        not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED),
    }
    return next((why for why, is_so in reasons.items() if why and is_so), "")


def _open(path: Path, place: Place) -> _Guarded:
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISDIR(mode):
            raise RotorsimError(Problem("is a folder", place=place, hint="give the .fmu file itself"))
        if not stat.S_ISREG(mode):
            raise RotorsimError(Problem("is not a plain file", place=place))
        return _Guarded(path, place)
    except FileNotFoundError:
        raise RotorsimError(Problem("file does not exist", place=place, hint="is the path right?")) from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise RotorsimError(Problem(f"file cannot be read: {why}", place=place)) from None


class _Guarded(io.BufferedReader):
    """A file that refuses to be read in large pieces: the list of files of a hostile archive may be one."""

    def __init__(self, path: Path, place: Place) -> None:
        super().__init__(io.FileIO(path))
        self._place = place

    def read(self, size: int | None = -1, /) -> bytes:
        most = _DIRECTORY + 1
        data = super().read(most if size is None or size < 0 else min(size, most))
        if len(data) == most:
            raise RotorsimError(Problem("the list of its files is too long", place=self._place))
        return data


def _shown(name: str) -> str:
    text = name.encode("unicode_escape", "replace").decode("ascii")
    return f"'{text}'" if len(text) <= 80 else f"'{text[:77]}...'"
