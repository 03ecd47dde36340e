"""Runs that finished and are wrong say so; healthy ones are left alone."""

from __future__ import annotations

import copy
import math
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from rotorsim.diagram.diagram import Endpoint
from rotorsim.linear.stability import growing
from rotorsim.model.input_limits import InputLimit, passed_limit
from rotorsim.model.load import load
from rotorsim.settled.periodic import periodic
from rotorsim.simulation.run import simulate
from rotorsim.simulation.validity import stretches_of
from tests.model.documents import oscillator
from tests.reference.handmade import handmade


def machine(acceleration, *, stop: float, step: float = 1e-3, start: float = 1e-3, speed: float = 0.0):
    """Return a model of q'' = acceleration(t, q, v), q(0) = start, that can be simulated."""

    def build(t, x, p, v):
        q, rate = x["body.q"], x["body.v"]
        return {"xdot": {"body.q": rate, "body.v": acceleration(t, q, rate)}, "signals": {"body.displacement": q}}

    model = handmade(
        {"body.q": 1, "body.v": 1},
        {"speed": speed} if speed else {"body.unused": 0.0},
        build,
        initial={"body.q": start},
        record=("body.displacement",),
    )
    model.diagram.solver = SimpleNamespace(step=step, stop=stop, record_every=1, method="rk4", rtol=1e-9, atol=1e-12)
    model.diagram.sha256, model.diagram.document, model.diagram.removed = "", {}, frozenset()
    return model


# -- poles -------------------------------------------------------------------------------------------------------------


def test_a_free_body_and_an_undamped_one_do_not_grow():
    free = np.array([[0.0, 1.0], [0.0, 0.0]])
    assert not growing(free)
    rotation = np.linalg.qr(np.random.default_rng(1).normal(size=(8, 8)))[0]
    blocks = np.zeros((8, 8))
    blocks[:2, :2] = free
    for k, w in ((2, 50.0), (4, 3e3), (6, 2e5)):
        blocks[k : k + 2, k : k + 2] = [[0.0, w], [-w, 0.0]]
    assert not growing(rotation @ blocks @ rotation.T)


def test_slow_growth_is_seen_beside_fast_modes():
    blocks = np.zeros((6, 6))
    for k, (a, w) in enumerate(((1e-3, 50.0), (-0.07, 3e3), (-1.0, 2e5))):
        blocks[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[a, w], [-w, a]]
    rotation = np.linalg.qr(np.random.default_rng(2).normal(size=(6, 6)))[0]
    found = growing(rotation @ blocks @ rotation.T)
    assert found.poles == pytest.approx([1e-3 + 50j], rel=1e-6)
    blocks[0, 0] = blocks[1, 1] = -1e-3
    assert not growing(rotation @ blocks @ rotation.T)


def test_the_share_of_the_states_in_a_pole():
    found = growing(np.array([[-1.0, 5.0], [0.0, 2.0]]))  # the second state grows by itself, the first follows
    assert found.share == pytest.approx([0.0, 1.0], abs=1e-12)
    assert found.describe() == "a pole at 2 1/s"


# -- linear machines ---------------------------------------------------------------------------------------------------


def test_an_unstable_machine_is_not_finished():
    # KD = -5: s^3 + (c + k_i KD)/m s^2 + ..., of Table 2-1: a pair at 121.5 Hz that grows at 33.66 1/s in both planes
    result = simulate(load("jeffcott", set={"controller.KD": -5.0}), stop=1.0)
    assert result.status == "unstable"
    assert result.message == (
        "the machine is unstable: a pole at 121.5 Hz, damping ratio -0.044, grows at 33.66 1/s, most of it in the "
        "states of 'rotor'; 1 more grows"
    )
    assert len(result.time) == 10001


def test_a_machine_is_unstable_before_its_motion_is_large():
    assert simulate(load("jeffcott", set={"controller.KD": -5.0}), stop=0.01).status == "unstable"


def test_a_step_beyond_the_stability_limit_is_not_finished():
    # oscillator of 1e4 1/s, damping 2 1/s: RK4 holds up to sqrt 8 / 1e4 s
    result = simulate(load(oscillator(stiffness=1e8)), step=0.4e-3, stop=0.02)
    assert result.status == "diverged"
    assert result.message == "the step 0.0004 s is too large: RK4 is stable here up to 0.000282 s"
    assert result.cause == "step"


@pytest.mark.parametrize("name", ["jeffcott", "offset_disc"])
def test_healthy_machines_are_finished_without_a_word(name):
    result = simulate(load(name), stop=0.5)
    assert (result.status, result.message) == ("finished", "")
    assert result.counters["step_error"] < 1e-4


