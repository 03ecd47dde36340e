"""rotorsim diagnose DIAGRAM --sensors: what it prints, and what it refuses."""

import json

import pytest

from tests.cli.conftest import Run

SENSORS = ("--sensors", "rotor.displacement,controller.current", "--speeds", "900 rpm, 1500 rpm, 2100 rpm")


@pytest.mark.slow
def test_what_sensors_detect_and_isolate(run: Run):
    result = run("diagnose", "jeffcott", *SENSORS)
    assert result.exit_code == 0
    text = result.stdout
    assert text.startswith("jeffcott, sensors rotor.displacement, controller.current: 4")
    assert "STRUCTURE (one run, faults of any form): 4 equations more than unknowns" in text
    assert "LAWS (harmonics of runs at 900, 1500, 2100 rpm; free: viscous_damping, crack_stiffness," in text
    lines = text.splitlines()
    start = lines.index("Not detectable: the free parameters imitate:")
    assert lines[start + 1 : start + 3] == [
        "  rotor.force: magnetic_pull, support_stiffness, unbalance_elsewhere",
        "  rotor.displacement: sensor_gain",
    ]
    assert "  rotor.force: residual_bow, thermal_bow" in lines
    bow = next(line for line in lines if line.startswith("residual_bow at rotor.force") and "nm" in line)
    assert "runout at rotor.displacement" in bow
    table = [line.split() for line in lines if line.startswith("second rotor.displacement")]
    assert [row[2] for row in table] == ["0", "1"]  # by structure none more is detectable, by laws sensor_gain
    assert "Runs with other gains as well (controller.KP = 15.86 kA/m, controller.KD = 3.9 A s/m):" in text
    assert "Not judged (no harmonics of the shaft: it shows as a line of its own or as sidebands):" in text


@pytest.mark.slow
def test_machine_readable(run: Run):
    result = run("diagnose", "jeffcott", *SENSORS, "--physics", "runout,residual_bow,sensor_gain", "--json")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert data["sensors"] == ["rotor.displacement", "controller.current"]
    assert data["laws"]["second_gains"] == "controller.KP = 15.86 kA/m, controller.KD = 3.9 A s/m"
    assert "sensor_gain/0@rotor.displacement" in data["laws"]["unseen"]
    assert [
        some
        for item in data["laws"]["add"]
        if item["sensor"] == "second rotor.displacement"
        for some in item["detected"]
    ] == ["sensor_gain/0@rotor.displacement"]


def test_a_diagram_that_no_fault_fits_into(run: Run, oscillator):
    result = run("diagnose", str(oscillator), "--sensors", "state.output", "--physics", "rub")
    assert result.exit_code == 0
    assert result.stdout == (
        "decay, sensors state.output: 0 faults\n\n"
        "None of the declared faults fits into this diagram: rotorsim blocks says what each needs.\n"
    )


ONE_PROBE = """\
jeffcott, sensors rotor.displacement: 3 faults

STRUCTURE (one run, faults of any form): 2 equations more than unknowns

Group 1, isolable from all others but not within:
  rotor.force: residual_bow
  rotor.displacement: runout, sensor_gain

further sensor             faults detected  pairs isolated
second rotor.displacement                0               2
amb.force                                0               2
(second: the same signal measured once more, by a chain with faults of its own)

All that any sensors isolate is isolable with second rotor.displacement (2 pairs more).

LAWS (harmonics of runs at 900, 1500, 2100 rpm; free: viscous_damping, crack_stiffness, crack_phase,
  eccentricity, unbalance_phase, force_displacement_factor, force_current_factor)

Not detectable: the free parameters imitate:
  rotor.displacement: sensor_gain
"""


@pytest.mark.slow
def test_one_probe_does_not_detect_its_own_gain(run: Run):
    """A gain of the only probe scales eccentricity, crack and force factors; bow and runout differ in their laws."""
    result = run(
        "diagnose",
        "jeffcott",
        "--sensors",
        "rotor.displacement",
        "--speeds",
        "900 rpm, 1500 rpm, 2100 rpm",
        "--physics",
        "runout,residual_bow,sensor_gain",
    )
    assert result.exit_code == 0
    assert result.stdout.startswith(ONE_PROBE)
    detected, isolated = (line.split() for line in result.stdout.splitlines() if line.startswith("residual_bow at"))
    assert detected[3:6:2] == ["amplitude", "nm"]  # far smaller than what is isolable from runout
    assert isolated[3:7] + isolated[10:11] == ["runout", "at", "rotor.displacement", "amplitude", "um"]


