"""Simulation as a user calls it: failures, interruption, events, wrong arguments."""

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.linear.stability import largest_stable_step
from rotorsim.model.load import load
from rotorsim.simulation.adaptive import LARGEST_STATE
from rotorsim.simulation.run import simulate
from tests.model.documents import document, oscillator


def test_an_unstable_system_stops_with_time_block_and_cause_and_keeps_what_it_computed():
    result = simulate(load(oscillator(damping=-2000.0)), stop=2.0)
    assert result.status == "diverged"
    time = result.time[-1] + 1e-3
    assert result.message.startswith(f"diverged at t = {time:.6g} s: state 'velocity.value' of block 'velocity'")
    assert result.message.endswith(
        "the system is unstable (a pole at 2000 1/s, most of it in the states of 'velocity'; 1 more grows)"
    )
    assert np.isfinite(result["position.output"]).all()
    assert 300 < len(result.time) < 400  # e^(2000 t) overflows near t = 0.355 s


@pytest.mark.slow
@pytest.mark.parametrize("method", ["dop853", "rk45", "radau", "bdf", "lsoda"])
def test_methods_of_variable_step_end_where_a_state_has_become_too_large(method):
    """At 1e100: e^(2000 t) / 2000 is there near t = 0.12 s. Beyond, LSODA never ends, and Radau fails."""
    assert LARGEST_STATE == 1e100
    result = simulate(load(oscillator(damping=-2000.0)), stop=2.0, method=method)
    assert result.status == "diverged"
    assert result.message.endswith(
        "the system is unstable (a pole at 2000 1/s, most of it in the states of 'velocity'; 1 more grows)"
    )
    assert 110 < len(result.time) < 125
    assert np.abs(result["position.output"]).max() > 1e90


def test_a_step_that_is_too_large_is_told_from_an_unstable_system():
    result = simulate(load(oscillator(stiffness=1e8)), stop=2.0)
    assert result.status == "diverged"
    assert result.message.endswith("the step 0.001 s is too large, RK4 is stable here up to 0.000282 s")
    assert result.cause == "step"