def test_a_run_up_through_the_critical_speed_is_finished():
    result = simulate(load("jeffcott_runup"))
    assert (result.status, result.message) == ("finished", "")


# -- machines whose coefficients change --------------------------------------------------------------------------------


@pytest.mark.parametrize(("damping", "status"), [(0.1, "unstable"), (0.5, "finished")])
def test_parametric_resonance_is_found_though_the_mean_is_stable(damping, status):
    # q'' + 2 c q' + (1 + e cos 2t) q = 0, e = 0.6: grows at e/4 - c = 0.05 or dies out (Nayfeh & Mook, sec. 5.2)
    model = machine(lambda t, q, v: -2 * damping * v - (1 + 0.6 * ca.cos(2.0 * t)) * q, stop=60.0, step=0.01, speed=2.0)
    result = simulate(model)
    assert result.status == status
    if status == "unstable":
        head, _, tail = result.message.partition("its motion grows ")
        assert head == "the machine is unstable, parametric resonance; "
        grows = float(tail.removesuffix(" times a turn"))
        assert math.log(grows) / math.pi == pytest.approx(0.05, rel=0.05)


def van_der_pol(t, q, v):
    return 2.0 * (1 - (q / 1e-3) ** 2) * v - 100.0 * q


def test_a_limit_cycle_is_finished_though_its_equilibrium_is_unstable():
    result = simulate(machine(van_der_pol, stop=10.0, start=1e-5))
    assert (result.status, result.message) == ("finished", "")
    late = np.abs(result["body.displacement"][-2000:]).max()
    assert late == pytest.approx(2e-3, rel=0.02)  # van der Pol: amplitude 2


def test_a_nonlinear_machine_that_still_grows_is_unstable():
    result = simulate(machine(van_der_pol, stop=6.0, start=1e-9))
    assert result.status == "unstable"
    assert result.message.startswith("the machine is unstable: a pole at 1.584 Hz, damping ratio -0.1, grows at 1 1/s")


def test_a_rotor_that_falls_away_from_a_saturated_magnet_is_unstable():
    # pulled away by 500 q, but never by more than 0.5: it falls with constant acceleration in the end, no pole left
    def falls(t, q, v):
        return 0.5 * ca.tanh(1000 * q)

    result = simulate(machine(falls, stop=3.0, start=1e-4))
    assert result.status == "unstable"
    assert result.message == (
        "the machine is unstable about its initial position: a pole at 22.25 1/s; its motion still grows"
    )


def test_sampled_machines_are_judged_by_their_transition(tmp_path):
    import json

    from rotorsim.diagram.resolve.resolution import shipped_diagrams

    text = json.loads(shipped_diagrams()["jeffcott"].read_text())
    text["blocks"]["controller"] = {"type": "discrete_pid", "parameters": {"KP": 12200, "KI": 2000, "KD": 3}}
    file = tmp_path / "sampled.json"
    file.write_text(json.dumps(text))
    healthy = simulate(load(str(file)), stop=1.0)
    assert (healthy.status, healthy.message) == ("finished", "")
    result = simulate(load(str(file), set={"controller.KD": -5.0}), stop=1.0)
    assert result.status == "unstable"
    assert result.message.startswith("the machine with its sampled blocks is unstable: its motion grows at ")
    assert result.cause == "sampled"


# -- the error of the step ---------------------------------------------------------------------------------------------


def test_the_error_of_the_step_is_that_of_the_exact_solution():
    # q'' = -w^2 q for ten periods: RK4 at h w = 0.2 turns the phase by about (h w)^5 / 120 a step: 8.4e-4 in the end
    w, h = 2 * math.pi, 0.2 / (2 * math.pi)
    result = simulate(machine(lambda t, q, v: -(w**2) * q, step=h, stop=10.0, start=1.0))
    exact = np.cos(w * result.time)
    true = float(np.sqrt(np.mean((result["body.displacement"] - exact) ** 2) / np.mean(exact**2)))
    assert result.counters["step_error"] == pytest.approx(true, rel=0.1)
    assert (result.status, result.message) == ("finished", "")


def test_a_step_that_is_too_coarse_is_said_with_one_that_would_do():
    coarse = simulate(load("jeffcott"), step=3e-3)
    assert coarse.status == "finished"
    head, _, tail = coarse.message.partition("; a step of ")
    assert head == "the step 0.003 s is too large: 'rotor.displacement' is wrong by about 25 % of its rms"
    assert coarse.cause == "step"
    step = float(tail.removesuffix(" s would do"))
    assert 0.2e-3 < step < 3e-3
    better = simulate(load("jeffcott"), step=step)
    assert better.message == ""
    for one, width, allowed in ((coarse, 3e-3, (0.15, 0.35)), (better, step, (0.0, 0.01))):
        exact = simulate(load("jeffcott"), step=width / 30, record_every=30, stop=float(one.time[-1]))
        difference = one["rotor.displacement"] - exact["rotor.displacement"]
        error = float(np.sqrt(np.mean(difference**2) / np.mean(exact["rotor.displacement"] ** 2)))
        assert allowed[0] < error < allowed[1]


