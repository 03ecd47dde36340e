"""``rotorsim fmu info`` and ``validate``."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest

from rotorsim.fmi.description.platforms import binary_kind, folders, platform_of, this_platform
from rotorsim.fmi.validate import validate_fmu
from tests.cli.conftest import Run
from tests.fmi.plant import description2, description3, make_fmu


def test_info(run: Run, tmp_path: Path) -> None:
    done = run("fmu", "info", str(make_fmu(tmp_path / "plant.fmu", "3.0")))
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    assert lines[0] == "plant: FMI 3.0, Co-Simulation and Model Exchange"
    assert f"platforms   {this_platform()}; this machine is {this_platform()}: one of them fits" in lines
    assert "states      4, event indicators 2" in lines
    assert "experiment  start 0 s, stop 2 s, step 0.01 s" in lines
    assert "inputs (2):" in lines
    assert "  u        Float64[2]  N     0 0" in lines
    assert "parameters (9):" in lines
    assert "and 7 local variables (--all shows them)" in lines
    assert "local variables (7):" in run("fmu", "info", "--all", "plant.fmu").stdout
    text = description3().replace("<CoSimulation ", '<CoSimulation fixedInternalStepSize="0.002" ')
    stepped = run("fmu", "info", str(make_fmu(tmp_path / "stepped.fmu", "3.0", description=text))).stdout
    assert ", internal step 0.002 s\n" in stepped


def test_info_as_data(run: Run, tmp_path: Path) -> None:
    done = run("fmu", "info", "--json", str(make_fmu(tmp_path / "plant.fmu", "2.0", platform="win64")))
    data = json.loads(done.stdout)
    assert (data["fmi"], data["platforms"], data["runs_here"]) == (
        "2.0",
        ["win64"],
        this_platform() == "x86_64-windows",
    )
    assert data["kinds"]["cs"]["variable_step"] is True
    assert data["kinds"]["me"]["directional_derivatives"] is True
    assert data["units"] == {"N": "m kg/s^2", "m": "m"}
    inputs = {entry["name"]: entry for entry in data["variables"]["inputs"]}
    assert (inputs["u"]["unit"], inputs["u"]["start"], inputs["enabled"]["start"]) == ("N", 0.0, True)
    assert data["not_supported"] == []


def test_info_says_what_is_not_supported(run: Run, tmp_path: Path) -> None:
    extra = (
        '<Clock name="tock" valueReference="90" causality="input" intervalVariability="triggered"/>'
        '<Binary name="blob" valueReference="91" causality="input"/>'
    )
    text = description3().replace("</ModelVariables>", extra + "</ModelVariables>")
    done = run("fmu", "info", str(make_fmu(tmp_path / "a.fmu", "3.0", description=text)))
    assert "not supported here: clocks: tock" in done.stdout
    assert "not supported here: binary variables: blob" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_good_fmu(run: Run, tmp_path: Path, version: str) -> None:
    """Our checks, FMPy's, and the first instance find nothing."""
    done = run("fmu", "validate", "--load", str(make_fmu(tmp_path / "plant.fmu", version)))
    assert (done.exit_code, done.output) == (0, f"{tmp_path}/plant.fmu: no mistakes\n")


def test_mistakes_are_found_and_the_code_is_not_run(run: Run, tmp_path: Path) -> None:
    text = (
        description2()
        .replace('<Real start="0.5"', "<Real")
        .replace('unit="N"/>', 'unit="lbf"/>')
        .replace('causality="output" variability="discrete"', 'causality="output"')
        .replace('<Unknown index="7" dependencies="2 6"/>', "", 1)
        .replace('start="100" min="0"', 'start="100" min="200"')
    )
    path = make_fmu(tmp_path / "a.fmu", description=text, library_bytes=b"MZ" + bytes(200))
    done = run("fmu", "validate", "--no-fmpy", "--json", str(path))
    assert done.exit_code == 1
    data = json.loads(done.stdout)
    found = {(problem["subject"], problem["what"], problem["severity"]) for problem in data["problems"]}
    library = f"binaries/{folders('2.0')[0]}/plant.so"
    assert found == {
        ("damping", "has no start value", "error"),
        ("u", "its unit 'lbf' is not defined", "error"),
        ("y", "is an output that the model structure does not list", "error"),
        ("stiffness", "its start value is outside 200 ... inf", "warning"),
        ("binaries", f"{library} is no library, not {this_platform()}", "error"),
    }


def test_what_goes_wrong_for_both_kinds_is_said_once(run: Run, tmp_path: Path) -> None:
    path = make_fmu(tmp_path / "a.fmu", description=description2().replace('guid="', 'guid="other'))
    done = run("fmu", "validate", "--load", "--no-fmpy", "--json", str(path))
    assert done.exit_code == 1
    (problem,) = json.loads(done.stdout)["problems"]
    assert problem["what"].startswith("fmi2Instantiate ")


def test_fmpy_is_asked_too(tmp_path: Path) -> None:
    structured = 'variableNamingConvention="structured" numberOfEvent'
    text = description2().replace('name="wall"', 'name="w[all"').replace("numberOfEvent", structured)
    path = make_fmu(tmp_path / "a.fmu", description=text)
    problems = validate_fmu(path)
    assert [p.subject for p in problems] == ["variable", "FMPy"]
    assert problems[0].what == "'w[all' is not a structured name"
    assert validate_fmu(path, fmpy=False) == problems[:1]


def test_what_cannot_be_read(run: Run, tmp_path: Path) -> None:
    (tmp_path / "a.fmu").write_bytes(b"hello")
    for verb in ("info", "validate"):
        done = run("fmu", verb, "a.fmu")
        assert done.exit_code == 2
        assert done.stderr.startswith("a.fmu: error: not a readable archive: File is not a zip file")
        assert run("fmu", verb, "b.fmu").exit_code == 2
    with zipfile.ZipFile(tmp_path / "c.fmu", "w") as archive:
        archive.writestr("readme", "")
    assert "there is no modelDescription.xml in the archive" in run("fmu", "info", "c.fmu").stderr


def test_platforms_of_folders_and_libraries() -> None:
    assert [platform_of(name) for name in ("linux64", "win32", "aarch64-darwin", "amiga", "x86_64-beos")] == [
        "x86_64-linux",
        "x86-windows",
        "aarch64-darwin",
        "",
        "",
    ]
    elf = b"\x7fELF" + bytes(14) + (183).to_bytes(2, "little")
    pe = b"MZ" + bytes(58) + (64).to_bytes(4, "little") + b"PE\0\0" + (0x8664).to_bytes(2, "little")
    macho = b"\xcf\xfa\xed\xfe" + (0x0100000C).to_bytes(4, "little")
    fat = b"\xca\xfe\xba\xbe" + (2).to_bytes(4, "big") + (0x01000007).to_bytes(4, "big")
    assert [binary_kind(start) for start in (elf, pe, macho, fat, b"", b"#!/bin/sh")] == [
        "aarch64-linux",
        "x86_64-windows",
        "aarch64-darwin",
        "x86_64-darwin",
        "",
        "",
    ]
