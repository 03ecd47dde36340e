"""``rotorsim modes``, ``campbell`` and ``periodic``."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from rotorsim.cli.shared.inputs import speeds_of
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.errors import RotorsimError
from tests.reference.published import FE_RIGID_AT_3000_RPM, as_printed

UNDAMPED = ["--set", "rotor.mass_damping=0", "--set", "rotor.stiffness_damping=0"]


def test_modes_of_the_thesis_by_one_command(run) -> None:
    result = run("modes", "fe_rigid", "--without", "amb", "--set", "speed=3000 rpm", *UNDAMPED, "--json")
    rows = json.loads(result.stdout)["modes"]
    assert as_printed([row["frequency_hz"] for row in rows[:4]], FE_RIGID_AT_3000_RPM)
    assert [row["whirl"] for row in rows[:4]] == ["backward", "forward"] * 2
    assert {"frequency_hz", "natural_frequency_hz", "damping_ratio", "whirl"} <= set(rows[0])


@pytest.mark.slow
def test_poles_at_zero_of_a_free_rotor_are_counted(run) -> None:
    free = ("drawn_rotor", "--without", "amb_a", "--without", "amb_b")
    shown = run("modes", *free, "--set", "speed=0")
    assert shown.stdout.splitlines()[-1].endswith("-1e+04, 0 (12 times)")
    locus = run("modes", *free, "--vary", "speed=0, 100")
    assert locus.stdout.splitlines()[-1] == "poles at zero: 10 to 12, of what nothing returns"
    assert locus.stderr.splitlines()[0] == "rotor.position has a pole at zero: nothing returns it"
    assert len(locus.stderr.splitlines()) == 4


def test_modes_as_text(run) -> None:
    lines = run("modes", "jeffcott").stdout.splitlines()
    assert lines[0].split("  ") == [text for text in lines[0].split("  ") if text.strip() or not text]
    # k + k_i KP - k_s, both axes alike: f = sqrt((7.6e5 - 105210 + 42.1 * 12200) / 2) / 2 pi, less the crack's share 0
    assert lines[1].split()[0] == "1"
    assert float(lines[1].split()[2]) == pytest.approx(121.65, abs=0.01)


def test_campbell(run) -> None:
    arguments = ["campbell", "fe_rigid", "--without", "amb", "--speeds", "0,3000 rpm", "--orders", "1", *UNDAMPED]
    data = json.loads(run(*arguments, "--json", "--plot", "c.svg").stdout)
    assert data["speeds_rpm"] == pytest.approx([0.0, 3000.0])
    assert data["frequency_hz"][0][0] == pytest.approx(54.3005, abs=5e-5)
    assert Path("c.svg").read_text().startswith("<?xml")
    assert run(*arguments).stdout.startswith("speed [rpm]")


def test_campbell_orders(run) -> None:
    result = run("campbell", "jeffcott", "--orders", "one")
    assert result.exit_code == 2
    assert (
        result.stderr
        == "error: --orders one: not a list of different whole numbers\n\nhint: for example --orders 1,2\n"
    )


def test_periodic_is_where_a_long_run_settles(run) -> None:
    data = json.loads(run("periodic", "jeffcott", "--speeds", "1500 rpm, 25 Hz", "--json").stdout)
    assert data["status"] == ["settled", "settled"]
    found = data["harmonics"]["rotor.displacement"]
    value = np.array(found["real"]) + 1j * np.array(found["imag"])
    at = data["orders"].index(3.0)
    assert found["unit"] == "m"
    np.testing.assert_allclose(value[0], value[1], rtol=0, atol=1e-15)
    assert abs(value[0, at]) == pytest.approx(1.133e-6, rel=2e-3)
    assert math.degrees(np.angle(value[0, at])) == pytest.approx(-7.49, abs=0.1)


@pytest.mark.slow
def test_periodic_as_text_and_figure(run) -> None:
    result = run("periodic", "jeffcott", "--speeds", "1400 rpm:100 rpm:1600 rpm", "--plot", "p.png")
    assert result.exit_code == 0
    assert Path("p.png").exists()
    lines = result.stdout.splitlines()
    assert lines[0] == "rotor.displacement"
    assert {line.split()[0] for line in lines[2:] if line[:1].isdigit()} == {"1400", "1500", "1600"}


def test_periodic_figure_of_one_speed(run) -> None:
    result = run("periodic", "jeffcott", "--plot", "p.png")
    assert result.exit_code == 2
    assert result.stderr.endswith("--plot needs several speeds\n\nhint: give --speeds\n")


RPM = math.pi / 30


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("900 rpm:100 rpm:1200 rpm", [900 * RPM, 1000 * RPM, 1100 * RPM, 1200 * RPM]),
        ("900 rpm : 200 rpm : 1200 rpm", [900 * RPM, 1100 * RPM]),
        ("157", [157.0]),
        ("25 Hz, 10", [50 * math.pi, 10.0]),
        ("3:-1:1", [3.0, 2.0, 1.0]),
        ("0 rpm:0.1 rpm:0.3 rpm", [0.0, 0.1 * RPM, 0.2 * RPM, 0.3 * RPM]),
    ],
)
def test_speeds(text: str, expected: list[float]) -> None:
    np.testing.assert_allclose(speeds_of(text), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("1:2", "--speeds 1:2: 2 parts, 3 expected"),
        ("1:0:2", "--speeds 1:0:2: these steps never reach the stop"),
        ("1:-1:2", "--speeds 1:-1:2: these steps never reach the stop"),
        ("0:1e-9:1", "--speeds 0:1e-9:1: 1000000001 speeds, at most 100000"),
        ("fast", "--speeds fast: 'fast' is not a quantity"),
        ("3 m", "--speeds 3 m: unit 'm' does not fit 'rad/s'"),
    ],
)
def test_wrong_speeds(text: str, what: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        speeds_of(text)
    assert caught.value.problems[0].what == what


@pytest.mark.slow
def test_what_is_unstable_is_marked(run) -> None:
    found = run("campbell", "jeffcott", "--set", "controller.KD=-5", "--speeds", "0 rpm, 9000 rpm", "--plot", "c.svg")
    lines = found.stdout.splitlines()
    assert found.exit_code == 0
    assert [line.split()[-1] for line in lines[:3]] == ["machine", "unstable", "unstable"]
    assert [line.split()[-1] for line in lines[4:]] == ["machine", *["unstable"] * 4]
    assert found.stderr.endswith(
        "warning: jeffcott: unstable at 2 of 2 speeds (0 .. 9000 rpm): a pole grows there\n\n"
        "hint: 'rotorsim modes --set speed=...' shows which; a critical speed there is never reached\n"
    )
    data = json.loads(run("campbell", "jeffcott", "--set", "controller.KD=-5", "--speeds", "0, 900", "--json").stdout)
    assert (data["stable"], {c["stable"] for c in data["critical_speeds"]}) == ([False, False], {False})
    settled = run("periodic", "jeffcott", "--set", "controller.KD=-5")
    rows = [line.split() for line in settled.stdout.splitlines() if line]
    assert [row[-1] for row in rows[1:4]] == ["motion", "unstable", "unstable"]
    assert "warning: jeffcott: unstable at 1 of 1 speeds (1500 rpm): this motion is never reached" in settled.stderr
    real = run("modes", "jeffcott", "--set", "controller.KP=-20000").stdout.splitlines()[-1]
    assert real.count("(grows)") == 4


def test_what_is_stable_is_not_marked(run) -> None:
    for arguments in (["campbell", "jeffcott", "--speeds", "0 rpm, 9000 rpm"], ["periodic", "jeffcott"]):
        found = run(*arguments)
        assert "stable" not in found.stdout + found.stderr
    data = json.loads(run("campbell", "jeffcott", "--speeds", "0, 900", "--json").stdout)
    assert data["stable"] == [True, True]


@pytest.mark.parametrize("verb", ["modes", "periodic", "campbell"])
def test_a_body_of_no_mass_is_named(run, verb: str) -> None:
    found = run(verb, "fe_flexible", "--set", "rotor.density=1e-300")
    assert (found.exit_code, found.stdout) == (2, "")
    assert found.stderr.endswith(
        "error: rotor: the rate of rotor.velocity[1,1] has no finite derivatives\n\n"
        "hint: a parameter is out of all proportion: a mass, density or time constant of nearly nothing\n"
    )


def test_a_range_without_a_step_is_told_how_to_be_written(run) -> None:
    assert run("periodic", "jeffcott", "--speeds", "900-6000 rpm").stderr == (
        "error: --speeds 900-6000 rpm: a range without a step\n\n"
        "hint: a range is start:step:stop, as in '900 rpm:510 rpm:6000 rpm'\n"
    )


def test_modes_without_a_resonance_come_last(run) -> None:
    """offset_disc turns two pairs of poles beyond 1/sqrt(2) of critical damping: no force brings them to resonance."""
    first, last = run("modes", "offset_disc").stdout.split(
        "\n\ndamped beyond 0.707, which no force brings to resonance\n"
    )
    ratios = [
        [float(line.split()[3]) for line in part.splitlines()[1:] if line[:1].isdigit()] for part in (first, last)
    ]
    assert max(ratios[0]) < 0.7072 < min(ratios[1])
    assert [len(part) for part in ratios] == [2, 2]
    table = run("campbell", "offset_disc", "--speeds", "1400 rpm, 1500 rpm")
    assert table.stdout.splitlines()[0].split() == ["speed", "[rpm]", "mode", "3", "[Hz]", "mode", "4", "[Hz]"]
    assert "2 modes with a damping ratio above 0.707 at all speeds, no resonance: --json has them" in table.stderr


def test_a_critical_speed_names_its_mode(run) -> None:
    data = json.loads(run("campbell", "offset_disc", "--speeds", "7000 rpm, 7400 rpm", "--json").stdout)
    assert len(data["critical_speeds"]) == 2
    for one in data["critical_speeds"]:
        ends = [row[one["mode"] - 1] for row in data["frequency_hz"]]
        assert min(ends) - 1e-6 <= one["frequency_hz"] <= max(ends) + 1e-6


def test_orders_left_out_that_change_those_kept_are_said(run) -> None:
    """A spring that is twice as stiff at 30 um beside the linear ones, driven at 60 Hz."""
    document = json.loads(shipped_diagrams()["jeffcott"].read_text())
    del document["$schema"]
    document["blocks"]["spring"] = {"type": "cubic_stiffness", "parameters": {"stiffness": "1e15 N/m^3"}}
    document["wires"] += [["rotor.displacement", "spring.displacement"], ["spring.force", "rotor.force"]]
    Path("hard.json").write_text(json.dumps(document))
    few = run("periodic", "hard.json", "--harmonics", "1", "--speeds", "3600 rpm", "--json")
    all_of_them = run("periodic", "hard.json", "--speeds", "3600 rpm", "--json")
    assert (few.exit_code, all_of_them.exit_code, all_of_them.stderr) == (0, 0, "")
    assert few.stderr == (
        "warning: jeffcott at 3600 rpm: 3 orders instead of 1 change those that are kept by up to 23 % of the largest\n"
        "\n"
        "hint: leave --harmonics out: as many as needed\n"
    )
    kept, true = (json.loads(result.stdout) for result in (few, all_of_them))
    parts = [(found["harmonics"]["rotor.displacement"], found["orders"].index(1)) for found in (kept, true)]
    one, right = (complex(values["real"][0][at], values["imag"][0][at]) for values, at in parts)
    assert 0.01 < abs(one / right - 1) < 0.23
