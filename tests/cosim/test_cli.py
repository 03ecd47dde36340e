"""``rotorsim cosim``: what it prints, exit codes, words for every mistake."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.diagram.edit import swap
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from tests.cli.conftest import Run
from tests.fmi.events import events_fmu

TRUST = ("--trust-blocks",)
PART = ("--part", "controller", "--stop", "0.02 s")


@pytest.mark.slow
def test_what_it_says(run: Run) -> None:
    done = run("cosim", "jeffcott", *PART, "--step", "0.1 ms")
    assert (done.exit_code, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[:4] == [
        "finished: 200 communication steps to 0.02 s, gauss_seidel",
        "damping kept by the coupling: 87.4%; largest stable step: 0.000788 s",
        "",
        "signal                     peak        rms  unit",
    ]
    assert [line.split()[0] for line in lines[4:]] == ["rotor.displacement[1]", "controller.current[1]"]
    assert [line.split()[-1] for line in lines[4:]] == ["um", "A"]
    data = json.loads(run("cosim", "jeffcott", *PART, "--step", "0.1 ms", "--json").stdout)
    assert float(lines[4].split()[1]) == pytest.approx(1e6 * data["peak"]["rotor.displacement"], rel=1e-5)
    assert data["units"]["rotor.displacement"] == "m"


@pytest.mark.slow
def test_the_recorded_signals_are_drawn(run) -> None:
    done = run("cosim", "jeffcott", *PART, "--step", "0.1 ms", "--stop", "10 ms", "--plot", "both.svg")
    assert (done.exit_code, done.stderr) == (0, "written: both.svg\n")
    drawn = Path("both.svg").read_text()
    assert all(
        f"<!-- {text} -->" in drawn for text in ("jeffcott, 1500 rpm", "rotor.displacement", "controller.current")
    )


def test_rates(run: Run) -> None:
    done = run("cosim", "jeffcott", *PART, "--step", "20 us", "--rate", "controller=5", "--order", "1", "--json")
    assert done.exit_code == 0
    found = json.loads(done.stdout)
    assert found["coupling"]["rates"] == {"controller": 5}
    assert found["counters"]["participant_steps"] == 1000 + 200
    assert 1e-4 < found["coupling"]["largest_stable_step"] < 0.000788


def sampled(folder: Path, period: float) -> str:
    document = swap(load("jeffcott").document, "controller", "discrete_pid")
    document["blocks"]["controller"]["parameters"]["sample_time"] = period
    (folder / "sampled.json").write_text(json.dumps(document))
    return "sampled.json"


def test_a_sampled_controller(run: Run, tmp_path: Path) -> None:
    done = run("cosim", sampled(tmp_path, 1e-4), *PART, "--step", "0.3 ms")
    assert done.stdout.splitlines()[1] == "damping kept by the coupling: 100.0%; stable with all steps tried"


def test_a_loop_that_is_unstable_as_a_whole(run: Run, tmp_path: Path) -> None:
    done = run("cosim", sampled(tmp_path, 1e-3), *PART, "--step", "0.1 ms")
    assert done.exit_code == 1
    assert done.stdout.splitlines()[0].startswith("unstable: ")
    assert done.stdout.splitlines()[1] == "the linearised loop is unstable as a whole, with any step"
    assert done.stderr.startswith("error: the loop is unstable as a whole, with any step\n")


@pytest.mark.slow
@pytest.mark.parametrize("more", [("--adaptive", "1e-3"), ("--no-check",)])
def test_a_motion_that_explodes_is_not_finished_where_nothing_was_analysed(run: Run, more: tuple[str, ...]) -> None:
    """The pole of KD = -5 grows at 33.7 1/s: in 0.4 s by e^13 = 7e5."""
    arguments = ("--part", "controller", "--stop", "0.4 s", "--step", "0.2 ms", "--set", "controller.KD=-5")
    done = run("cosim", "jeffcott", *arguments, *more)
    assert done.exit_code == 1
    assert re.match(r"error: the motion grows at [\d.]+ 1/s, and has become [\de.+]+ times larger\n", done.stderr)


def test_a_run_up_that_ends_on_its_way_to_resonance_is_no_explosion(run: Run) -> None:
    """From rest, unbalance alone: in 13 s the response grows 1900 times from the first eighth to the last."""
    arguments = ("--part", "controller", "--stop", "13 s", "--step", "0.4 ms", "--no-check")
    done = run("cosim", "jeffcott_runup", *arguments, "--set", "controller.KI=0", "--set", "crack_stiffness=0")
    assert (done.exit_code, done.stderr) == (0, "")


def test_a_rotor_that_passes_its_magnets_is_no_motion(run: Run, tmp_path: Path) -> None:
    document = json.loads(json.dumps(load("jeffcott").document))
    del document["identify"]
    document["blocks"]["amb"]["type"] = "amb_nonlinear"
    (tmp_path / "nonlinear.json").write_text(json.dumps(document))
    arguments = ("--part", "controller", "--stop", "0.5 s", "--step", "0.1 ms", "--set", "controller.KD=-5")
    done = run("cosim", "nonlinear.json", *arguments)
    assert done.exit_code == 1
    assert done.stderr.startswith(
        "error: amb: its equations hold below a displacement of 0.0004002 m; 'rotor.displacement' passes it at t = 0.1"
    )


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (("--adaptive", "1e-3"), "the step adapts itself"),
        (
            ("--rate", "controller=500"),
            "steps and sample times (2e-05 s) and rates (500, 1) have no common period of 240 steps or fewer",
        ),
    ],
)
def test_it_says_where_the_stability_is_not_analysed(run: Run, more: tuple[str, ...], why: str) -> None:
    done = run("cosim", "jeffcott", *PART, "--step", "20 us", *more)
    assert done.exit_code == 0
    assert done.stdout.splitlines()[1] == f"stability of the coupling: not analysed ({why})"


def test_a_step_that_must_diverge(run: Run) -> None:
    done = run("cosim", "jeffcott", *PART, "--step", "1 ms")
    assert done.exit_code == 1
    assert done.stderr == (
        "error: step 0.001 s, gauss_seidel: with this step the coupled loop is unstable; the largest stable step is "
        "0.000788 s\n\nhint: a smaller step, or another master (iterative bears the largest steps)\n"
    )
    done = run("cosim", "jeffcott", *PART, "--step", "1 ms", "--no-check")
    assert done.exit_code == 0
    assert done.stdout.splitlines()[1] == "stability of the coupling: not analysed (--no-check)"


def alone(folder: Path, parameters: dict[str, Any]) -> str:
    file = events_fmu(folder)
    block = {"type": "fmu", "file": file.name, "parameters": {"interface": "me", **parameters}}
    document = {
        "name": "it",
        "blocks": {"it": block},
        "wires": [],
        "solver": {"step": 0.01, "stop": 2.0},
        "record": ["it.x"],
    }
    (folder / "it.json").write_text(json.dumps(document))
    return "it.json"


@pytest.mark.parametrize("parameters", [{}, {"in_process": True}])
def test_the_code_of_an_fmu_is_not_run_unless_trusted(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parameters: dict[str, Any]
) -> None:
    """A process of its own protects from a crash, not from malice: both ask, as block files do."""
    ran: list[str] = []
    monkeypatch.setattr("rotorsim.cosim.cut.fmu_participant", lambda name, *_: ran.append(name))
    name = alone(tmp_path, parameters)
    done = run("cosim", name, "--step", "0.1 s")
    assert (done.exit_code, done.stdout, ran) == (2, "", [])
    assert done.stderr == (
        "it.json:1:27: error: it: FMUs are programs; they are not run unless you say so\n\n"
        "hint: if you trust where they come from, add --trust-blocks (trust_blocks=True)\n"
    )
    assert run("check", name).exit_code == 0  # its ports are read, nothing is run
    with pytest.raises(RotorsimError, match="FMUs are programs"):
        cosimulate_diagram(load(tmp_path / name), step=0.1)
    assert ran == []


def test_what_was_computed_until_the_end_is_kept(run: Run, tmp_path: Path) -> None:
    """A clock that asks for the end at its third tick, 0.75 s."""
    done = run("cosim", alone(tmp_path, {"model": 2, "stop_at": 3.0}), *TRUST, "--step", "0.1 s", "--out", "x.csv")
    assert done.exit_code == 1
    lines = done.stdout.splitlines()
    assert lines[:3] == [
        "stopped: 7 communication steps to 0.75 s, gauss_seidel",
        "stability of the coupling: not analysed (it offers no directional derivatives)",
        "",
    ]
    x = [float(line.split(",")[1]) for line in (tmp_path / "x.csv").read_text().splitlines()[1:]]
    rms = f"{(sum(value**2 for value in x) / len(x)) ** 0.5:.6g}"
    assert [line.split() for line in lines[3:]] == [
        ["signal", "peak", "rms", "unit"],
        ["it.x", f"{max(x):.6g}", rms, "1"],
    ]
    assert done.stderr == (
        "written: x.csv\nerror: it: asks for the end of the simulation (t = 0.75 s)\n\n"
        "hint: what was computed until then is in x.csv\n"
    )
    assert len(x) == 9


BASE = "--step 1e-4 --stop 0.02 --part controller"
MISTAKES = {  # arguments -> what, hint
    "--step 1e-4": (
        "jeffcott: has no FMU: there is nothing to be coupled",
        "cut it with --part BLOCK,BLOCK, or `rotorsim run` it",
    ),
    f"{BASE} --step 0": (
        "communication step 0 s is not between 0 and the stop time 0.02 s",
        "give one that is positive and no longer than the run",
    ),
    f"{BASE} --step '1 m'": ("--step 1 m: unit 'm' does not fit 's'", "give it in s"),
    f"{BASE} --stop -1": ("--stop -1: must be positive", "such as --stop '0.2 s'"),
    "--step 1e-4 --part roter": ("roter: no such block", "did you mean 'rotor'?"),
    "--step 1e-4 --part ''": ("--part '': names no block", "such as --part controller,reference"),
    "--step 1e-4 --part rotor --part rotor,amb": ("rotor: is in two parts", "name each block in one part only"),
    f"{BASE} --order 3": (
        "gauss_seidel: extrapolation order 3",
        "0 holds the inputs, 1 linear, 2 quadratic; 3 for the iterative master",
    ),
    f"{BASE} --rate controller": ("--rate controller: not PARTICIPANT=N", "such as --rate controller=5"),
    f"{BASE} --rate rotor=2 --rate rotor=3": ("--rate rotor: has a rate already", "give one for each"),
    f"{BASE} --rate controler=2": ("controler: no such participant", "did you mean 'controller'?"),
    f"{BASE} --rate controller=0": ("controller: rate 0: not a whole number of base steps", "1 or more"),
    f"{BASE} --rate controller=2 --master iterative": (
        "iterative master: takes all participants at one rate",
        "use master jacobi or gauss_seidel, or the same rate for all",
    ),
    f"{BASE} --master waveform --adaptive 1e-3": (
        "master waveform: cannot be combined with adaptive steps",
        "it repeats the whole run, with cubic splines through fixed steps",
    ),
    f"{BASE} --fast --order 1": (
        "the fast loop: it holds inputs and repeats nothing",
        "take master jacobi or gauss_seidel with order 0, or leave out fast",
    ),
    f"{BASE} --fast --adaptive 1e-3": (
        "the fast loop: cannot be combined with adaptive steps",
        "leave out one of them",
    ),
}


@pytest.mark.parametrize("arguments", MISTAKES)
def test_mistakes(run: Run, arguments: str) -> None:
    what, hint = MISTAKES[arguments]
    done = run("cosim", "jeffcott", *shlex.split(arguments))
    assert (done.exit_code, done.stderr, done.stdout) == (2, f"error: {what}\n\nhint: {hint}\n", "")


def test_an_interface_that_is_not_offered(run: Run, tmp_path: Path) -> None:
    done = run("cosim", alone(tmp_path, {"interface": "cs"}), *TRUST, "--step", "0.1 s")
    assert done.exit_code == 2
    assert "error: it: the FMU offers no interface 'cs'\n\nhint: it offers me\n" in done.stderr
    done = run("cosim", alone(tmp_path, {"interface": "se"}), *TRUST, "--step", "0.1 s")
    assert done.exit_code == 2
    assert "it.interface: 'se' is not a choice\n\nhint: one of: any, cs, me\n" in done.stderr


def test_states_that_cannot_be_taken_back(run: Run, tmp_path: Path) -> None:
    name = alone(tmp_path, {})
    document = json.loads((tmp_path / name).read_text())
    document["blocks"]["it"]["file"] = events_fmu(tmp_path, saves=False).name
    (tmp_path / name).write_text(json.dumps(document))
    done = run("cosim", name, *TRUST, "--step", "0.1 s", "--adaptive", "1e-3")
    assert (done.exit_code, done.stderr) == (
        2,
        "error: adaptive steps: cannot take a step back: it\n\nhint: take fixed steps\n",
    )


@pytest.mark.slow
def test_an_fmu_that_nothing_is_coupled_to_has_no_largest_stable_step(run):
    assert run("fmu", "export", "jeffcott", "-o", "whole.fmu").exit_code == 0
    diagram = {"blocks": {"it": {"type": "fmu", "file": "whole.fmu"}}, "wires": [], "record": ["it.rotor_displacement"]}
    Path("alone.json").write_text(json.dumps(diagram))
    done = run("cosim", "alone.json", "--trust-blocks", "--step", "0.1 ms", "--stop", "0.01 s")
    assert "damping kept by the coupling: 100.0%; stable with all steps tried\n" in done.stdout
