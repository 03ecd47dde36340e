"""Damage FMUs at random and open them: no traceback, no hang, nothing written outside, nothing left behind.

``python -m benchmarks.fmi.fuzz [--count 2000] [--seed 1]`` damages model descriptions and archives of the plant FMUs of
the tests (FMI 1.0, 2.0 and 3.0). Every case goes through ``rotorsim fmu info`` and ``validate``; what can be read is
also unpacked, instantiated in its own process and stepped.
"""

from __future__ import annotations

import argparse
import io
import os
import random
import re
import struct
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from rotorsim.cli.app import rotorsim
from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.model import NUMERIC
from rotorsim.fmi.runtime.slave import open_fmu

__all__ = ["damaged", "sandbox", "try_case"]

SLOWEST = 5.0  # s that a case may take, apart from the FMU's own time limit
ODD = (
    "",
    " ",
    "-1",
    "0",
    "1",
    "2",
    "3",
    "99999999999",
    "4294967295",
    "4294967296",
    "-9223372036854775809",
    "1e999",
    "NaN",
    "INF",
    "-INF",
    "nan",
    "1_000",
    "٣",
    "true",
    "maybe",
    "../../evil",
    "/etc/passwd",
    "C:evil",
    "a\\b",
    "a/b",
    "x" * 5000,
    "\u202e\u0000".replace("\u0000", "&#1;"),
    "&lt;",
    "&amp;",
    "&evil;",
    "&#0;",
    "input",
    "output",
    "constant",
    "calculated",
    "exact",
    "fixed",
    "discrete",
    "Float64",
    "1 2 3",
    "1 " * 300,
    "%s%s%n",
    "der(der(x))",
    "ä",
    "'",
    "u[3]",
)
TAGS = (
    "Float64",
    "Float32",
    "Int8",
    "UInt64",
    "Boolean",
    "String",
    "Binary",
    "Clock",
    "Enumeration",
    "Real",
    "Integer",
    "Dimension",
    "Start",
    "Alias",
    "Unknown",
    "Output",
    "EventIndicator",
    "Unit",
    "ModelVariables",
    "x" * 3000,
)
NAMES = (
    "../evil",
    "../../../../evil",
    "/evil",
    "/tmp/evil",
    "C:/evil",
    "C:evil",
    "..\\evil",
    "a\\..\\..\\evil",
    "a/../../evil",
    "a//b",
    "./a",
    "a/./b",
    "a/..",
    "..",
    ".",
    "/",
    "//evil/share",
    "resources/../../evil",
    "binaries/linux64/../../../evil",
    "a\0b",
    "a\nb",
    "\x7f",
    "x" * 300,
    "x/" * 60 + "y",
    "resources",
    "resources/note.txt/below",
    "modelDescription.xml/x",
    "ä/ö",
    "con",
    "nul.txt",
    "a:b",
    "\u202egpj.exe",
    "~/evil",
    "$HOME/evil",
    "`touch evil`",
    "evil;rm",
    "-rf",
)

_ATTRIBUTE = re.compile(r'[\w:]+="([^"]*)"')
_TAG = re.compile(r"</?([A-Za-z]\w*)")


