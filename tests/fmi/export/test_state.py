"""Saved states, reset, several instances, logging, and what an exported FMU refuses."""

from __future__ import annotations

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.fmi.opened import opened
from tests.model.documents import document, sampled

H = 1e-4
X = "rotor.displacement[1]"


@pytest.fixture(params=[pytest.param("2.0", marks=pytest.mark.slow), "3.0"])
def version(request):
    return request.param


def test_a_restored_state_goes_on_to_the_last_bit(fmu, version):
    with opened(fmu(sampled(3.3e-3, 2e-3), version), "cs") as slave:
        names = [v.name for v in slave.description.modelVariables if v.causality == "output"]
        slave.begin()
        slave.walk(names, 7, 1e-3)
        state = slave.fmu.getFMUState()
        first = slave.walk(names, 9, 1e-3, first=7)
        slave.fmu.setFMUState(state)
        assert np.array_equal(slave.walk(names, 9, 1e-3, first=7), first)
        bytes_of = slave.fmu.serializeFMUState(state)
        slave.fmu.freeFMUState(state)
        again = slave.fmu.deserializeFMUState(bytes_of)
        slave.fmu.setFMUState(again)
        assert np.array_equal(slave.walk(names, 9, 1e-3, first=7), first)
        slave.fmu.freeFMUState(again)


def test_a_serialised_state_moves_to_another_instance(fmu, version):
    with opened(fmu("jeffcott", version), "cs", "cs") as (one, two):
        one.set(speed=200.0)
        one.begin()
        one.walk([X], 20, H)
        two.begin()
        state = two.fmu.deserializeFMUState(one.fmu.serializeFMUState(one.fmu.getFMUState()))
        two.fmu.setFMUState(state)
        assert two.get("speed") == 200.0
        assert np.array_equal(one.walk([X], 20, H, first=20), two.walk([X], 20, H, first=20))


def test_foreign_states_are_refused(fmu, version):
    with opened(fmu("jeffcott", version), "cs", "me") as (slave, model):
        slave.begin()
        for bytes_of in (b"", b"x" * 40, bytes(len(slave.fmu.serializeFMUState(slave.fmu.getFMUState())))):
            with pytest.raises(FMICallException):
                slave.fmu.deserializeFMUState(bytes_of)
        assert "not a state of this FMU" in slave.messages[-1][2]
        with pytest.raises(FMICallException):
            model.fmu.setFMUState(slave.fmu.getFMUState())


def test_instances_do_not_share_anything(fmu, version):
    with opened(fmu("jeffcott", version), "cs", "cs", "cs") as (one, two, alone):
        for slave, speed in ((one, 100.0), (two, 200.0)):
            slave.set(speed=speed)
            slave.begin()
        rows = []
        for k in range(50):
            one.step(k * H, H)
            two.step(k * H, H)
            rows.append([one.get(X)[0], two.get(X)[0]])
        for column, speed in ((0, 100.0), (1, 200.0)):
            right = simulate(load("jeffcott"), stop=50 * H, parameters={"speed": speed})["rotor.displacement"][1:, 0]
            assert np.array_equal(np.array(rows)[:, column], right)
        alone.begin()  # an instance that others ran beside is as new


def test_reset_gives_a_new_instance(fmu, version):
    with opened(fmu("jeffcott", version), "cs") as slave:
        slave.begin()
        first = slave.walk([X], 30, H)
        slave.fmu.reset()
        slave.set(speed=3.0)
        slave.fmu.reset()
        slave.begin()
        assert np.array_equal(slave.walk([X], 30, H), first)


def test_parameters_act_when_they_are_set(fmu, version):
    """Before the start they set the initial states; between steps they are those of the run from there on."""
    with opened(fmu("jeffcott", version), "cs") as slave:
        slave.put(["rotor.initial_displacement[1]", "controller.KP"], [1e-5, 14000.0])
        slave.enter()
        assert slave.get("rotor.position[1]", X) == pytest.approx([1e-5, 1e-5], abs=0)
        slave.leave()
        slave.walk([X], 10, H)
        slave.put(["controller.KP"], [9000.0])
        rows = slave.walk([X], 10, H, first=10)
        state = slave.get(*(f"rotor.position[{k}]" for k in (1, 2)))
    parameters = {"rotor.initial_displacement": [1e-5, 0.0], "controller.KP": 14000.0}
    before = simulate(load("jeffcott"), stop=20 * H, parameters=parameters)["rotor.displacement"][:, 0]
    assert rows[0, 0] == before[10]
    assert rows[-1, 0] != before[20]
    assert rows[-1, 0] == state[0]


def test_states_with_a_number_can_be_started_elsewhere(fmu, version):
    with opened(fmu("jeffcott", version), "cs") as slave:
        exact = [v.name for v in slave.description.modelVariables if v.causality == "local" and v.initial == "exact"]
        assert exact == ["controller.integral[1]", "controller.integral[2]"]
        slave.put(["controller.integral[1]"], [1e-6])
        slave.begin()
        assert slave.get("controller.integral[1]") == 1e-6
        assert slave.get("controller.current[1]") == pytest.approx(2000 * 1e-6, rel=1e-12)


