"""Libraries for other platforms: by ziglang where it is installed (CI installs it), their format checked."""

from __future__ import annotations

import importlib.util
import struct
import zipfile

import pytest

from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.platforms import library_folder
from rotorsim.fmi.export import build
from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.load import load


def elf(machine: int) -> bytes:
    return b"\x7fELF\x02\x01\x01" + bytes(9) + struct.pack("<HH", 3, machine)


def pe(machine: int) -> bytes:
    return b"MZ" + bytes(58) + struct.pack("<I", 64) + b"PE\0\0" + struct.pack("<H", machine)


def mach(processor: int) -> bytes:
    return struct.pack("<II", 0xFEEDFACF, 0x01000000 + processor)


FORMATS = {
    "x86_64-linux": elf(0x3E),
    "aarch64-linux": elf(0xB7),
    "x86_64-windows": pe(0x8664),
    "aarch64-windows": pe(0xAA64),
    "x86_64-darwin": mach(7),
    "aarch64-darwin": mach(12),
}


@pytest.mark.parametrize("name", FORMATS)
def test_formats_are_told_apart_by_their_heads(name):
    assert build.binary_kind(FORMATS[name]) == name


@pytest.mark.parametrize("head", [b"", b"MZ", b"\x7fELF\x01" + bytes(40), elf(0x28), b"MZ" + b"\xff" * 70, bytes(64)])
def test_other_files_are_of_no_platform(head):
    assert build.binary_kind(head) == ""


def test_a_library_of_another_format_is_not_put_into_an_fmu(tmp_path, monkeypatch):
    monkeypatch.setenv("ROTORSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(build, "binary_kind", lambda library: "x86_64-beos")
    with pytest.raises(RotorsimError, match="the compiler made a library for x86_64-beos"):
        export_fmu(load("jeffcott"), tmp_path / "x.fmu")
    assert not (tmp_path / "x.fmu").exists()


def test_what_the_compiler_says_is_passed_on(tmp_path, monkeypatch):
    monkeypatch.setenv("ROTORSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(build, "FLAGS", (*build.FLAGS, "-fno-such-option"))
    with pytest.raises(RotorsimError, match=r"the C compiler failed: .*no-such-option"):
        export_fmu(load("jeffcott"), tmp_path / "x.fmu")


def test_a_damaged_library_of_the_cache_is_not_put_into_an_fmu(tmp_path, monkeypatch):
    monkeypatch.setenv("ROTORSIM_CACHE", str(tmp_path / "cache"))
    sources, here = {"a.c": b"int a(void) { return 1; }"}, build.find_platforms(None)[0]
    first = build.build_library(sources, here, "-O1")
    [kept] = (tmp_path / "cache").iterdir()
    assert kept.read_bytes() == first
    kept.write_bytes(first[:5000])
    assert build.build_library(sources, here, "-O1") == first
    assert kept.read_bytes() == first


def test_names_of_platforms_of_both_versions():
    both = [build.find_platforms([name]) for name in ("linux64", "x86_64-linux")]
    assert both[0] == both[1]
    assert build.find_platforms(["win64", "darwin64", "x86_64-windows"]) == ["x86_64-windows", "x86_64-darwin"]
    (platform,) = build.find_platforms(["aarch64-linux"])
    assert [library_folder(platform, version) for version in ("2.0", "3.0")] == ["aarch64-linux", "aarch64-linux"]


@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="ziglang is not installed")
def test_one_file_for_several_platforms(tmp_path):
    names = ["linux64", "aarch64-linux", "darwin64", "aarch64-darwin"]  # windows takes minutes the first time
    done = export_fmu(load("jeffcott"), tmp_path / "x.fmu", version="3.0", platforms=names)
    assert list(done.libraries) == ["x86_64-linux", "aarch64-linux", "x86_64-darwin", "aarch64-darwin"]
    with zipfile.ZipFile(tmp_path / "x.fmu") as archive:
        for folder in done.libraries:
            suffix = build.suffix_of(folder)
            assert build.binary_kind(archive.read(f"binaries/{folder}/jeffcott{suffix}")) == folder
