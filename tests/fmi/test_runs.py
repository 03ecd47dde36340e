"""Runs of diagrams with FMUs: events that the run carries out, and parts that hide their equations."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rotorsim.cosim import coupled_periodic
from rotorsim.errors import RotorsimError
from rotorsim.fmi.mode import FmuMode
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from rotorsim.settled.periodic import periodic
from rotorsim.simulation.failure import AT_VALUES, OUTGROWN
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate
from rotorsim.simulation.switching import SwitchingInstance
from tests.fmi.conftest import Make
from tests.fmi.events import alone, description2, events_fmu
from tests.fmi.plant import FAULTS, floats_only, library, make_fmu
from tests.fmi.test_equations import of_plant, with_fmu

G, E, H = 9.81, 0.8, 1e-2
SETTLED = ("rotor.displacement", "controller.current")
METHODS = pytest.mark.parametrize("method", ["rk4", "dop853", "radau"])


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the FMU with events, which needs no reports of completed steps."""
    return events_fmu(tmp_path_factory.mktemp("events"), reports=False)


def ball(t: np.ndarray, height: float = 1.0) -> np.ndarray:
    """Return the height of a ball that falls, and loses 1 - E of its speed at each bounce."""
    first = np.sqrt(2 * height / G)
    times, speeds = [first], [E * G * first]
    while times[-1] < t[-1]:
        times.append(times[-1] + 2 * speeds[-1] / G)
        speeds.append(E * speeds[-1])
    k = np.searchsorted(times, t, side="right") - 1
    since = t - np.array(times)[np.maximum(k, 0)]
    return np.where(k < 0, height - G / 2 * t**2, np.array(speeds)[np.maximum(k, 0)] * since - G / 2 * since**2)


@METHODS
def test_a_ball_bounces_and_what_follows_it_too(file: Path, method: str) -> None:
    """An integrator behind the ball is integrated with it: no coupling, and no error of one."""
    blocks = {"sum": {"type": "integrator"}}
    diagram = alone(file, "ball", step=H, stop=2.0, blocks=blocks, wires=[["it.x", "sum.input"]])
    found = simulate(diagram, method=method, record=["it.x", "it.count", "sum.output"])
    t = found.time
    assert (found.status, found.message, found["it.count"][-1]) == ("finished", "", 3.0)
    np.testing.assert_allclose(found["it.x"], ball(t), atol=1e-9)
    fine = np.linspace(0.0, 2.0, 2_000_001)
    area = np.concatenate([[0.0], np.cumsum((ball(fine)[1:] + ball(fine)[:-1]) / 2 * np.diff(fine))])
    np.testing.assert_allclose(found["sum.output"], np.interp(t, fine, area), atol=1e-6)


@METHODS
def test_who_is_told_of_steps_changes_none(tmp_path: Path, method: str) -> None:
    """A ball that wants to be told bounces as one that does not; what asks for an event behind a step has it there."""
    told = events_fmu(tmp_path)
    found = simulate(alone(told, "ball", step=H, stop=2.0), method=method)
    np.testing.assert_allclose(found["it.x"], ball(found.time), atol=1e-9)
    found = simulate(alone(told, "late", step=H, stop=4.0, high=1.5), method=method)
    assert (found.status, found["it.count"][-1]) == ("finished", 3.0)  # x = 1 + t is 1.5, 3.0 and 4.5, or a step later
    late = found["it.when"][-1] - 3.5
    assert 0 <= late <= H * (1 + 1e-6)


def test_a_method_goes_on_where_steps_are_told(tmp_path: Path, file: Path) -> None:
    """One that begins anew at each step begins with small ones: BDF took 18 for each step of the diagram."""
    steps = [
        simulate(alone(one, "two", step=0.05, stop=5.0, low=-9.0), method="bdf").counters["steps"]
        for one in (file, events_fmu(tmp_path))
    ]
    assert steps[1] <= steps[0] + 5.0 / 0.05


