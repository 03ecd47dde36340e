"""Hostile archives: refused by name, within limits, and nothing is ever written outside."""

from __future__ import annotations

import random
import signal
import stat
import struct
import sys
import warnings
import zipfile
from pathlib import Path

import pytest

from benchmarks.fmi.fuzz import damaged, sandbox, try_case
from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.archive import Archive, Limits
from tests.fmi.plant import make_fmu


def written(file: Path, *entries: tuple[str, bytes]) -> Path:
    """Write an archive whose names are exactly those given."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, data in entries:
            info = zipfile.ZipInfo("x")
            info.filename = info.orig_filename = name
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)
    return file


def refusal(file: Path, **limits: float) -> str:
    """Return why an archive is not opened, or not unpacked."""
    out = file.parent / "out"
    try:
        with Archive(file, Limits(**limits)) as archive:  # type: ignore[arg-type]
            out.mkdir()
            archive.unpack(out)
    except RotorsimError as error:
        return error.problems[0].what
    return "it was unpacked"


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("../evil", "the name leaves its folder"),
        ("a/../../evil", "the name leaves its folder"),
        ("a/./b", "the name leaves its folder"),
        ("a//b", "the name leaves its folder"),
        ("/evil", "the name is absolute"),
        ("C:/evil", "the name is absolute"),
        ("c:evil", "the name is absolute"),
        ("..\\evil", "the name has a backslash"),
        ("a\nb", "the name is empty or has control characters"),
        ("a\0b", "the name is empty or has control characters"),
        ("x" * 300, "the name is too long"),
        ("x/" * 40 + "y", "the name is too long"),
    ],
)
def test_names(tmp_path: Path, name: str, why: str) -> None:
    assert refusal(written(tmp_path / "a.zip", ("good", b""), (name, b"evil"))).endswith(f"': {why}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zip"]


@pytest.mark.parametrize(
    ("mode", "why"),
    [(stat.S_IFLNK, "is a link"), (stat.S_IFCHR, "is not a plain file"), (stat.S_IFIFO, "is not a plain file")],
)
def test_links_and_devices(tmp_path: Path, mode: int, why: str) -> None:
    info = zipfile.ZipInfo("resources")
    info.create_system, info.external_attr = 3, (mode | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr(info, "/etc")
        archive.writestr("resources/passwd", "evil")
    assert refusal(tmp_path / "a.zip") == f"'resources': {why}"


def test_a_name_twice_warns_and_the_last_counts(tmp_path: Path) -> None:
    with Archive(written(tmp_path / "a.zip", ("a", b"1"), ("b", b"2"), ("a", b"3"), ("b", b"2"))) as archive:
        assert [(problem.severity, problem.what) for problem in archive.warnings] == [
            (
                "warning",
                "'a': is in the archive twice: they differ, and the last is used; other tools may use the first",
            ),
            ("warning", "'b': is in the archive twice: both are alike"),
        ]
        assert archive.read("a", 9) == b"3"
        (tmp_path / "out").mkdir()
        assert sorted(archive.unpack(tmp_path / "out")) == ["a", "b"]
    assert (tmp_path / "out" / "a").read_bytes() == b"3"


def test_a_file_that_is_a_folder_too(tmp_path: Path) -> None:
    assert refusal(written(tmp_path / "b.zip", ("a", b"1"), ("a/b", b"2"))) == "'a/b': is in the archive twice"
    with Archive(written(tmp_path / "c.zip", ("a/", b""), ("a/b", b"2"))) as archive:
        assert archive.names == ("a/b",)


def test_a_bomb_by_what_it_says(tmp_path: Path) -> None:
    file = written(tmp_path / "a.zip", ("zeros", bytes(20 << 20)))
    assert refusal(file) == "unpacks to more than 17 MB: taken for a bomb"


def test_a_bomb_that_lies_about_its_size(tmp_path: Path) -> None:
    file = written(tmp_path / "a.zip", ("zeros", bytes(20 << 20)))
    data = bytearray(file.read_bytes())
    at = data.rindex(b"PK\x01\x02")
    struct.pack_into("<I", data, at + 24, 1000)
    struct.pack_into("<I", data, data.index(b"PK\x03\x04") + 22, 1000)
    file.write_bytes(data)
    assert refusal(file).startswith("not a readable archive: Bad CRC-32")
    assert sum(path.stat().st_size for path in (tmp_path / "out").rglob("*")) <= 1000


@pytest.mark.skipif(sys.platform == "win32", reason="limits of resources are those of POSIX")
@pytest.mark.parametrize("size", [100, 1 << 20])
def test_a_full_disk_is_not_the_fault_of_the_archive(tmp_path: Path, size: int) -> None:
    """Files may have 50 bytes: the write fails as on a full disk."""
    file = written(tmp_path / "a.zip", ("data", random.Random(1).randbytes(size)))
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    heard = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50, before[1]))
    try:
        what = refusal(file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, heard)
    assert what == f"cannot be unpacked into {tmp_path / 'out'}: file too large"


@pytest.mark.slow
def test_thousands_of_files(tmp_path: Path) -> None:
    file = written(tmp_path / "a.zip", *((str(k), b"") for k in range(101)))
    assert refusal(file, files=100) == "holds 101 files; 100 are allowed"
    many = written(tmp_path / "b.zip", *((f"{k:0100d}", b"") for k in range(30_000)))
    assert refusal(many) == "the list of its files is too long"


def test_encryption_and_strange_methods(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a", b"1")
    assert refusal(tmp_path / "a.zip") == "'a': is packed by a method other than deflate"
    file = written(tmp_path / "b.zip", ("a", b"1"))
    data = bytearray(file.read_bytes())
    data[data.rindex(b"PK\x01\x02") + 8] |= 1
    file.write_bytes(data)
    assert refusal(file) == "'a': is encrypted"


def test_what_is_no_archive(tmp_path: Path) -> None:
    (tmp_path / "a.fmu").write_bytes(b"hello")
    assert refusal(tmp_path / "a.fmu") == "not a readable archive: File is not a zip file"
    assert refusal(tmp_path / "none.fmu") == "file does not exist"
    assert refusal(tmp_path) == "is a folder"


def test_files_are_read_and_unpacked(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with Archive(written(tmp_path / "a.zip", ("a/b", b"1234"), ("c", b"5"), ("sources/d", b"6"))) as archive:
        assert archive.read("a/b", 4) == b"1234"
        assert archive.unpack(tmp_path / "out", lambda name: not name.startswith("sources/")) == ["a/b", "c"]
        with pytest.raises(RotorsimError, match="a/b has more than 3 bytes"):
            archive.read("a/b", 3)
        with pytest.raises(RotorsimError, match="it holds 'a/b', 'c', 'sources/d'"):
            archive.read("modelDescription.xml", 100)
    assert (tmp_path / "out" / "a" / "b").read_bytes() == b"1234"


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", pytest.param("3.0", marks=pytest.mark.slow)])
def test_damaged_at_random(tmp_path: Path, version: str) -> None:
    """No traceback, nothing outside, nothing left behind; many more by benchmarks/fmi/fuzz.py."""
    whole = make_fmu(tmp_path / "plant.fmu", version).read_bytes()
    with sandbox() as box:
        for k in range(40):
            what, data = damaged(random.Random(f"{version}/{k}"), whole)
            wrong, _ = try_case(box, data, run=k % 10 == 0)
            assert wrong == [], what
