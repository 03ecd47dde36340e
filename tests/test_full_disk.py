"""Disks that are full, readers that have gone, names that steer terminals, and what killed runs leave behind.

A limit on the size of a file (RLIMIT_FSIZE) stands for a full disk: it needs no disk and no rights.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from rotorsim import files
from rotorsim.errors import Place, Problem, RotorsimError, visible
from rotorsim.files import atomic_target, sweep, temporary_prefix, write_atomically
from rotorsim.model.load import load
from rotorsim.simulation.files import load_result, save
from rotorsim.simulation.result import Result
from rotorsim.simulation.sinks import check_sinks

ROOT = Path(__file__).parents[1]
posix = pytest.mark.skipif(sys.platform == "win32", reason="limits, pipes and links of POSIX")


@contextmanager
def room(size: int):
    """Let no file grow beyond a size [bytes]."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def result(rows: int) -> Result:
    time = np.arange(rows) / 7
    return Result(time, {"x": np.column_stack([time, time])}, {"x": "m"})


def refused(act, path: Path, size: int = 5000) -> str:
    """Return what is said of a file that does not fit; what is free differs from machine to machine."""
    with room(size), pytest.raises(RotorsimError) as caught:
        act()
    assert caught.value.exit_code == 1
    [problem] = caught.value.problems
    assert problem.place == Place(str(path))
    assert problem.hint == "make room there, or write to another disk"
    return problem.what.split(", ")[0] + "; " + problem.what.split("; ")[1]


@posix
@pytest.mark.parametrize(("suffix", "takes"), [(".csv", "60 kB"), (".npz", "24 kB"), (".h5", "24 kB")])
def test_a_result_on_a_full_disk_says_what_it_takes_and_what_is_kept(tmp_path, suffix, takes):
    """1000 rows of three numbers: 8 bytes each, or 20 as text."""
    path = tmp_path / f"run{suffix}"
    said = refused(lambda: save(result(1000), path), path)
    assert said == f"file too large: it takes about {takes}; nothing of it is left there"
    assert os.listdir(tmp_path) == []
    save(result(3), path)
    before = sorted(os.listdir(tmp_path))
    said = refused(lambda: save(result(1000), path), path)
    assert said == f"file too large: it takes about {takes}; the file that was there is kept"
    assert sorted(os.listdir(tmp_path)) == before
    assert load_result(path) == result(3)


@posix
def test_texts_archives_and_figures_on_a_full_disk(tmp_path):
    from rotorsim.report.figures.run import save_figure

    path = tmp_path / "x.json"
    assert refused(lambda: write_atomically(path, "x" * 6000), path).startswith("file too large: it takes about 6 kB;")

    def draw(target: Path) -> None:
        from matplotlib.figure import Figure

        save_figure(Figure(), target)

    path = tmp_path / "x.svg"
    assert refused(lambda: draw(path), path, 200).startswith("file too large: it takes more than ")
    assert os.listdir(tmp_path) == []


@posix
def test_a_verb_on_a_full_disk(run, tmp_path):
    with room(5000):
        done = run("draw", "jeffcott", "-o", "x.svg")
    assert done.exit_code == 1
    assert done.stderr.startswith("x.svg: error: file too large: it takes about ")
    assert "internal" not in done.stderr


@pytest.fixture
def run(tmp_path, monkeypatch):
    from click.testing import CliRunner

    from rotorsim.cli.app import rotorsim

    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(rotorsim, list(arguments))


