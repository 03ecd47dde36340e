"""What verbs of the command line find in recordings, for the page: each runs as a process that can be stopped."""

from __future__ import annotations

import asyncio
import os
import re
import secrets
import shutil
import signal
import sys
import tempfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rotorsim.diagram.diff import diff
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.parse.source import read_document
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.files import write_atomically
from rotorsim.serve.beside import recordings_below
from rotorsim.serve.changes import differences

MOST_OUTCOMES = 20
FINDING_VERBS = ("identify", "diagnose", "beside")
FIGURE_SUFFIXES = (".png", ".svg")
PYTHON = (sys.executable, "-P")  # files of the folder that are called as modules are none
_PATHS = {"PYTHONSAFEPATH": "1"} | {  # relative ones would lead into the folder of the diagram
    name: os.pathsep.join(str(Path(one).absolute()) for one in os.environ[name].split(os.pathsep) if one)
    for name in ("PYTHONPATH",)
    if os.environ.get(name)
}
_SHARE = re.compile(r"(\d{1,3})%\|")
Data = dict[str, Any]


@dataclass(frozen=True)
class Outcome:
    """A folder with what a verb wrote, and the key by which its report may be fetched."""

    folder: Path
    key: str = field(default_factory=lambda: secrets.token_urlsafe(32))

    def file(self, name: str) -> Path:
        """Return a figure or the report. Raises RotorsimError for what is not in the folder."""
        names = {one.name: one for one in self.folder.iterdir() if one.suffix in (*FIGURE_SUFFIXES, ".html")}
        if name not in names:
            raise RotorsimError(Problem("there is no such file", name))
        return names[name]


@dataclass
class Outcomes:
    """What was found, by number."""

    kept: OrderedDict[int, Outcome] = field(default_factory=OrderedDict)
    _count: int = 0
    _root: Path | None = None

    def close(self) -> None:
        """Delete all that was found."""
        if self._root is not None:
            shutil.rmtree(self._root, ignore_errors=True)

    async def find(
        self,
        file: Path,
        document: Data,
        verb: str,
        recording: str,
        trusted: bool,
        progress: Callable[[float, str], None],
    ) -> Data:
        """Run a verb on a diagram and a recording below its folder; return its words, its files, and what it changes.

        document: what stood in the file when it was asked for; it is what the verb reads, whatever is saved meanwhile.
        Raises RotorsimError for unknown verbs and recordings, and with what the verb says where it fails. Cancelled, it
        ends the process.
        """
        known = [one["name"] for one in recordings_below(file.parent)]
        if verb not in FINDING_VERBS:
            raise RotorsimError(Problem(f"unknown verb '{verb}'", hint=near_miss(verb, FINDING_VERBS)))
        if recording not in known:
            what = f"no recording '{recording}' below the folder of the diagram"
            raise RotorsimError(Problem(what, hint=near_miss(recording, known)))
        if self._root is None:
            self._root = Path(tempfile.mkdtemp(prefix="rotorsim-serve-"))
        self._count += 1
        number, out = self._count, self._root / str(self._count)
        measured, held = f"./{recording}", f"{recording}_hold_out"  # a name may begin like an option
        given = {
            "identify": ["identify", measured, "--out", str(out)],
            "diagnose": ["diagnose", measured, "--out", str(out), "--progress"],
            "beside": ["run", "--input", measured, "--plot", str(out / "beside.svg")],
        }[verb]
        given += ["--hold-out", f"./{held}"] if verb != "beside" and held in known else []
        if verb == "beside":
            out.mkdir(parents=True)
        snapshot = file.with_name(f".{file.stem}.{secrets.token_hex(8)}.json")  # beside it: it may name other files
        write_atomically(snapshot, format_document({"name": file.stem, **document}))
        command = [*PYTHON, "-m", "rotorsim", given[0], str(snapshot), *given[1:]]
        try:
            ended = await _run([*command, *(["--trust-blocks"] if trusted else [])], file.parent, progress)
        finally:
            snapshot.unlink(missing_ok=True)
        code, said, complaints = ended
        if not out.is_dir() or not any(out.iterdir()):
            raise RotorsimError(*_problems(complaints, verb), exit_code=code or 1)
        found = Outcome(out)
        self.kept[number] = found
        while len(self.kept) > MOST_OUTCOMES:
            shutil.rmtree(self.kept.popitem(last=False)[1].folder, ignore_errors=True)
        figures = sorted(one.name for one in out.iterdir() if one.suffix in FIGURE_SUFFIXES)
        report = f"/report/{number}/{found.key}" if (out / "report.html").exists() else ""
        title = f"{verb} {file.name} {recording}" if verb != "beside" else f"{file.name} beside {recording}"
        data = {"outcome": number, "title": title, "text": said, "figures": figures, "report": report}
        return data | _repair(document, out / "diagram.json")


def _repair(document: Data, repaired: Path) -> Data:
    """Return the changes that lead to the diagram that was written, and what they are in words."""
    if not repaired.exists():
        return {"changes": [], "words": []}
    new = read_document(repaired).data
    for key in ("name", "$schema", "description"):
        new = {one: value for one, value in new.items() if one != key or key in document}
        new |= {key: document[key]} if key in document else {}
    changes = [change.as_data() for change in differences(document, new)]
    return {"changes": changes, "words": [str(one) for one in diff(document, new)]}


async def _run(command: list[str], folder: Path, progress: Callable[[float, str], None]) -> tuple[int, str, str]:
    """Run a process; return its exit code, and what it said on both streams. Cancelled, it kills it."""
    process = await asyncio.create_subprocess_exec(
        *command,
        cwd=folder,
        env=os.environ | _PATHS,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    complaints = bytearray()

    async def listen(stream: asyncio.StreamReader) -> None:
        while part := await stream.read(4096):
            complaints.extend(part)
            last = re.split(r"[\r\n]", part.decode("utf-8", "replace").strip())[-1]
            shares = _SHARE.findall(last)
            progress(int(shares[-1]) / 100 if shares else 0.0, last[:120])

    try:
        said, _ = await asyncio.gather(process.stdout.read(), listen(process.stderr))
        code = await process.wait()
    except asyncio.CancelledError:
        _end(process)
        await process.wait()
        raise
    return code, said.decode("utf-8", "replace"), complaints.decode("utf-8", "replace")


def _end(process: asyncio.subprocess.Process) -> None:
    """Kill a process and all that it has started."""
    try:
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    except ProcessLookupError:
        pass


def _problems(complaints: str, verb: str) -> list[Problem]:
    """Return what a verb said was wrong."""
    errors = [line.removeprefix("error: ") for line in complaints.splitlines() if line.startswith("error: ")]
    hints = [line.removeprefix("hint: ") for line in complaints.splitlines() if line.startswith("hint: ")]
    found = [Problem(text, verb) for text in errors] or [Problem("it ended without a result", verb)]
    return [Problem(found[0].what, verb, hint=hints[0] if hints else ""), *found[1:]]
