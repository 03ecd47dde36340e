"""``rotorsim fmu export``."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import fmpy
import pytest

from rotorsim.fmi.export import build
from tests.cli.conftest import Run


def test_a_diagram_in_one_command(run: Run) -> None:
    done = run("fmu", "export", "jeffcott", "--set", "speed=3000 rpm", "-o", "j.fmu")
    assert (done.exit_code, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0] == "j.fmu: FMI 2.0, model exchange and co-simulation, step 0.0001 s"
    assert lines[1] == "34 parameters, 0 inputs, 5 outputs, 6 states, 0 events"
    speed = next(v for v in fmpy.read_model_description("j.fmu").modelVariables if v.name == "speed")
    assert float(speed.start) == pytest.approx(314.1592653589793, rel=1e-15)


def test_a_block_as_json_without_a_library(run: Run) -> None:
    arguments = ["--block", "rotor", "--fmi", "3.0", "--arrays", "--fixed", "--platform", "source", "--json"]
    done = json.loads(run("fmu", "export", "fe_flexible", *arguments, "-o", "rotor.fmu").stdout)
    assert done["model"] == "fe_flexible_rotor"
    assert done["blocks"] == ["rotor"]
    assert done["libraries"] == {}
    with zipfile.ZipFile("rotor.fmu") as archive:
        assert {name.split("/")[0] for name in archive.namelist()} == {
            "modelDescription.xml",
            "sources",
            "documentation",
        }


MISTAKES = {
    "block": (["--block", "roter"], "roter: no such block", "did you mean 'rotor'?"),
    "input": (["--input", "roto.force"], "roto.force: no such additive input port", "did you mean 'rotor.force'?"),
    "fed": (
        ["--input", "controller.displacement"],
        "controller.displacement: no value can be added to this input port",
        "leave out block rotor, and it becomes an input",
    ),
    "output": (["--output", "rotor.displacment"], "rotor.displacment: no such signal", "'rotor.displacement'?"),
    "platform": (["--platform", "win46"], "win46: unknown platform", "did you mean 'win64' or 'darwin64'?"),
    "arrays": (["--arrays"], "FMI 2.0 has no arrays", "export as FMI 3.0, or without arrays"),
    "suffix": (["-o", "x.zip"], "--out x.zip: unknown format '.zip'", "one of .fmu"),
    "folder": (["-o", "no/x.fmu"], "--out no/x.fmu: folder no does not exist", "create it first"),
    "fmi": (["--fmi", "1.0"], "invalid value for '--fmi'", "rotorsim fmu export --help"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes_end_with_words_and_exit_code_2(run: Run, case: str) -> None:
    arguments, what, hint = MISTAKES[case]
    done = run("fmu", "export", "jeffcott", "-o", "x.fmu", *arguments)
    assert done.exit_code == 2
    assert what in done.stderr
    assert hint in done.stderr
    assert not list(Path().iterdir())


def test_all_mistakes_at_once(run: Run) -> None:
    done = run("fmu", "export", "jeffcott", "--block", "roter", "--input", "x.y", "--arrays", "-o", "x.fmu")
    assert done.stderr.count("error: ") == 3


def test_another_platform_without_ziglang(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: None)
    other = next(name for name in build.TARGETS if name != build.this_platform())
    done = run("fmu", "export", "jeffcott", "--platform", other, "-o", "x.fmu")
    assert done.exit_code == 2
    assert f"{other}: building for another platform needs ziglang" in done.stderr


def test_without_any_compiler(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROTORSIM_CC", "none")
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: None)
    done = run("fmu", "export", "jeffcott", "-o", "x.fmu")
    assert done.exit_code == 2
    assert "there is no C compiler" in done.stderr
    assert "--platform source" in done.stderr


def test_a_solver_that_an_fmu_does_not_have_is_told(run: Run) -> None:
    done = run("fmu", "export", "jeffcott", "--set", "solver.method=dop853", "--platform", "source", "-o", "x.fmu")
    assert done.exit_code == 0
    assert "warning: jeffcott: co-simulation steps by Runge-Kutta of order 4 and 0.0001 s, not by dop853" in done.stderr


def test_help_and_near_misses(run: Run) -> None:
    assert "export" in run("fmu").stdout
    done = run("fmu", "exprot")
    assert done.exit_code == 2
    assert "unknown verb 'fmu exprot'" in done.stderr
    assert "did you mean 'export'?" in done.stderr