def shell(command: str, folder: Path) -> tuple[int, str]:
    """Return exit code and stderr of a command of bash, in which $R is rotorsim."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "R": f"{sys.executable} -m rotorsim"}
    done = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, cwd=folder, env=environment, timeout=60, check=False
    )
    return done.returncode, done.stderr


@pytest.mark.slow
@posix
def test_closed_and_full_standard_output(tmp_path):
    """Of one process each: closed before it starts; gone while it works; a finding is no success; a full disk."""
    (tmp_path / "bad.json").write_text("{}")
    assert shell("$R version >&-", tmp_path) == (0, "")
    assert shell("$R check nowhere.json 2>&-", tmp_path) == (2, "")
    assert shell('$R blocks --json | true; exit "${PIPESTATUS[0]}"', tmp_path) == (141, "")
    if Path("/dev/full").exists():
        assert shell("$R version > /dev/full", tmp_path) == (
            1,
            "error: standard output cannot be written: no space left on device\n\n"
            "hint: make room there; what was printed is lost, files that were named as written are not\n",
        )
        assert shell("$R check nowhere.json 2> /dev/full", tmp_path) == (2, "")


ESCAPES = "a\x1b[31mb\x07\x9b\u202e\r\ud800"


def test_control_characters_are_written_out():
    assert visible(ESCAPES + "\tü–\n") == "a\\u001b[31mb\\u0007\\u009b\\u202e\\u000d\\ud800\tü–\n"
    problem = Problem(f"no block '{ESCAPES}'", ESCAPES, Place(ESCAPES), ESCAPES)
    assert visible(str(problem)) == str(problem)


def test_no_verb_steers_the_terminal_or_fails_for_a_name(run, monkeypatch):
    """Standard output and messages, with the colours of a terminal allowed."""
    import click

    from rotorsim.cli.app import rotorsim
    from rotorsim.cli.shared.output import note

    @click.command()
    def speak() -> None:
        click.echo(ESCAPES, color=True)
        note(ESCAPES)
        raise RotorsimError(Problem(ESCAPES))

    monkeypatch.setattr(rotorsim, "get_command", lambda ctx, name: speak)
    done = run("version")
    shown = "a\\u001b[31mb\\u0007\\u009b\\u202e\\u000d\\ud800\n"
    assert done.stdout == shown
    assert done.stderr == f"{shown}error: {shown}"


def test_a_diagram_or_recording_with_control_characters_is_refused(run, tmp_path):
    """They would make an SVG, a modelDescription.xml or a page that no reader of XML takes."""
    document = {"name": "a\x1b[31m", "description": "b\x07\n\t", "blocks": {"one": {"type": "constant"}}}
    (tmp_path / "bad.json").write_text(json.dumps(document))
    done = run("draw", "bad.json", "-o", "x.svg")
    assert done.exit_code == 2
    assert done.stderr == (
        "bad.json:1:10: error: control character (\\u001b)\n\nhint: remove it\n\n"
        "bad.json:1:40: error: control character (\\u0007)\n\nhint: remove it\n"
    )
    with pytest.raises(RotorsimError) as caught:
        load(document)
    assert [str(p) for p in caught.value.problems] == [
        "error: name: holds a control character\n\nhint: remove it",
        "error: description: holds a control character\n\nhint: remove it",
    ]
    good = {**document, "name": '\\u001b <ü> & – "', "description": "b\n\t"}
    (tmp_path / "good.json").write_text(json.dumps(good))
    assert run("draw", "good.json", "-o", "x.svg").exit_code == 0
    title = ElementTree.parse(tmp_path / "x.svg").find("{http://www.w3.org/2000/svg}title")
    assert title is not None
    assert title.text == '\\u001b <ü> & – "'


def test_a_figure_with_control_characters_in_a_name_is_valid_svg(tmp_path):
    from matplotlib.figure import Figure

    from rotorsim.report.figures.run import save_figure

    figure = Figure((1, 1))
    figure.suptitle(ESCAPES)
    save_figure(figure, tmp_path / "x.svg")
    assert ElementTree.parse(tmp_path / "x.svg").getroot().tag == "{http://www.w3.org/2000/svg}svg"


@posix
def test_what_a_killed_run_leaves_is_swept_by_the_next(tmp_path):
    """A process writes and is killed; the next write to that folder deletes its half, and nothing of anybody else."""
    code = (
        "import os, signal, sys; from rotorsim.files import atomic_target\n"
        "with atomic_target(sys.argv[1]) as half:\n half.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "run.csv")], check=False, cwd=ROOT)
    [left] = os.listdir(tmp_path)
    assert left.startswith(".rotorsim-")
    mine = tmp_path / f"{temporary_prefix('.rotorsim-')}abc.csv"
    dead = left.split("-")[2]
    folder = tmp_path / f"{temporary_prefix('.rotorsim-').replace(f'-{os.getpid()}-', f'-{dead}-')}folder"
    (folder / "deep").mkdir(parents=True)
    others = [tmp_path / name for name in (".rotorsim-notes", f"copy-of-{left}", f".rotorsim-00000000-{dead}-x")]
    for kept in (mine, *others):
        kept.write_text("")
    write_atomically(tmp_path / "run.csv", "whole")
    assert sorted(tmp_path.iterdir()) == sorted([mine, *others, tmp_path / "run.csv"])
    old = time.time() - 90_000  # more than a day: of another machine, whose processes cannot be asked
    os.utime(others[2], (old, old))
    sweep.cache_clear()
    sweep(tmp_path, ".rotorsim-")
    assert sorted(tmp_path.iterdir()) == sorted([mine, *others[:2], tmp_path / "run.csv"])


@posix
def test_what_another_user_left_is_not_swept(tmp_path, monkeypatch):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = tmp_path / f"{temporary_prefix('.rotorsim-').replace(f'-{os.getpid()}-', f'-{gone.pid}-')}x"
    left.write_text("")
    elsewhere = tmp_path / f".rotorsim-00000000-{gone.pid}-x"
    elsewhere.write_text("")
    os.utime(elsewhere, (0, 0))
    monkeypatch.setattr(files.os, "geteuid", lambda: left.stat().st_uid + 1)
    sweep(tmp_path, ".rotorsim-")
    assert left.exists()
    assert elsewhere.exists()


@posix
def test_to_file_through_a_link_does_not_leave_the_folder(run, tmp_path):
    outside, inside = tmp_path / "outside", tmp_path / "inside"
    outside.mkdir()
    (inside / "real").mkdir(parents=True)
    (inside / "link").symlink_to(outside)
    (inside / "within").symlink_to(inside / "real")

    def document(file: str) -> str:
        blocks = {"one": {"type": "constant"}, "file": {"type": "to_file", "parameters": {"file": file}}}
        solver = {"step": 0.1, "stop": 0.2}
        text = {"blocks": blocks, "wires": [["one.output", "file.input"]], "solver": solver, "record": ["one.output"]}
        (inside / "d.json").write_text(json.dumps(text))
        return str(inside / "d.json")

    done = run("run", document("link/x.csv"), "--no-compiler")
    assert done.exit_code == 2
    assert done.stdout == ""  # before the run, not after it
    assert done.stderr == (
        f"error: file: file {inside}/link/x.csv lies outside the folder of the diagram: a link leads to {outside}\n\n"
        "hint: name a folder that is no link, or copy the file afterwards\n"
    )
    assert os.listdir(outside) == []
    with pytest.raises(RotorsimError, match=r"error: file: folder .*missing does not exist"):
        check_sinks(load(document("missing/x.csv")))
    for file in ("within/x.csv", "real/y.csv", "z.csv"):
        assert run("run", document(file), "--no-compiler").exit_code == 0
    assert (inside / "real" / "x.csv").exists()
    with atomic_target(inside / "z.csv") as temporary:
        temporary.write_text("")
