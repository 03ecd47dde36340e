"""The Jeffcott rotor as an FMU for other systems: size, build time, what the libraries say they are, and a Windows run.

python -m benchmarks.fmi.platforms [--out docs/cosimulation.md]

The rotor alone (`--block rotor`) and the whole diagram, by `export_fmu` for one platform at a time, with empty caches
(ours and ziglang's), then again. Libraries of other systems need ziglang (pip install ziglang); where it is missing,
the table says so. Where wine is installed, the Windows library is run by benchmarks/fmi/sources/fmu_host.c beside the
Linux one. Exit 1 where a library is not what it should be, or the runs differ.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.harness import ROOT, Line, at_most
from benchmarks.markers import expect, fill, table_text
from rotorsim.errors import RotorsimError
from rotorsim.fmi.export.build import PLATFORMS, own_platform
from rotorsim.fmi.export.export import export_fmu
from rotorsim.fmi.runtime.slave import describe_fmu
from rotorsim.model.load import load

HOST = ROOT / "benchmarks" / "fmi" / "sources" / "fmu_host.c"
WHAT: dict[str, list[str] | None] = {"rotor": ["rotor"], "whole diagram": None}
PROCESSORS = {
    "ELF": {0x3E: "x86_64", 0xB7: "aarch64"},
    "PE": {0x8664: "x86_64", 0xAA64: "aarch64"},
    "Mach-O": {0x01000007: "x86_64", 0x0100000C: "aarch64"},
}
SYSTEMS = {"ELF": "linux", "PE": "windows", "Mach-O": "darwin"}
SIGNATURE = 0x1D  # LC_CODE_SIGNATURE: macOS on arm64 loads no library without one
STEP, COUNT, EVERY = 1e-4, 5000, 10
SAME = 1e-12  # of the largest value: sin and cos of two C libraries differ in the last bit
WINE_LIMIT = 300.0  # s; the first start makes a prefix


@dataclass(frozen=True)
class Header:
    """What a library says of itself: format, code of the processor, whether it is a shared library; extras."""

    form: str
    machine: int
    shared: bool
    extra: str = ""

    @property
    def platform(self) -> str:
        """The platform as FMI 3 names it, "" if unknown."""
        processor = PROCESSORS.get(self.form, {}).get(self.machine, "")
        return f"{processor}-{SYSTEMS[self.form]}" if processor else ""

    def __str__(self) -> str:
        kind = "shared library" if self.shared else "no shared library"
        return f"{self.form}, machine {self.machine:#x}, {kind}{self.extra}"


def header(library: bytes) -> Header:
    """Read the header of a 64-bit library: System V ABI (ELF), Microsoft PE/COFF, Apple mach-o/loader.h."""
    if library[:6] == b"\x7fELF\x02\x01":
        kind, machine = struct.unpack_from("<HH", library, 16)
        return Header("ELF", machine, kind == 3)
    if library[:2] == b"MZ":
        (at,) = struct.unpack_from("<I", library, 60)
        if library[at : at + 4] == b"PE\0\0":
            machine, *_, flags = struct.unpack_from("<HHIIIHH", library, at + 4)
            return Header("PE", machine, bool(flags & 0x2000))
    if library[:4] == b"\xcf\xfa\xed\xfe":
        machine, _, kind, count = struct.unpack_from("<IIII", library, 4)
        at, signed = 32, False
        for _ in range(count):
            command, size = struct.unpack_from("<II", library, at)
            signed = signed or command == SIGNATURE
            at += size
        return Header("Mach-O", machine, kind == 6, ", signed" if signed else "")
    return Header("unknown", 0, False)


@contextlib.contextmanager
def empty_caches() -> Iterator[Path]:
    """Let libraries, and what ziglang builds for itself, be kept in an empty folder."""
    names = ("ROTORSIM_CACHE", "ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")
    before = {name: os.environ.get(name) for name in names}
    with tempfile.TemporaryDirectory(prefix="platforms-") as folder:
        os.environ |= {name: str(Path(folder) / name.lower()) for name in names}
        try:
            yield Path(folder)
        finally:
            for name, value in before.items():
                os.environ.pop(name)
                if value is not None:
                    os.environ[name] = value


def libraries(folder: Path) -> tuple[list[list[str]], list[Line]]:
    """Export everything for every platform into a folder; return the rows of the table, and what is promised."""
    diagram = load("jeffcott")
    rows, lines = [], []
    for platform in PLATFORMS.values():
        for what, blocks in WHAT.items():
            file = folder / f"{platform.name}-{what.partition(' ')[0]}.fmu"
            seconds = []
            try:
                for _ in range(2):
                    begun = time.perf_counter()
                    export_fmu(diagram, file, blocks=blocks, platforms=[platform.name])
                    seconds.append(time.perf_counter() - begun)
            except RotorsimError as error:
                rows.append([platform.name, what, "not built", "", "", error.problems[0].what])
                continue
            with zipfile.ZipFile(file) as archive:
                [name] = [name for name in archive.namelist() if name.startswith("binaries/")]
                library = archive.read(name)
            found = header(library)
            ok = found.platform == platform.name and found.shared and b"fmi2DoStep" in library
            if platform.name == "aarch64-darwin":
                ok = ok and "signed" in found.extra
            times = [f"{value:.2f} s" for value in seconds]
            rows.append([platform.name, what, f"{len(library) / 1e3:.0f} kB", *times, str(found)])
            lines.append(Line(f"{platform.name}, {what}: {found}", found.platform, platform.name, ok))
    return rows, lines


def windows(folder: Path) -> tuple[str, list[Line]]:
    """Run the libraries of the whole diagram for Windows and Linux by one host; return a sentence, and the target."""
    here, there = folder / "x86_64-linux-whole.fmu", folder / "x86_64-windows-whole.fmu"
    wine = shutil.which("wine64") or shutil.which("wine") or shutil.which("/usr/lib/wine/wine64")
    if own_platform() is not PLATFORMS["x86_64-linux"]:
        return "The Windows library was not run: wine is tried on x86_64 Linux only.", []
    if not there.is_file():
        return "The Windows library was not run: without ziglang there is none.", []
    if wine is None:
        return "The Windows library was not run: neither wine64 nor wine is installed.", []
    what = "x86_64-windows by wine, against x86_64-linux, of the largest value"
    try:
        linux = _run(here, "host", ["-ldl"], [], folder)
        foreign = _run(there, "host.exe", ["-target", "x86_64-windows-gnu"], [wine], folder)
    except (subprocess.SubprocessError, OSError) as error:
        said = str(getattr(error, "stderr", "") or error).strip()[-300:]
        return f"The Windows library did not run under {Path(wine).name}: {said}", [Line(what, "failed", "", False)]
    apart = np.abs(foreign - linux).max(axis=0) / np.abs(linux).max(axis=0)
    text = (
        f"The Windows library, run by {Path(wine).name} for {COUNT * STEP:g} s beside the Linux one: the largest "
        f"difference of an output is {apart.max():.1g} of its largest value."
    )
    return text, [at_most(what, float(apart.max()), SAME)]


def _run(file: Path, name: str, options: list[str], wine: list[str], folder: Path) -> np.ndarray:
    """Compile the host and return the outputs (n, n_y) of an FMU that it runs; raises SubprocessError, OSError."""
    host = folder / name
    zig = [sys.executable, "-m", "ziglang", "cc", "-std=c99", "-O2", str(HOST), "-o", str(host), *options]
    subprocess.run(zig, check=True, capture_output=True, text=True)
    description = describe_fmu(file)
    references = [str(variable.reference) for variable in description.by_causality("output")]
    with zipfile.ZipFile(file) as archive:
        [entry] = [entry for entry in archive.namelist() if entry.startswith("binaries/")]
        library = folder / Path(entry).name
        library.write_bytes(archive.read(entry))
    given = [str(library), description.token, repr(STEP), str(COUNT), str(EVERY), *references]
    environment = {
        **os.environ,
        "WINEPREFIX": str(folder / "prefix"),
        "WINEDEBUG": "-all",
        "WINEDLLOVERRIDES": "mscoree,mshtml=;winemenubuilder.exe=d",
    }
    environment.pop("DISPLAY", None)
    command = [*wine, str(host), *given]
    server = shutil.which("wineserver") or shutil.which("/usr/lib/wine/wineserver64")
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment, timeout=WINE_LIMIT)
    finally:
        if wine and server:  # that of this prefix
            subprocess.run([server, "-k"], env=environment, capture_output=True, check=False)
    return np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])


def main() -> None:
    """Print the table, or put it between its markers in a document; exit 1 for a library that is not right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="document with the markers <!-- platforms --> and <!-- end -->")
    given = parser.parse_args()
    expect(given.out, "platforms")
    if importlib.util.find_spec("ziglang") is None:
        print("ziglang is not installed: only the library of this machine is built (pip install ziglang)\n")
    with empty_caches() as folder:
        rows, lines = libraries(folder)
        said, more = windows(folder)
    text = table_text(["platform", "what", "library", "built first", "again", "its header"], rows)
    text = f"{text}\n\n{said}"
    print(f"{text}\n\n" + "\n".join(map(str, [*lines, *more])))
    if given.out:
        fill(given.out, "platforms", text)
    sys.exit(int(any(not line.ok for line in [*lines, *more])))


if __name__ == "__main__":
    main()