def test_two_balls_of_one_file_have_modes_of_their_own(file: Path) -> None:
    """The same values but for one input: what one does is not seen in the other."""
    values = {"interface": "me", "in_process": True, "model": 0}
    blocks = {
        name: {"type": "fmu", "file": file.name, "parameters": {**values, "x0": height}}
        for name, height in (("other", 1.0), ("third", 0.5))
    }
    found = simulate(alone(file, "ball", step=H, stop=1.5, blocks=blocks), record=["it.x", "other.x", "third.x"])
    for name, height in (("it.x", 1.0), ("other.x", 1.0), ("third.x", 0.5)):
        np.testing.assert_allclose(found[name], ball(found.time, height), atol=1e-9)


@pytest.mark.slow
@METHODS
def test_a_wall_in_a_loop(tmp_path: Path, method: str) -> None:
    """A relay of the FMU in a loop with a lag of the diagram, against an integration of the equations in this test."""
    file = events_fmu(tmp_path, reports=False)
    blocks = {
        "lag": {"type": "lag", "parameters": {"time_constant": 0.3}},
        "none": {"type": "gain", "parameters": {"gain": 1.0}},
    }
    wires = [["it.x", "lag.input"], ["lag.output", "none.input"], ["none.output", "it.u"]]
    diagram = alone(file, "relay", step=1e-3, stop=4.0, blocks=blocks, wires=wires)
    found = simulate(diagram, method=method, record=["it.x", "lag.output"])
    t, x, y, on = 0.0, 1.0, 0.0, 1.0
    times, rows = [0.0], [(x, y)]
    while t < 4.0:
        limit = 1.5 if on else 0.5

        def slope(_: float, s: np.ndarray, on: float = on) -> list[float]:
            return [2 * on - s[0], (s[0] - s[1]) / 0.3]

        def edge(_: float, s: np.ndarray, limit: float = limit) -> float:
            return float(s[0] - limit)

        edge.terminal = True  # type: ignore[attr-defined]
        part = solve_ivp(slope, (t, 4.0), [x, y], events=edge, rtol=1e-11, atol=1e-12, dense_output=True)
        grid = found.time[(found.time > t) & (found.time <= part.t[-1])]
        times += grid.tolist()
        rows += part.sol(grid).T.tolist()
        t, (x, y), on = float(part.t[-1]), part.y[:, -1], 1.0 - on
    n = min(len(times), len(found.time))
    right = np.array(rows)[:n]
    atol = {"rk4": 1e-9, "dop853": 1e-7, "radau": 1e-6}[method]
    np.testing.assert_allclose(np.column_stack([found["it.x"], found["lag.output"]])[:n], right, atol=atol)


def test_time_events_without_states_are_carried_out(tmp_path: Path) -> None:
    """Its only output changes at events: no equations between them, but a co-simulation."""
    text = re.sub(r'<Derivatives>.*</Derivatives>| derivative="\d"', "", description2(saves=True, reports=False))
    text = text.replace('Indicators="1"', 'Indicators="0"').replace('causality="output" initial="exact"', "")
    text = text.replace('<Unknown index="2" dependencies=""/>', "").replace('<Unknown index="9" dependencies=""/>', "")
    text = text.replace('"when" causality="output" variability="discrete"', '"when"')
    file = make_fmu(tmp_path / "timer.fmu", description=text, library_bytes=library("2.0", "events"))
    document = {**alone(events_fmu(tmp_path), "clock", step=H, stop=1.0, tick=0.25).document, "record": ["it.count"]}
    document["blocks"]["it"]["file"] = file.name
    found = simulate(load(document, folder=tmp_path, trust_blocks=True))
    np.testing.assert_array_equal(found["it.count"], np.floor(found.time / 0.25 + 1e-9))


@pytest.mark.parametrize("in_process", [True, False])
def test_differences_of_denormal_numbers(tmp_path: Path, in_process: bool) -> None:
    """A decay ends in numbers of which a part is none: differences take the step of a zero there."""
    make_fmu(tmp_path / "plant2.fmu", description=floats_only().replace('providesDirectionalDerivative="true"', ""))
    model = compile_diagram(of_plant(tmp_path, in_process=in_process))
    found = np.array(model.jacobian(0.0, np.array([1e-320, 2.0]), model.z0(), model.p0))
    np.testing.assert_allclose(found, [[0.0, 1.0], [-100.0, -0.5]], atol=1e-7)