def damaged(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    """Return what was done, and a damaged FMU."""
    if random_.random() < 0.6:
        return _with_damaged_description(random_, fmu)
    return random_.choice((_flipped, _renamed, _links, _bomb, _crowd, _double, _lies, _cut))(random_, fmu)


# -- model descriptions ------------------------------------------------------------------------------------------------


def _with_damaged_description(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(fmu)) as archive:
        text = archive.read("modelDescription.xml").decode()
        rest = [(name, archive.read(name)) for name in archive.namelist() if name != "modelDescription.xml"]
    done = []
    data = b""
    for _ in range(random_.choice((1, 1, 1, 2, 3))):
        change = random_.choice(_CHANGES)
        text = change(random_, text)
        done.append(change.__name__.strip("_"))
    data = text.encode("utf-8", "surrogatepass")
    if random_.random() < 0.15:
        data = random_.choice((_bytes_flipped, _recoded))(random_, data)
        done.append("bytes")
    return "xml: " + ", ".join(done), _zipped([("modelDescription.xml", data), *rest])


def _value(random_: random.Random, text: str) -> str:
    found = list(_ATTRIBUTE.finditer(text))
    if not found:
        return text
    match = random_.choice(found)
    return text[: match.start(1)] + random_.choice(ODD) + text[match.end(1) :]


def _value_of_another(random_: random.Random, text: str) -> str:
    found = list(_ATTRIBUTE.finditer(text))
    if not found:
        return text
    match, other = random_.choice(found), random_.choice(found)
    return text[: match.start(1)] + other[1] + text[match.end(1) :]


def _attribute_removed(random_: random.Random, text: str) -> str:
    found = list(_ATTRIBUTE.finditer(text))
    if not found:
        return text
    match = random_.choice(found)
    return text[: match.start()] + text[match.end() :]


def _tag(random_: random.Random, text: str) -> str:
    names = sorted(set(_TAG.findall(text)))
    if not names:
        return text
    return re.sub(rf"(</?){random_.choice(names)}\b", rf"\g<1>{random_.choice(TAGS)}", text)


def _cut_out(random_: random.Random, text: str) -> str:
    a, b = sorted(random_.randrange(len(text) + 1) for _ in range(2))
    return text[:a] + text[b:]


def _line_removed(random_: random.Random, text: str) -> str:
    lines = text.splitlines(keepends=True)
    if lines:
        del lines[random_.randrange(len(lines))]
    return "".join(lines)


def _line_moved(random_: random.Random, text: str) -> str:
    lines = text.splitlines(keepends=True) or [""]
    line = lines[random_.randrange(len(lines))]
    lines.insert(random_.randrange(len(lines) + 1), line)
    return "".join(lines)


def _inserted(random_: random.Random, text: str) -> str:
    bomb = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    what = random_.choice(
        (
            bomb,
            '<!DOCTYPE x SYSTEM "file:///etc/passwd">',
            "<a>" * 5000,
            "<a>" * 40 + "</a>" * 40,
            "<a/>" * 3000,
            "<!--",
            "<![CDATA[",
            "]]>",
            "<?php ?>",
            "\x00",
            "\x01",
            "\ufffe",
            "&#xD800;",
            "<",
            "&",
            '"',
            "x" * 100_000,
            '<a b="' + "y" * 100_000 + '"/>',
            "<a " + " ".join(f'a{k}=""' for k in range(500)) + "/>",
            '<Float64 name="big" valueReference="77">' + 2 * '<Dimension start="4000000000"/>' + "</Float64>",
        )
    )
    at = random_.randrange(len(text) + 1)
    if random_.random() < 0.5:
        at = random_.choice([m.start() for m in re.finditer("<", text)] or [0])
    return text[:at] + what + text[at:]


def _bytes_flipped(random_: random.Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(random_.randint(1, 8)):
        if changed:
            changed[random_.randrange(len(changed))] = random_.randrange(256)
    return bytes(changed)


def _recoded(random_: random.Random, data: bytes) -> bytes:
    text = data.decode("utf-8", "replace")
    kind = random_.choice(("utf-16", "utf-32", "latin-1", "utf-8-sig", "utf-7"))
    if random_.random() < 0.5:
        text = text.replace(
            "UTF-8", random_.choice(("UTF-16", "latin-1", "rot13", "x" * 50, "unicode_escape", "idna")), 1
        )
    return text.encode(kind, "replace")


_CHANGES = (
    _value,
    _value,
    _value,
    _value_of_another,
    _value_of_another,
    _attribute_removed,
    _tag,
    _cut_out,
    _line_removed,
    _line_moved,
    _inserted,
)

# -- archives ----------------------------------------------------------------------------------------------------------


def _zipped(entries: Sequence[tuple[str | zipfile.ZipInfo, bytes]]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that are there twice
        for name, data in entries:
            info = name if isinstance(name, zipfile.ZipInfo) else zipfile.ZipInfo("x")
            if isinstance(name, str):
                info.filename = info.orig_filename = name  # as it is: the constructor would cut at NUL
                info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)
    return stream.getvalue()


def _entries(fmu: bytes) -> list[tuple[str | zipfile.ZipInfo, bytes]]:
    with zipfile.ZipFile(io.BytesIO(fmu)) as archive:
        return [(name, archive.read(name)) for name in archive.namelist()]


def _flipped(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    tail = bytearray(fmu)
    low = len(tail) - 400 if random_.random() < 0.6 else 0  # the list of files is at the end
    for _ in range(random_.randint(1, 5)):
        tail[random_.randrange(max(low, 0), len(tail))] = random_.randrange(256)
    return "archive: bytes flipped", bytes(tail)


def _renamed(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    entries = _entries(fmu)
    name = random_.choice(NAMES)
    entries.insert(random_.randrange(len(entries) + 1), (name, b"evil"))
    return f"archive: named {name[:40]!r}", _zipped(entries)


def _links(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    info = zipfile.ZipInfo(random_.choice(("resources/link", "modelDescription.xml", "binaries", "resources")))
    kind = random_.choice((0o120777, 0o020666, 0o060666, 0o010666, 0o140777))  # link, devices, pipe, socket
    info.create_system, info.external_attr = 3, kind << 16
    entries = [*_entries(fmu), (info, random_.choice((b"/etc", b"../../..", b"/tmp")))]
    random_.shuffle(entries)
    return f"archive: link or device {kind:o}", _zipped(entries)


def _bomb(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    size = random_.choice((20, 60)) << 20
    name = random_.choice(("resources/zeros", "modelDescription.xml", "sources/zeros"))
    rest = [(n, d) for n, d in _entries(fmu) if n != name]
    return f"archive: {size >> 20} MiB of zeros in {name}", _zipped([*rest, (name, bytes(size))])


def _crowd(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    count = random_.choice((500, 10_001))
    return f"archive: {count} files", _zipped([*_entries(fmu), *((f"resources/{k}", b"") for k in range(count))])


def _double(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    entries = _entries(fmu)
    again = random_.choice(entries)
    return "archive: a name twice", _zipped([*entries, again])


def _lies(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    """Change sizes, methods, flags and offsets in the list of files."""
    data = bytearray(fmu)
    at = [m.start() for m in re.finditer(rb"PK\x01\x02", bytes(data))]
    where, form = random_.choice(((8, "<H"), (10, "<H"), (16, "<I"), (20, "<I"), (24, "<I"), (28, "<H"), (42, "<I")))
    value = random_.choice((0, 1, 9, 12, 14, 99, 0xFFFF, 0xFFFFFFFF, 0x7FFFFFFF)) & (
        0xFFFF if form == "<H" else 0xFFFFFFFF
    )
    struct.pack_into(form, data, random_.choice(at) + where, value)
    return f"archive: field {where} says {value}", bytes(data)


def _cut(random_: random.Random, fmu: bytes) -> tuple[str, bytes]:
    a, b = sorted(random_.randrange(len(fmu) + 1) for _ in range(2))
    return random_.choice(
        (
            ("archive: cut short", fmu[:a]),
            ("archive: a piece is missing", fmu[:a] + fmu[b:]),
            ("archive: something before", b"MZ" * 5000 + fmu),
            ("archive: something after", fmu + bytes(100)),
            ("archive: nothing", b""),
            ("archive: only a comment", b"PK\x05\x06" + bytes(18)),
        )
    )


# -- trying ------------------------------------------------------------------------------------------------------------


@contextmanager
def sandbox() -> Iterator[Path]:
    """Give a folder deep inside an otherwise empty one, with temporary files of its own; check both afterwards."""
    before = os.getcwd(), os.environ.get("TMPDIR"), tempfile.tempdir
    with tempfile.TemporaryDirectory(prefix="fuzz-") as outer:
        box = Path(outer, "a", "b", "c", "box")
        box.mkdir(parents=True)
        (box / "tmp").mkdir()
        os.chdir(box)
        os.environ["TMPDIR"] = tempfile.tempdir = str(box / "tmp")
        try:
            yield box
        finally:
            os.chdir(before[0])
            tempfile.tempdir = before[2]
            if before[1] is None:
                del os.environ["TMPDIR"]
            else:
                os.environ["TMPDIR"] = before[1]


def _strangers(box: Path) -> list[str]:
    """Return what is where nothing should be."""
    outer = box.parents[3]
    known = {box, *box.parents, box / "tmp", box / "case.fmu"}
    found = [str(path.relative_to(outer)) for path in outer.rglob("*") if path not in known]
    return found + [path for path in ("/evil", "/tmp/evil") if os.path.lexists(path)]


def try_case(box: Path, data: bytes, *, run: bool = True) -> tuple[list[str], str]:
    """Return what went wrong with rotorsim for one damaged FMU, and what became of the FMU."""
    file = box / "case.fmu"
    file.write_bytes(data)
    begun = time.monotonic()
    wrong = []
    outcome = "read"
    for verb in (("info",), ("validate", "--no-fmpy")):
        done = CliRunner().invoke(rotorsim, ["fmu", *verb, str(file)])
        if done.exit_code not in (0, 1, 2) or "internal error" in done.output or "Traceback" in done.output:
            wrong.append(f"fmu {verb[0]}: exit code {done.exit_code}: {done.output[-400:]}")
        if done.exit_code == 2:
            outcome = "refused"
    if outcome == "read" and run:
        outcome = _use(file, wrong)
    if time.monotonic() - begun > SLOWEST:
        wrong.append(f"took {time.monotonic() - begun:.1f} s")
    wrong += [f"left behind: {name}" for name in _strangers(box)]
    return wrong, outcome


def _use(file: Path, wrong: list[str]) -> str:
    """Instantiate and step an FMU that could be read."""
    try:
        with open_fmu(file, timeout=2.0, memory=1 << 30) as fmu:
            kind = "cs" if "cs" in fmu.description.kinds else "me"
            slave = fmu.instantiate(kind)
            inputs, outputs = (
                [name for v in fmu.description.by_causality(causality) if v.type in NUMERIC for name in v.names()][:50]
                for causality in ("input", "output")
            )
            slave.setup(0.0, 1.0, inputs=inputs, outputs=outputs)
            for k in range(3):
                if kind == "cs":
                    slave.exchange(np.zeros(len(inputs)), 0.01 * k, 0.01)
                else:
                    slave.evaluate(0.01 * k, None, np.zeros(len(inputs)))
            slave.terminate()
        return "ran"
    except RotorsimError as error:
        return getattr(error, "kind", "refused by the loader")
    except Exception as error:
        wrong.append(f"using it: {type(error).__name__}: {error}")
        return "wrong"


def main() -> int:
    """Try many; print what went wrong and how it was done."""
    from tests.fmi.lag import lag_fmu
    from tests.fmi.plant import make_fmu

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        whole = [make_fmu(Path(folder, f"{v}.fmu"), v).read_bytes() for v in ("2.0", "3.0")]
        whole.append(lag_fmu(Path(folder)).read_bytes())
    outcomes: Counter[str] = Counter()
    failures = 0
    begun = time.monotonic()
    with sandbox() as box:
        for k in range(given.count):
            random_ = random.Random(f"{given.seed}/{k}")
            what, data = damaged(random_, random_.choice(whole))
            wrong, outcome = try_case(box, data)
            outcomes[outcome] += 1
            for line in wrong:
                failures += 1
                print(f"case {k} ({what}): {line}", file=sys.stderr)
    print(f"{given.count} damaged FMUs in {time.monotonic() - begun:.0f} s: {failures} failures")
    print("what became of them: " + ", ".join(f"{name} {count}" for name, count in outcomes.most_common()))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
