"""The command itself: verbs, near misses, exit codes, no tracebacks."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings

import numpy as np
import pytest

from rotorsim.cli import app
from rotorsim.cli.app import VERBS, rotorsim
from rotorsim.cli.shared.output import echo_json, show_problems
from rotorsim.errors import Place, Problem, RotorsimError


def test_help_lists_every_verb_without_importing_one(run) -> None:
    result = run("--help")
    assert result.exit_code == 0
    assert all(f"  {verb} " in result.stdout for verb in VERBS)
    assert result.stderr == ""


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_json_and_its_line(run, verb: str) -> None:
    result = run(verb, "--help")
    assert result.exit_code == 0
    assert "--json" in result.stdout


def test_json_tells_infinite_from_unknown(capsys) -> None:
    """FAULT of an earlier version: both were null."""
    values = np.array([1.5, np.inf, -np.inf, np.nan])
    echo_json({"values": values, "pole": complex(-1.0, np.inf), "one": np.float64(np.inf), "count": 2, "none": None})
    assert json.loads(capsys.readouterr().out, parse_constant=pytest.fail) == {
        "values": [1.5, "infinity", "-infinity", None],
        "pole": [-1.0, "infinity"],
        "one": "infinity",
        "count": 2,
        "none": None,
    }


def test_unknown_verb_names_the_near_one(run) -> None:
    result = run("rnu", "jeffcott")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == "error: unknown verb 'rnu'\n\nhint: did you mean 'run'?\n"


def test_unknown_verb_far_from_all(run) -> None:
    assert run("zzzzz").stderr == "error: unknown verb 'zzzzz'\n\nhint: 'rotorsim --help' lists the verbs\n"


def test_unknown_option_names_the_near_one(run) -> None:
    result = run("run", "jeffcott", "--stpo", "3")
    assert result.exit_code == 2
    assert result.stderr == "error: unknown option '--stpo'\n\nhint: did you mean '--stop'?\n"


def test_missing_argument(run) -> None:
    result = run("run")
    assert result.exit_code == 2
    assert result.stderr == "error: missing argument 'DIAGRAM'\n\nhint: 'rotorsim run --help' shows how it is used\n"


def test_problems_are_data_with_json(run) -> None:
    result = run("run", "jeffcot", "--json")
    assert result.exit_code == 2
    [problem] = json.loads(result.stdout)["problems"]
    assert problem["file"] == "jeffcot"
    assert problem["what"] == "no such file and no diagram of this name"
    assert "'jeffcott'" in problem["hint"]
    assert result.stderr.startswith("jeffcot: error: no such file and no diagram of this name\n\nhint: ")


def failing(error: BaseException):
    def get_command(ctx, name):
        raise error

    return get_command


def test_a_fault_of_ours_is_one_line_and_a_hint(run, monkeypatch) -> None:
    monkeypatch.setattr(rotorsim, "get_command", failing(ZeroDivisionError("float division\nby zero")))
    result = run("version")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == (
        "error: internal error: ZeroDivisionError: float division by zero\n\n"
        "hint: this is a fault of rotorsim: please report it with the command and the traceback that --debug prints\n"
    )


def test_debug_shows_the_traceback(run, monkeypatch) -> None:
    monkeypatch.setattr(rotorsim, "get_command", failing(ZeroDivisionError("here")))
    assert "Traceback (most recent call last)" in run("version", "--debug").stderr


def test_every_problem_is_shown_with_its_place(run, monkeypatch) -> None:
    place = Place("a.json", 3, 7)
    error = RotorsimError(
        Problem("first", subject="rotor.force", place=place, hint="cure it"),
        Problem("second", subject="amb"),
        exit_code=1,
    )
    monkeypatch.setattr(rotorsim, "get_command", failing(error))
    result = run("version")
    assert result.exit_code == 1
    assert result.stderr == "a.json:3:7: error: rotor.force: first\n\nhint: cure it\n\nerror: amb: second\n"


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (FileNotFoundError(2, "No such file or directory", "x.json"), 2, "error: x.json: no such file or directory\n"),
        (MemoryError(), 1, "error: not enough memory\n\nhint: record less, or shorten the run with --stop\n"),
    ],
)
def test_other_failures(run, monkeypatch, error, code, text) -> None:
    monkeypatch.setattr(rotorsim, "get_command", failing(error))
    result = run("version")
    assert (result.exit_code, result.stderr.lstrip("\n")) == (code, text)


def test_warnings_are_one_line(run, monkeypatch) -> None:
    def warn(ctx, name):
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = app._show_warning
            warnings.warn("a wire is loose", stacklevel=1)
        raise RotorsimError("then")

    monkeypatch.setattr(rotorsim, "get_command", warn)
    assert run("version").stderr == "warning: a wire is loose\nerror: then\n"


class Terminal:
    """A stream that says it is a terminal."""

    encoding = "utf-8"

    def __init__(self) -> None:
        self.text = ""

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> None:
        self.text += text

    def flush(self) -> None:
        pass


def test_colour_on_a_terminal_unless_no_color(monkeypatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    terminal = Terminal()
    show_problems([Problem("bad")], terminal)
    assert terminal.text == "\x1b[31m\x1b[1merror:\x1b[0m bad\n"
    monkeypatch.setenv("NO_COLOR", "1")
    plain = Terminal()
    show_problems([Problem("bad")], plain)
    assert plain.text == "error: bad\n"


def test_version_as_data(run) -> None:
    from rotorsim import __version__

    assert json.loads(run("version", "--json").stdout)["rotorsim"] == __version__
    assert run("--version").stdout == f"rotorsim {__version__}\n"


@pytest.mark.slow
def test_the_installed_command_in_a_process_of_its_own(tmp_path) -> None:
    """Without anything of this process: entry point, exit code, and both streams kept apart."""
    command = [sys.executable, "-m", "rotorsim", "check", "jeffcott", "nonsense.json"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stdout == "jeffcott: 8 blocks, 14 wires, no mistakes\n"
    assert done.stderr.splitlines()[0] == "nonsense.json: error: file does not exist"


def test_help_needs_no_heavy_library() -> None:
    code = (
        "import sys\nfrom rotorsim.cli.app import rotorsim\ntry: rotorsim.main(['--help'])\nexcept SystemExit: pass\n"
    )
    code += "print(sorted({'numpy', 'casadi', 'scipy', 'matplotlib', 'networkx', 'h5py'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")])
def test_a_verb_uses_one_thread_of_linear_algebra_where_nobody_asks_for_more(given: dict, threads: str) -> None:
    """FAULT: a Campbell diagram of sampled loops took 60 s of CPU beside other programs, and 6 s with one thread."""
    code = "import os, sys\nfrom rotorsim.cli.app import main\nassert 'numpy' not in sys.modules\n"
    code += "sys.argv = ['rotorsim', 'version']\ntry: main()\nexcept SystemExit: pass\n"
    code += "print(os.environ['OMP_NUM_THREADS'], os.environ['OPENBLAS_NUM_THREADS'])"
    kept = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True, env={**kept, **given}
    )
    assert done.stdout.splitlines()[-1] == f"1 {threads}"


@pytest.mark.slow
def test_a_run_needs_no_library_for_figures() -> None:
    code = "import sys\nfrom rotorsim.cli.app import rotorsim\n"
    code += "try: rotorsim.main(['run', 'jeffcott', '--set', 'controller.KI=0'])\nexcept SystemExit: pass\n"
    code += "print(sorted({'scipy', 'matplotlib', 'h5py', 'fmpy', 'tqdm'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_the_cache_is_cleared_of_what_killed_runs_left(run, tmp_path, monkeypatch) -> None:
    cache = tmp_path / "cache"
    monkeypatch.setenv("ROTORSIM_CACHE", str(cache))
    (cache / "build-1a2b").mkdir(parents=True)
    (cache / "build-1a2b" / "diagram.c").write_text("")
    for name in ("a.so", "b.dll", "c.dylib", f"fmu-{'0' * 32}.123", "notes.txt"):
        (cache / name).write_text("x" * 1000)
    assert run("cache").stdout == f"3 compiled models, 0.0 MB, in {cache}\n"
    data = json.loads(run("cache", "--clear", "--json").stdout)
    assert data == {"folder": str(cache), "files": 3, "bytes": 3000, "cleared": True}
    assert [file.name for file in cache.iterdir()] == ["notes.txt"]