def test_growth_in_steps_that_are_too_large_is_told(tmp_path: Path) -> None:
    make_fmu(tmp_path / "plant2.fmu")
    found = simulate(of_plant(tmp_path, stiffness=1e6, damping=5000.0), stop=40.0, step=0.1)
    assert (found.status, found.cause) == ("diverged", "step")
    assert found.message.partition(": ")[2] == (
        "state 'it.states' of block 'it' grows without bound: the step 0.1 s is too large, RK4 is stable here up to "
        "0.000581 s"
    )


@pytest.mark.slow
@pytest.mark.parametrize("in_process", [True, False])
def test_an_fmu_that_refuses_what_has_grown_is_not_the_cause(fmu: Make, in_process: bool) -> None:
    """An unstable gain: e^(3143 t) is beyond all bounds (1e290) before the rotor discards what is not finite."""
    diagram = with_fmu(fmu, "rotor", in_process=in_process)
    found = simulate(diagram, parameters={"controller.KP": -5e5}, stop=1.0)
    assert (found.status, found.cause) == ("diverged", "")
    assert found.message == (
        "diverged at t = 0.2148 s: state 'rotor.states' of block 'rotor' grows without bound: the system is unstable "
        "(a pole at 3143 1/s, most of it in the states of 'rotor'; 3 more grow)"
    )
    assert np.abs(found["rotor.displacement"]).max() > 1e280


def test_an_fmu_that_fails_before_anything_has_grown_is_the_cause(tmp_path: Path) -> None:
    """x'' = 100 x grows by 1e6 in 1.4 s."""
    assert OUTGROWN == 1e6
    assert {"value", "discard", "error"} == AT_VALUES
    make_fmu(tmp_path / "plant2.fmu", description=floats_only())
    fault = {"stiffness": -100.0, "damping": 0.0, "fault": FAULTS.index("discard"), "fault_above": -1000.0}
    early, late = (simulate(of_plant(tmp_path, fault_time=at, **fault), stop=3.0) for at in (1.0, 2.0))
    assert (early.status, early.cause) == ("stopped", "part")
    assert early.message.startswith("it: fmi2GetDerivatives returned fmi2Discard (t = 1")
    assert (late.status, late.cause) == ("diverged", "")
    assert "it grows without bound: the system is unstable (a pole at 10 1/s" in late.message


def test_a_run_leaves_the_equations_as_they_begin(file: Path) -> None:
    """The relay is off at the end of a run and on at its beginning: x' = 2 on - x is what it was."""
    diagram = alone(file, "relay", step=1e-3, stop=0.8)
    model = compile_diagram(diagram)
    first, slope, again = simulate(model), np.array(model.rhs(0.0, model.x0(), model.z0(), model.p0)), simulate(model)
    assert first["it.count"][-1] == 1.0
    assert slope.ravel()[0] == 1.0
    np.testing.assert_array_equal(first["it.x"], again["it.x"])