def test_the_error_is_estimated_from_six_percent_of_the_work():
    assert stretches_of(50_000) == [(0, 500), (49_500, 50_000)]
    assert stretches_of(300) == [(0, 300)]
    assert stretches_of(10**9) == [(0, 20_000), (10**9 - 20_000, 10**9)]


# -- beyond what the equations hold for --------------------------------------------------------------------------------


def nonlinear_bearing():
    """Return the Jeffcott rotor with magnets in an air gap of 42.1 * 1 / 105210 m = 400.2 um."""
    document = copy.deepcopy(dict(load("jeffcott").document))
    del document["identify"]
    document["blocks"]["amb"]["type"] = "amb_nonlinear"
    return load(document)


@pytest.mark.slow
def test_a_rotor_that_passes_its_magnets_is_no_motion():
    """Unstable, it leaves the gap, where a force of (1/gap)^2 throws it back: nothing grows evenly any more."""
    found = simulate(nonlinear_bearing(), parameters={"controller.KD": -5.0}, stop=0.5)
    assert found.status == "diverged"
    passed = np.abs(found["rotor.displacement"]).max(axis=1) >= 42.1 / 105210
    at = found.time[np.argmax(passed)]
    assert found.message.startswith(
        "amb: its equations hold below a displacement of 0.0004002 m; 'rotor.displacement' passes it at "
        f"t = {at:.4g} s and reaches "
    )
    unseen = simulate(nonlinear_bearing(), parameters={"controller.KD": -5.0}, stop=0.5, record=["controller.current"])
    assert (unseen.status, unseen.message) == ("diverged", found.message)
    assert list(unseen.signals) == ["controller.current"]


def test_a_settled_motion_beyond_its_magnets_is_none():
    """Harmonic balance finds one: the law goes on, with the sign of the wrong magnet."""
    found = periodic(nonlinear_bearing(), parameters={"eccentricity": 4e-4}, speeds=[157.0, 560.0])
    assert found.status[0] == "settled"
    assert found.status[1].startswith(
        "failed: amb: its equations hold below a displacement of 0.0004002 m; 'rotor.displacement' passes it at t = "
    )
    assert np.isnan(found.harmonics["rotor.displacement"][1]).all()


def test_a_rotor_that_stays_between_its_magnets_is_left_alone():
    found = simulate(nonlinear_bearing(), stop=0.5)
    assert (found.status, found.message) == ("finished", "")
    assert np.abs(found["rotor.displacement"]).max() < 42.1 / 105210


@pytest.mark.parametrize(("times", "told"), [(0.999, False), (1.001, True)])
def test_a_bearing_at_one_node_is_judged_by_that_node(times, told):
    """Signals of a co-simulation are whole: (n, nodes, axes). The limit is 4e-4 m at node 2."""
    limit = InputLimit("amb", "displacement", Endpoint("rotor", "displacement", (1,)), 4e-4, "m")
    values = np.zeros((3, 4, 2))
    values[:, 2:] = 1.0  # further off, where no bearing is
    values[2, 1, 1] = -4e-4 * times
    found = passed_limit([limit], np.array([0.0, 0.1, 0.2]), {"rotor.displacement": values})
    assert found == (
        "amb: its equations hold below a displacement of 0.0004 m; 'rotor.displacement[2]' passes it at t = 0.2 s and "
        "reaches 0.0004004 m"
        if told
        else ""
    )
    assert passed_limit([limit], np.array([0.0, 0.1, 0.2]), {"rotor.displacement[2]": values[:, 1]}) == found
    assert passed_limit([limit], np.zeros(3), {}) == ""


@pytest.mark.parametrize(("times", "told"), [(0.99, False), (1.01, True)])
def test_an_absolute_tolerance_above_one_percent_of_a_signal_is_said(times, told):
    """q'' = 0, q(0) = 1e-3: the peak is 1e-3, so that 1e-5 is one percent."""
    model = machine(lambda t, q, v: 0.0 * q, stop=0.1)
    model.diagram.solver.method, model.diagram.solver.atol = "rk45", times * 1e-5
    found = simulate(model)
    assert found.status == "finished"
    assert found.message == (
        "the absolute tolerance 1.01e-05 is more than 1 % of 'body.displacement', whose peak is 0.001 m: nothing keeps "
        "its error small; a solver.atol of 1e-10 would"
        if told
        else ""
    )
