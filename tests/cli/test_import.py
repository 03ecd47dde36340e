"""``rotorsim import``."""

from __future__ import annotations

import json
from pathlib import Path

from tests.ross.rotors import ROTORS, toml

SHIPPED = str(Path(__file__).parents[2] / "diagrams" / "ross_rotor.toml")
SAID = (
    f"{SHIPPED}: warning: axial and torsional motion are not carried over\n"
    f"{SHIPPED}:123:1: warning: BearingElement_Bearing 4: kzz is not carried over\n"
)


def test_a_rotor_of_ross_is_written_as_a_diagram(run) -> None:
    done = run("import", "ross", SHIPPED, "--out", "rotor.json")
    assert (done.exit_code, done.stdout) == (0, "rotor.json: 4 elements, 7 blocks, from ROSS 2.3.0\n")
    assert done.stderr == SAID
    assert run("check", "rotor.json").exit_code == 0
    assert run("fmt", "--check", "rotor.json").exit_code == 0


def test_it_is_data_too(run) -> None:
    done = run("import", "ross", SHIPPED, "-o", "rotor.json", "--json")
    data = json.loads(done.stdout)
    assert (data["diagram"], data["ross"], data["wires"]) == ("rotor.json", "2.3.0", 19)
    assert data["blocks"]["bearing_0"] == "bearing_coefficients"
    assert [problem["what"] for problem in data["warnings"]] == [
        "axial and torsional motion are not carried over",
        "kzz is not carried over",
    ]


def test_nothing_is_written_of_a_wrong_file(run) -> None:
    Path("wrong.toml").write_text(toml(ROTORS["stepped"]).replace("L = 0.12", "L = -0.12"))
    done = run("import", "ross", "wrong.toml", "--out", "rotor.json")
    assert (done.exit_code, done.stdout) == (2, "")
    what = "error: ShaftElement_Shaft Element 1: L is -0.12\n\nhint: it must be greater than 0\n"
    assert done.stderr == f"wrong.toml:23:1: {what}"
    assert not Path("rotor.json").exists()


def test_near_misses_and_names_of_files(run) -> None:
    assert run("import", "rosss", "x").stderr == "error: unknown verb 'import rosss'\n\nhint: did you mean 'ross'?\n"
    done = run("import", "ross", SHIPPED, "--out", "rotor.toml")
    assert (done.exit_code, done.stderr) == (
        2,
        "error: --out rotor.toml: unknown format '.toml'\n\nhint: one of .json\n",
    )
    assert run("import", "ross", SHIPPED).stderr.startswith("error: missing option '-o' / '--out'")
    assert "ross" in run("import").stdout