def test_the_largest_stable_step_is_that_of_the_stability_function():
    assert largest_stable_step(np.array([-2.0])) == pytest.approx(2.785293563405282 / 2, rel=1e-9)
    assert largest_stable_step(np.array([1j - 1e-9])) == pytest.approx(np.sqrt(8), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rk4", "dop853", "bdf"])
def test_an_interrupted_run_keeps_what_was_computed(method):
    def interrupt(fraction: float) -> None:
        if fraction > 0.3:
            raise KeyboardInterrupt

    result = simulate(load(oscillator()), stop=20.0, method=method, progress=interrupt)
    assert result.status == "stopped"
    assert 5000 < len(result.time) < 20000
    assert result.message.startswith("interrupted at t = ")
    whole = simulate(load(oscillator()), stop=20.0, method=method)
    assert np.array_equal(result["position.output"], whole["position.output"][: len(result.time)])


def test_progress_does_not_change_the_result():
    seen: list[float] = []
    one = simulate(load(oscillator()), stop=20.0, progress=seen.append)
    assert np.array_equal(one["position.output"], simulate(load(oscillator()), stop=20.0)["position.output"])
    assert seen[-1] == 1.0


def test_recording_every_nth_step_takes_rows_out_and_nothing_else():
    whole = simulate(load(oscillator()), stop=1.0)
    few = simulate(load(oscillator()), stop=1.0, record_every=7)
    assert np.array_equal(few.time, whole.time[::7])
    assert np.array_equal(few["position.output"], whole["position.output"][::7])


def bouncing(law: str) -> dict:
    """Return x'' = -k max(x, 0) - 10: a mass on a one-sided spring, energy conserving."""
    return document(
        {
            "gravity": ("constant", {"value": -10.0}),
            "balance": ("sum", {"signs": "+-"}),
            "velocity": ("integrator", {}),
            "position": ("integrator", {"initial": -0.002}),
            "contact": ("saturation", {"lower": -1e9, "upper": 0.0}),
            "spring": ("gain", {"gain": 1e5}),
        },
        [
            ["gravity.output", "balance.input1"],
            ["spring.output", "balance.input2"],
            ["balance.output", "velocity.input"],
            ["velocity.output", "position.input"],
            ["position.output", "contact.input"],
            ["contact.output", "spring.input"],
        ],
        ["position.output", "velocity.output", "contact.output"],
    )


@pytest.mark.slow
def test_events_are_located_so_that_a_bouncing_mass_keeps_its_energy():
    result = simulate(load(bouncing("")), method="dop853", step=1e-3, stop=2.0)
    x, v, c = (result[f"{name}.output"] for name in ("position", "velocity", "contact"))
    energy = 0.5 * v**2 + 10 * x + 0.5e5 * c**2
    assert result.counters["events"] > 20
    assert np.abs(energy / energy[0] - 1).max() < 1e-5


def test_wrong_arguments_are_all_reported_at_once():
    with pytest.raises(RotorsimError) as caught:
        simulate(load(oscillator()), stop=-1.0, step=0.0, record_every=0)
    assert [str(p) for p in caught.value.problems] == [
        "error: solver.step: the step must be positive, got 0 s\n\n"
        "hint: a fraction of the shortest period, such as 1e-4 s",
        "error: solver.stop: the stop time must be positive, got -1 s\n\nhint: runs begin at t = 0",
        "error: solver.record_every: must be at least 1, got 0\n\nhint: 1 records every step",
    ]
    with pytest.raises(RotorsimError) as caught:
        simulate(load(oscillator()), method="euler")
    assert str(caught.value.problems[0]) == (
        "error: solver.method: unknown method 'euler'\n\nhint: one of rk4, dop853, rk45, radau, bdf, lsoda"
    )
    with pytest.raises(RotorsimError) as caught:
        simulate(load(oscillator()), parameters={"spring.gian": 1.0}, stop=1.0)
    assert str(caught.value.problems[0]) == (
        "error: spring.gian: no such parameter\n\nhint: did you mean 'spring.gain'?"
    )
    with pytest.raises(RotorsimError) as caught:
        simulate(load(oscillator()), record=["position.outptu"])
    assert str(caught.value.problems[0]) == (
        "error: position.outptu: no such signal\n\nhint: did you mean 'position.output'?"
    )
    with pytest.raises(RotorsimError) as caught:
        simulate(load(oscillator()), stop=1e9, step=1.0)
    assert str(caught.value.problems[0]) == (
        "error: record: the recorded signals of 1000000000 steps would take 24 GB, at most 1 GB\n\n"
        "hint: a 'record_every' of 25 or more (--set solver.record_every=...), fewer signals, or a shorter run"
    )


@pytest.mark.parametrize(("every", "said"), [(2001, "2001"), (3 * 10**9, "3e+09"), (10**19, "1e+19")])
def test_a_record_of_the_start_alone_is_refused(every, said):
    with pytest.raises(RotorsimError) as caught:
        simulate(load(oscillator()), stop=2.0, record_every=every)
    assert str(caught.value.problems[0]) == (
        f"error: solver.record_every: every {said}th step of 2000 is recorded: nothing but the start\n\n"
        "hint: at most 2000, or a longer run"
    )
    assert len(simulate(load(oscillator()), stop=2.0, record_every=2000).time) == 2


def test_a_step_longer_than_the_run_is_refused():
    with pytest.raises(RotorsimError) as caught:
        simulate(load("jeffcott"), stop=1e-9)
    assert [(p.what, p.subject, p.hint) for p in caught.value.problems] == [
        ("step 0.0001 s is longer than stop 1e-09 s", "solver", "choose a smaller step")
    ]


def test_an_algebraic_loop_without_a_solution_is_said():
    """y = sin + y^2 has no real solution where the sine is above 1/4."""
    wires = [("u.output", "y.input1"), ("f.output", "y.input2"), ("y.output", "f.input"), ("y.output", "state.input")]
    blocks = {
        "u": ("sine", {"frequency": 3.0}),
        "y": ("sum", {}),
        "f": ("math_function", {"function": "square"}),
        "state": ("integrator", {}),
    }
    result = simulate(load(document(blocks, [list(wire) for wire in wires], ["y.output"], algebraic_loops="solve")))
    assert result.status == "diverged"
    assert result.message.startswith("an algebraic loop did not converge: largest residual")
    assert result.cause == "loop"
    assert result.counters["loop_residual"] > 1e-9
    assert list(result.signals) == ["y.output"]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["dop853", "rk45", "radau", "bdf", "lsoda"])
def test_a_sweep_that_begins_while_all_is_at_rest_is_not_stepped_over(method: str) -> None:
    """FAULT of an earlier version: y' = sweep of 0.5 to 1.5 s was 0 with lsoda. Linear: y = int sin(a t + b t^2)."""
    sweep = {"spacing": "linear", "start": 0.5, "duration": 1.0, "first": 50.0, "last": 500.0}
    document = {
        "schema_version": 1,
        "name": "sweep",
        "blocks": {"sweep": {"type": "chirp", "parameters": sweep}, "y": {"type": "integrator"}},
        "wires": [["sweep.output", "y.input"]],
        "solver": {"method": method, "step": "1 ms", "stop": "2 s"},
        "record": ["y.output"],
    }
    tau = np.linspace(0.0, 1.0, 200_001)
    values = np.sin(50.0 * tau + 225.0 * tau**2)
    expected = np.sum((values[1:] + values[:-1]) / 2) * tau[1]
    assert simulate(load(document))["y.output"][-1] == pytest.approx(expected, rel=1e-4)