@pytest.mark.slow
def test_like_faults_of_several_nodes_stand_in_one_line(run: Run):
    result = run(
        "diagnose",
        "fe_rigid",
        "--sensors",
        "rotor.displacement[2],rotor.displacement[4],controller.current",
        "--speeds",
        "900 rpm, 2100 rpm",
        "--physics",
        "residual_bow,thermal_bow,moment_unbalance,current_sensor_gain",
    )
    assert result.exit_code == 0
    text = result.stdout
    lines = text.splitlines()
    assert "Group 1, isolable from all others:\n  rotor.force: residual_bow\n" in text  # of the whole shaft, in shapes
    assert "Groups 2-5, each node isolable from all others but not within:\n  rotor.force[2-5]: residual_bow" in text
    assert "Group 6, isolable from all others:\n  controller.current: current_sensor_gain" in text
    assert "Groups 7-12, each node isolable from all others:\n  rotor.moment[1-6]: moment_unbalance" in text
    start = lines.index("Not isolable, line by line:")
    assert lines[start + 1] == "  rotor.force[2-5]: residual_bow, thermal_bow (at each node)"


@pytest.mark.slow
def test_angles_are_no_harmonics(run: Run):
    """Ports that turn with the shaft are left out of what could be added, and said where they are asked for."""
    result = run("diagnose", "jeffcott_elementary", "--sensors", "rotor.displacement")
    assert "LAWS (harmonics of runs at 750, 1050, 1350, 1725, 2100 rpm" in result.stdout
    asked = run("diagnose", "jeffcott", "--sensors", "clock.theta", "--physics", "runout")
    assert asked.stdout == (
        "jeffcott, sensors clock.theta: 1 fault\n\n"
        "STRUCTURE (one run, faults of any form): 1 equation more than unknowns\n\n"
        "Not detectable:\n  rotor.displacement: runout\n\n"
        "No further sensor helps.\n\n"
        "By their laws faults were not compared: clock.theta does not repeat from turn to turn.\n"
    )


def test_speeds_at_which_a_fault_lets_nothing_settle(run: Run):
    """FAULT: at 900 rad/s the equations of a clearance were singular: an internal error."""
    result = run("diagnose", "jeffcott", "--sensors", "rotor.displacement", "--speeds", "900", "--physics", "clearance")
    assert result.exit_code == 0
    assert "LAWS (harmonics of runs at 8594 rpm;" in result.stdout


def test_options_that_do_not_go_together(run: Run):
    sensors = run("diagnose", "jeffcott", "--sensors", "rotor.displacement", "--out", "found", "--workers", "2")
    assert sensors.exit_code == 2
    assert sensors.stderr == (
        "error: --out does not go with --sensors\n\nhint: it goes with a RECORDING\n\n"
        "error: --workers does not go with --sensors\n\nhint: it goes with a RECORDING\n"
    )
    recorded = run("diagnose", "jeffcott", "somewhere", "--speeds", "900 rpm")
    assert recorded.exit_code == 2
    assert recorded.stderr == (
        "error: --speeds does not go with a RECORDING\n\nhint: it goes with --sensors; a recording has its own\n"
    )


@pytest.mark.parametrize(
    ("sensors", "said"),
    [
        (
            "",
            "error: jeffcott: no sensors\n\nhint: signals: rotor.displacement, rotor.velocity, controller.current, "
            "amb.force, reference.signal, bus.output\n",
        ),
        (
            "displacement",
            "error: sensor displacement: is not a signal\n\n"
            "hint: write block.port, with [node] or [node,axis] counted from 1; signals: "
            "rotor.displacement\n",
        ),
        (
            "rotor",
            "error: sensor rotor: is not a signal\n\nhint: write block.port, with [node] or [node,axis] counted "
            "from 1; signals: rotor.displacement, rotor.velocity\n",
        ),
        (
            "rotor.displacement[0]",
            "error: sensor rotor.displacement[0]: is not a signal\n\nhint: write block.port, with"
            " [node] or [node,axis] counted from 1; signals: rotor.displacement, "
            "rotor.velocity\n",
        ),
        (
            "rotor.force",
            "error: sensor rotor.force: the diagram has no such output\n\n"
            "hint: did you mean 'crack.force' or 'amb.force'?\n",
        ),
    ],
)
def test_sensors_that_are_none(run: Run, sensors: str, said: str):
    result = run("diagnose", "jeffcott", "--sensors", sensors)
    assert (result.exit_code, result.stdout, result.stderr) == (2, "", said)


def test_refused(run: Run):
    neither = run("diagnose", "jeffcott")
    assert neither.exit_code == 2
    assert neither.stderr == (
        "error: give either a RECORDING or --sensors\n\n"
        "hint: --sensors rotor.displacement,controller.current asks what could be told, a RECORDING what is\n"
    )
    assert run("diagnose", "jeffcott", "somewhere", "--sensors", "rotor.displacement").stderr == neither.stderr
    wrong = run("diagnose", "jeffcott", "--sensors", "rotor.displacement[3,1],controller.curent")
    assert wrong.exit_code == 2
    assert wrong.stderr == (
        "error: sensor rotor.displacement[3,1]: no such entry: the signal is 2\n\n"
        "hint: counted from 1\n\n"
        "error: sensor controller.curent: the diagram has no such output\n\n"
        "hint: did you mean 'controller.current'?\n"
    )
    still = run("diagnose", "jeffcott", "--sensors", "rotor.displacement", "--speeds", "0 rpm")
    assert still.stderr == "error: --speeds 0 rpm: the shaft does not turn\n\nhint: leave 0 out\n"