TOLD = (("clock", {}), ("ball", {}), ("two", {}), ("late", {"x0": 0.0, "high": 0.7031}), ("late", {"stop_at": 0.355}))


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("in_process", [True, False])
@pytest.mark.parametrize(("model", "values"), TOLD)
def test_completed_steps_are_told_from_c_as_from_python(
    tmp_path: Path,
    version: str,
    in_process: bool,
    model: str,
    values: dict[str, float],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The virtual machine takes every step from Python; compiled, those alone in which an event is due."""
    careful, taken = SwitchingInstance._careful, []
    monkeypatch.setattr(
        SwitchingInstance, "_careful", lambda self, n, *more: (taken.append(n), careful(self, n, *more))
    )
    file = events_fmu(tmp_path, version)
    runs, counts = [], []
    for compiler in (False, True):
        taken.clear()
        runs.append(
            simulate(alone(file, model, step=H, stop=1.0, in_process=in_process, **values), use_compiler=compiler)
        )
        counts.append(len(taken))
    slow, fast = runs
    assert (fast.status, fast.message, len(fast.time)) == (slow.status, slow.message, len(slow.time))
    assert fast.counters["part_events"] == slow.counters["part_events"]
    for name in ("it.x", "it.count", "it.when"):
        np.testing.assert_allclose(fast[name], slow[name], rtol=1e-12, atol=1e-12)
    assert counts[0] >= fast.counters["steps"]
    assert counts[1] <= 4 * fast.counters["part_events"]  # of a run, and of its stretches that are repeated


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_step_is_told_once_however_late_the_answer_is(
    tmp_path: Path, version: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """C looks once for the answer of the process, and leaves waiting for it to Python."""
    monkeypatch.setattr("rotorsim.fmi.runtime.channel.LOOKS", 1)
    file = events_fmu(tmp_path, version)
    runs = [
        simulate(alone(file, "late", step=H, stop=2.0, in_process=one, x0=0.0, high=0.7031)) for one in (True, False)
    ]
    assert [run["it.count"][-1] for run in runs] == [2.0, 2.0]
    np.testing.assert_array_equal(runs[1]["it.x"], runs[0]["it.x"])


@pytest.mark.parametrize("in_process", [True, False])
def test_a_completed_step_at_which_an_fmu_fails_ends_the_run(tmp_path: Path, in_process: bool) -> None:
    file = events_fmu(tmp_path)
    found = simulate(alone(file, "late", step=H, stop=2.0, in_process=in_process, low=-1.0, x0=0.0, restitution=-1.0))
    assert (found.status, found.message.partition(";")[0]) == (
        "stopped",
        "it: fmi2CompletedIntegratorStep returned fmi2Error (t = 1 s)",
    )


def test_a_coarse_step_is_found_out_across_events(file: Path) -> None:
    """The error of the step is that of the stretches repeated, with their events."""
    coarse, fine = (simulate(alone(file, "relay", step=h, stop=3.0)) for h in (0.5, 1e-3))
    assert fine.counters["step_error"] < 1e-9
    assert coarse.counters["step_error"] > 1e-4


def test_who_does_not_let_its_state_be_saved(tmp_path: Path) -> None:
    found = simulate(alone(events_fmu(tmp_path, saves=False, reports=False), "ball", step=H, stop=1.0))
    assert (found.status, found.message) == (
        "finished",
        "the error of the step was not estimated: a part changes at events and cannot save its state",
    )
    assert "step_error" not in found.counters


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_wall_of_the_plant_in_a_process_of_its_own(tmp_path: Path, version: str) -> None:
    """The same numbers as in this process."""
    from tests.fmi.plant import make_fmu

    make_fmu(tmp_path / f"plant{version[0]}.fmu", version)
    near, apart = (simulate(of_plant(tmp_path, version, in_process=one, tick=0.1)) for one in (True, False))
    assert near.counters["part_events"] == apart.counters["part_events"] > 0
    np.testing.assert_array_equal(near["it.y"], apart["it.y"])


# -- parts that hide their equations -----------------------------------------------------------------------------------


def off(made: Result, plain: Result, name: str) -> float:
    """Return the rms of the difference over the rms of the signal."""
    return float(np.sqrt(((made[name] - plain[name]) ** 2).mean() / (plain[name] ** 2).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("block", ["rotor", "controller"])
def test_co_simulation_is_off_by_the_error_that_is_told(fmu: Make, block: str, version: str) -> None:
    plain = simulate(load("jeffcott"), stop=0.3)
    made = simulate(with_fmu(fmu, block, version, interface="cs"), stop=0.3)
    worst = max(off(made, plain, name) for name in ("rotor.displacement", "controller.current"))
    assert made.status == "finished"
    assert worst == pytest.approx(made.counters["step_error"], rel=0.2)
    assert 0.01 < worst < 0.05
    assert made.provenance["path"] == f"co-simulated with {block}: gauss_seidel, inputs held"
    assert 0.85 < made.provenance["coupling"]["damping_kept"] < 0.95


def test_its_error_is_of_first_order(fmu: Make) -> None:
    diagram = with_fmu(fmu, "controller", interface="cs")
    coarse, fine = (simulate(diagram, stop=0.1, step=h).counters["step_error"] for h in (1e-4, 5e-5))
    assert np.log2(coarse / fine) == pytest.approx(1.0, abs=0.1)


def test_values_reach_the_fmu(fmu: Make) -> None:
    """Those given to a run are not those of the diagram."""
    diagram = with_fmu(fmu, "controller", interface="cs")
    changed = simulate(diagram, stop=0.05, parameters={"controller.KP": 2e4, "speed": 100.0})
    plain = simulate(load("jeffcott"), stop=0.05, parameters={"controller.KP": 2e4, "speed": 100.0})
    told = changed.counters["step_error"]
    assert off(changed, plain, "rotor.displacement") == pytest.approx(told, rel=0.2)
    assert off(changed, simulate(diagram, stop=0.05), "rotor.displacement") > 2 * told
    with pytest.raises(RotorsimError, match=r"error: controller\.XP: no such parameter"):
        simulate(diagram, parameters={"controller.XP": 1.0})


def test_parts_of_signals_and_every_nth_step(fmu: Make) -> None:
    diagram = with_fmu(fmu, "controller", interface="cs")
    whole = simulate(diagram, stop=0.02)
    part = simulate(diagram, stop=0.02, record=["rotor.displacement[2]", "controller.current"], record_every=4)
    assert list(part.signals) == ["rotor.displacement[2]", "controller.current"]
    np.testing.assert_array_equal(part["rotor.displacement[2]"], whole["rotor.displacement"][::4, 1])
    np.testing.assert_array_equal(part.time, whole.time[::4])


def test_a_method_that_other_blocks_do_not_take_is_told(fmu: Make) -> None:
    found = simulate(with_fmu(fmu, "controller", interface="cs"), stop=0.01, method="radau")
    assert found.message.endswith("radau is for states of FMUs alone: other blocks take RK4 steps")


def test_a_step_with_which_the_loop_diverges_is_refused(fmu: Make) -> None:
    with pytest.raises(RotorsimError) as caught:
        simulate(with_fmu(fmu, "controller", interface="cs"), step=1e-3, stop=0.1)
    assert "with this step the coupled loop is unstable; the largest stable step is" in str(caught.value)


def test_the_command_says_what_the_coupling_costs(fmu: Make, run: Any) -> None:
    diagram = with_fmu(fmu, "controller", interface="cs")
    Path("it.json").write_text(json.dumps(dict(diagram.document)))
    done = run("run", "it.json", "--trust-blocks", "--stop", "0.1 s", "--json")
    told = json.loads(done.stdout)
    assert (done.exit_code, told["status"]) == (0, "finished")
    lines = done.stderr.splitlines()
    assert "co-simulated with controller: gauss_seidel, inputs held" in lines[0]
    assert lines[1].startswith("damping kept by the coupling: 87.4%; largest stable step: ")
    assert lines[2].startswith("error of the coupling: ")
    assert done.stderr.endswith("\n\nhint: a smaller --step, or 'rotorsim cosim' with another --master or --order\n")


@pytest.mark.slow
def test_a_recording_of_it_can_be_made(fmu: Make, run: Any) -> None:
    diagram = with_fmu(fmu, "rotor", interface="cs")
    Path("it.json").write_text(json.dumps(dict(diagram.document)))
    done = run("record", "it.json", "--trust-blocks", "--speeds", "1200 rpm, 1500 rpm", "--out", "made")
    assert done.exit_code == 0, done.stderr
    assert {"run01.npz", "run02.npz", "recording.json"} <= {path.name for path in Path("made").iterdir()}
    refused = run("record", "it.json", "--trust-blocks", "--settle", "--out", "other")
    assert refused.exit_code == 2
    assert "rotor: is an FMU for Co-Simulation, which hides its states and equations" in refused.stderr


@pytest.mark.parametrize("block", ["rotor", "controller"])
def test_settled_motion_is_extrapolated(fmu: Make, block: str) -> None:
    """The mean of the current has a time constant of 8 s, and 24 turns last 1 s: it is extrapolated all the same."""
    diagram = with_fmu(fmu, block, interface="cs")
    plain, made = (periodic(one, speeds=[150.0]) for one in (load("jeffcott"), diagram))
    assert (made.status, made.stable) == (("settled",), (True,))
    assert sorted(made.harmonics) == sorted(plain.harmonics)
    assert made.counters["turns"] <= 48
    assert made.harmonic("controller.current", 0) == pytest.approx(plain.harmonic("controller.current", 0), rel=1e-4)
    told = made.provenance["coupling_error"][0]
    off = [
        np.abs(made.harmonic(name, k) - plain.harmonic(name, k))[0] / np.abs(plain.harmonics[name]).max()
        for name in set(plain.harmonics) - set(SETTLED)  # the channels
        for k in range(10)
    ]
    assert max(off) == pytest.approx(told, rel=0.25)
    assert 0.005 < told < 0.1


@pytest.mark.slow
def test_its_error_goes_with_the_step(fmu: Make) -> None:
    document = dict(with_fmu(fmu, "controller", interface="cs").document)
    told = [
        periodic(load({**document, "solver": {"step": h}}, trust_blocks=True), speeds=[150.0], harmonics=9).provenance[
            "coupling_error"
        ][0]
        for h in (1e-4, 2.5e-5)
    ]
    assert np.log2(told[0] / told[1]) == pytest.approx(2.0, abs=0.2)


def test_a_signal_that_does_not_return_is_refused_by_name(fmu: Make) -> None:
    with pytest.raises(RotorsimError) as caught:
        periodic(with_fmu(fmu, "controller", interface="cs"), speeds=[150.0], signals=["clock.theta"])
    assert str(caught.value) == (
        "error: clock.theta: this signal does not return after one period: it has no harmonics"
    )


def test_a_motion_that_is_never_reached(fmu: Make) -> None:
    """Without damping of the controller the machine is unstable: what is extrapolated is not what it comes to."""
    found = periodic(with_fmu(fmu, "controller", interface="cs", KD=-5.0), speeds=[150.0])
    plain = periodic(load("jeffcott", set={"controller.KD": -5.0}), speeds=[150.0])
    assert plain.stable == (False,)
    assert found.stable == (False,) or found.status[0].startswith("failed: ")


def test_a_step_with_which_the_coupling_diverges_settles_nowhere(fmu: Make) -> None:
    document = dict(with_fmu(fmu, "controller", interface="cs").document)
    with pytest.raises(RotorsimError, match="with this step the coupled loop is unstable"):
        periodic(load({**document, "solver": {"step": 1e-3}}, trust_blocks=True), speeds=[150.0])


def test_an_error_that_is_not_known_is_not_zero(fmu: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where half the step does not settle there is nothing to compare with; angles are left out all the same."""
    settle = coupled_periodic._settle

    def half_fails(*given: Any, check: bool) -> Any:
        made, drifting = settle(*given, check=check)
        return (made, drifting) if check else (replace(made, values=made.values * np.nan, status="failed: so"), [])

    monkeypatch.setattr(coupled_periodic, "_settle", half_fails)
    found = periodic(with_fmu(fmu, "controller", interface="cs"), speeds=[150.0])
    assert np.isnan(found.provenance["coupling_error"]).tolist() == [True]
    assert "clock.theta" not in found.harmonics


def test_an_indicator_that_is_no_number_ends_the_run(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FmuMode, "indicators", lambda self: np.array([np.nan]))
    found = simulate(alone(file, "ball", step=H, stop=1.0))
    assert (found.status, found.message) == (
        "stopped",
        "it: gives nan for event indicator 1 (t = 0 s); what was computed until t = 0 s is kept",
    )