REFUSED = {
    "fixed": ("rotor.initial_displacement[1]", 1.0, "is fixed: it can be set only until the initialization ends"),
    "range": ("amb.force_current_factor", np.nan, "is not a finite number"),
    "output": (X, 1.0, "cannot be set now (step mode)"),
    "state": ("controller.integral[1]", 1.0, "cannot be set now (step mode)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_set_is_refused_with_the_reason(fmu, version, case):
    name, value, said = REFUSED[case]
    with opened(fmu("jeffcott", version), "cs") as slave:
        name = name if name in slave.variables else "force_current_factor"
        slave.begin()
        with pytest.raises(FMICallException):
            slave.put([name], [value])
        assert slave.messages == [(3, "logStatusError", f"{name} {said}" if case != "range" else f"{name}: nan {said}")]
        slave.step(0.0, H)  # nothing else was lost


def test_values_out_of_their_range_are_refused(fmu, version):
    made = sampled(3.3e-3)
    with opened(fmu(made, version), "cs") as slave:
        name = next(n for n in slave.variables if n.endswith(".sample_time"))
        slave.put([name], [2e-3])
        with pytest.raises(FMICallException):
            slave.put([name], [0.0])
        assert slave.messages[-1][2] == f"{name} = 0 is outside its range, above 0 to inf"
        assert slave.get(name) == 2e-3
        slave.begin()
        with pytest.raises(FMICallException):
            slave.put([name], [1e-3])


def test_steps_that_do_not_follow_are_refused(fmu, version):
    with opened(fmu("jeffcott", version), "cs") as slave:
        slave.begin(stop=0.01)
        for time, size in ((0.5, H), (0.0, -H), (0.0, np.nan), (np.inf, H)):
            with pytest.raises(FMICallException):
                slave.step(time, size)
            assert "does not follow on t = 0 s" in slave.messages[-1][2]
        with pytest.raises(FMICallException):
            slave.step(0.0, 0.02)
        assert slave.messages[-1][2].endswith("t = 0.02 s is behind the stop time 0.01 s")
        slave.step(0.0, 0.01)


def test_calls_out_of_order_are_refused(fmu, version):
    with opened(fmu("jeffcott", version), "cs", "me") as (slave, model):
        with pytest.raises(FMICallException):
            slave.step(0.0, H)
        assert slave.messages[-1][2].endswith("DoStep is not allowed now (instantiated)")
        with pytest.raises(FMICallException):
            model.fmu.enterContinuousTimeMode()
        slave.begin()
        with pytest.raises(FMICallException):
            slave.enter()
        slave.fmu.terminate()
        with pytest.raises(FMICallException):
            slave.step(0.0, H)
        assert slave.get(X) == 0.0  # values can still be read


def test_a_motion_that_leaves_the_numbers_ends_with_words(fmu, version):
    made = document(
        {"state": ("integrator", {"initial": 1.0}), "rate": ("gain", {"gain": 2000.0})},
        [["state.output", "rate.input"], ["rate.output", "state.input"]],
        ["state.output"],
    )
    with opened(fmu(made, version), "cs") as slave:
        slave.begin()
        state = slave.fmu.getFMUState()
        with pytest.raises(FMICallException):
            slave.step(0.0, 2.0)
        status, category, text = slave.messages[-1]
        assert (status, category) == (3, "logStatusError")
        # 2000 h = 2: a factor of 7 a step, beyond 1e290 after 344 steps; looked at every 8
        assert text.startswith("state.value grows without bound, at t = 0.344 s it is 5.17e+290: the motion diverges")
        with pytest.raises(FMICallException):
            slave.step(2.0, 1e-3)
        slave.fmu.setFMUState(state)  # the state before is good
        slave.step(0.0, 1e-3)


def test_a_wrong_token_gives_no_instance(fmu, version, capfd):
    with opened(fmu("jeffcott", version), "cs") as slave:
        slave.fmu.guid = "{another}"
        if slave.two:
            with pytest.raises(Exception, match="Failed to instantiate"):
                slave.fmu.instantiate(callbacks=slave.callbacks)
        else:
            component = slave.fmu.component
            with pytest.raises(Exception, match="Failed to instantiate"):
                slave.fmu.instantiate(logMessage=slave._log3)
            slave.fmu.component = component
        assert slave.messages[-1][2].startswith("the GUID or token {another} is not that of this FMU")


def test_unknown_references_and_types_are_refused(fmu, version):
    with opened(fmu("jeffcott", version), "cs") as slave:
        with pytest.raises(FMICallException):
            (slave.fmu.getReal if slave.two else slave.fmu.getFloat64)([9999])
        assert slave.messages[-1][2].endswith("there is no variable with value reference 9999")
        with pytest.raises(FMICallException):
            (slave.fmu.getInteger if slave.two else slave.fmu.getInt32)([1])
        assert slave.messages[-1][2].endswith(
            "all variables of this FMU are Real" + ("" if slave.two else "64")
            if slave.two
            else "all variables of this FMU are Float64"
        )


def test_logging_says_events_only_when_it_is_on(fmu, version):
    for log in (False, True):
        with opened(fmu(sampled(3.3e-3), version), "me", log=log) as model:
            model.begin()
            model.update()
            assert model.messages == ([(0, "logEvents", "sample hit at t = 0 s")] if log else [])
            model.fmu.setDebugLogging(not log, ["logEvents"])
            with pytest.raises(FMICallException):
                model.fmu.setDebugLogging(True, ["loud"])


def test_the_library_shows_only_the_functions_of_fmi(fmu, version, tmp_path):
    import shutil
    import subprocess

    if not shutil.which("nm"):
        pytest.skip("no nm")
    folder = fmpy.extract(str(fmu("jeffcott", version)), str(tmp_path))
    library = next(path for path in tmp_path.rglob("*") if path.suffix == ".so")
    told = subprocess.run(["nm", "-D", "--defined-only", str(library)], capture_output=True, text=True, check=True)
    names = [line.split()[-1] for line in told.stdout.splitlines()]
    assert folder
    assert names
    assert all(name.startswith(f"fmi{version[0]}") for name in names)
